"""A stereo depth camera: an image of depths whose error grows with the square of the depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from perception.simulate.cast import Hits
from perception.simulate.sensor import mixed


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole camera that measures disparity in whole steps.

    Attributes:
        width: of the image [pixels].
        height: of the image [pixels].
        field_deg: horizontal field of view.
        baseline: between its two eyes [m].
        matching: standard deviation of the disparity [pixels].
        step: what disparity is rounded to [pixels].
        correlation: how far the disparity's error reaches, as matching uses windows [pixels].
        nearest: depth [m].
        max_range: [m].
        mixed_share: how often a pixel on an edge flies between both surfaces.
        slant_deg: surfaces seen at more than this angle of incidence give holes ever more often.
        hole_share: how often a pixel is a hole for no reason.
    """

    width: int = 480
    height: int = 360
    field_deg: float = 75.0
    baseline: float = 0.055
    matching: float = 0.08
    step: float = 1.0 / 32.0
    correlation: float = 0.7
    nearest: float = 0.25
    max_range: float = 6.0
    mixed_share: float = 0.4
    slant_deg: float = 75.0
    hole_share: float = 0.01
    # A hole may be a surface that gave no match: it is no evidence of free space.
    tells_misses: bool = False

    @property
    def focal(self) -> float:
        """Focal length [pixels]."""
        return float(0.5 * self.width / np.tan(np.radians(self.field_deg) / 2.0))

    @property
    def footprint_deg(self) -> float:
        """One pixel."""
        return float(np.degrees(1.0 / self.focal))

    def directions(self) -> Float[np.ndarray, "R 3"]:
        """One ray per pixel, row by row from the upper left."""
        column, row = np.meshgrid(np.arange(self.width), np.arange(self.height))
        y = (0.5 * (self.width - 1) - column.ravel()) / self.focal
        z = (0.5 * (self.height - 1) - row.ravel()) / self.focal
        rays = np.column_stack([np.ones(len(y)), y, z])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def measured(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Flying pixels, holes, and disparities with an error, rounded."""
        forward = self.directions()[:, 0]
        depth = mixed(hits.distance, beside, self.mixed_share, rng) * forward
        error = gaussian_filter(rng.normal(size=(self.height, self.width)), self.correlation, mode="wrap")
        disparity = self.focal * self.baseline / depth + self.matching * error.ravel() / error.std()
        disparity = self.step * np.round(disparity / self.step)
        seen = (disparity > 0.0) & (rng.random(len(depth)) > self._hole_share(hits))
        return np.where(seen, self.focal * self.baseline / np.where(seen, disparity, 1.0) / forward, np.nan)

    def deviation(self, depth: Float[np.ndarray, "R"]) -> Float[np.ndarray, "R"]:
        """Standard deviation of each depth, rounding included [m]."""
        pixels = np.hypot(self.matching, self.step / np.sqrt(12.0))
        return np.asarray(pixels * depth**2 / (self.focal * self.baseline))

    def _hole_share(self, hits: Hits) -> Float[np.ndarray, "R"]:
        """How often a pixel gives nothing: always when its surface is seen edge on."""
        limit = np.cos(np.radians(self.slant_deg))
        slanted = np.clip(1.0 - hits.cosine / limit, 0.0, 1.0)
        return np.asarray(np.maximum(slanted, self.hole_share))
