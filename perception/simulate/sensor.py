"""Simulated sensors (spinning and solid-state scanners, stereo and time-of-flight cameras) and the scans they take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from perception.cloud import Cloud
from perception.simulate.cast import Caster, Hits
from perception.solids.primitives import Mesh, join_meshes

_EDGE = 0.03
# Turns per second of the two prisms: far from a ratio of small integers, so that the rosette fills the cone.
_TURNS = (121.5, -77.7)


@dataclass(frozen=True)
class Pose:
    """Pose of a sensor: position [m], then yaw, pitch (down positive) and roll [rad]."""

    position: tuple[float, float, float] = (0.12, 0.0, 1.6)
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @staticmethod
    def looking(position: tuple[float, float, float], target: Sequence[float], roll: float = 0.0) -> Pose:
        """Make a pose at ``position`` that looks at ``target``."""
        x, y, z = np.subtract(target, position)
        return Pose(position, float(np.arctan2(y, x)), float(-np.arctan2(z, np.hypot(x, y))), roll)

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Rotation from the sensor's frame to the world."""
        return np.asarray(Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix())

    @property
    def viewpoint(self) -> tuple[float, ...]:
        """Pose as x y z qw qx qy qz, as in PCD files."""
        return (*self.position, *Rotation.from_matrix(self.rotation).as_quat(scalar_first=True).tolist())


class Sensor(Protocol):
    """Sensor model: ray directions, and measured ranges as a function of the hits.

    Attributes:
        nearest: smallest range that gives a point [m].
        max_range: largest range that gives a point [m].
        footprint_deg: angular width of a ray; at an edge it hits two surfaces.
        tells_misses: whether it distinguishes a ray without a return from a failed measurement.
    """

    @property
    def nearest(self) -> float: ...
    @property
    def max_range(self) -> float: ...
    @property
    def footprint_deg(self) -> float: ...
    @property
    def tells_misses(self) -> bool: ...

    def directions(self) -> Float[np.ndarray, "R 3"]:
        """Return unit directions of all rays in the sensor's frame (x forward, y left, z up)."""
        ...

    def measure(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Return measured ranges [m]: NaN for a failed measurement, infinite without a return.

        Args:
            beside: (R,) distance of the surface hit by the edge of each ray [m].
        """
        ...


def mix_ranges(
    first: Float[np.ndarray, "R"], beside: Float[np.ndarray, "R"], share: float, rng: np.random.Generator
) -> Float[np.ndarray, "R"]:
    """Return ranges with mixed pixels: at depth edges over 3 cm, some are random values between both surfaces.

    Args:
        first: distances hit by the centres of the rays [m].
        beside: distances hit by their edges [m].
        share: share of rays at depth edges that become mixed.
    """
    place = rng.random(len(first))
    both = np.isfinite(first) & np.isfinite(beside)
    gap = np.where(both, beside, 0.0) - np.where(both, first, 0.0)
    is_mixed = (np.abs(gap) > _EDGE) & (rng.random(len(first)) < share)
    return np.where(is_mixed, first + place * gap, first)


@dataclass(frozen=True)
class Scanner:
    """A spinning line scanner: beams in a fan that turns about the sensor's forward axis.

    Attributes:
        n_beams: number of beams in the fan.
        fan_deg: angle of the fan, about the forward axis.
        n_lines: positions of the fan over half a turn, which together cover all directions.
        sigma: standard deviation of the range [m].
        max_range: largest range that gives a point [m].
        footprint_deg: angular width of a beam; if it hits two surfaces the range can lie between them.
        mixed_share: share of such beams whose range does.
        nearest: smallest range that gives a point [m].
    """

    n_beams: int = 1081
    fan_deg: float = 270.0
    n_lines: int = 90
    sigma: float = 0.01
    max_range: float = 30.0
    footprint_deg: float = 0.15
    mixed_share: float = 0.3
    nearest: float = 0.1
    tells_misses: bool = True

    def directions(self) -> Float[np.ndarray, "R 3"]:
        """Return unit directions of all beams in the sensor's frame (x forward, z up)."""
        beam = np.radians(np.linspace(-self.fan_deg / 2, self.fan_deg / 2, self.n_beams))
        turn = np.pi * np.arange(self.n_lines) / self.n_lines
        beam, turn = (grid.ravel() for grid in np.meshgrid(beam, turn))
        return np.column_stack([np.cos(beam), np.sin(beam) * np.cos(turn), np.sin(beam) * np.sin(turn)])

    def measure(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Add mixed pixels at edges, and noise that does not depend on the range."""
        ranges = mix_ranges(hits.distance, beside, self.mixed_share, rng)
        return ranges + rng.normal(0.0, self.sigma, len(ranges))


@dataclass(frozen=True)
class SolidState:
    """A solid-state lidar with turning prisms: a rosette within a cone that never repeats itself.

    Attributes:
        n_points: number of pulses.
        field_deg: full angle of the cone.
        sigma: standard deviation of the range at normal incidence [m].
        grazing_gain: additional deviation per tangent of the angle of incidence [m].
        mixed_share: share of beams on an edge whose range lies between both surfaces.
    """

    n_points: int = 100_000
    rate: float = 100_000.0
    field_deg: float = 70.4
    sigma: float = 0.008
    grazing_gain: float = 0.001
    max_range: float = 40.0
    footprint_deg: float = 0.2
    mixed_share: float = 0.3
    nearest: float = 0.1
    tells_misses: bool = True

    def directions(self) -> Float[np.ndarray, "R 3"]:
        """Return unit directions of beams deflected by two prisms of equal power in series."""
        time = np.arange(self.n_points) / self.rate
        bent = sum(np.exp(2j * np.pi * turns * time) for turns in _TURNS) * np.radians(self.field_deg) / 4.0
        angle = np.abs(bent)
        side = np.sin(angle) / np.maximum(angle, 1e-12)
        return np.column_stack([np.cos(angle), side * np.real(bent), side * np.imag(bent)])

    def measure(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Add mixed pixels at edges, and noise that grows with the angle of incidence."""
        ranges = mix_ranges(hits.distance, beside, self.mixed_share, rng)
        return np.asarray(ranges + rng.normal(0.0, 1.0, len(ranges)) * self.deviation(hits))

    def deviation(self, hits: Hits) -> Float[np.ndarray, "R"]:
        """Return the standard deviation of each range [m]."""
        slant = np.sqrt(1.0 - hits.cosine**2) / np.maximum(hits.cosine, 0.1)
        return np.asarray(self.sigma + self.grazing_gain * slant)


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole stereo camera with quantized disparity.

    Attributes:
        field_deg: horizontal field of view.
        baseline: distance between the two cameras [m].
        matching: standard deviation of the disparity [pixels].
        step: rounding step of the disparity [pixels].
        correlation: correlation length of the disparity error, due to the matching window [pixels].
        mixed_share: share of pixels on an edge that become flying pixels between both surfaces.
        slant_deg: angle of incidence above which holes become more frequent.
        hole_share: share of random holes.
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
    # A hole may be a surface without a stereo match, so it is no evidence of free space.
    tells_misses: bool = False

    @property
    def focal(self) -> float:
        """Focal length [pixels]."""
        return float(0.5 * self.width / np.tan(np.radians(self.field_deg) / 2.0))

    @property
    def footprint_deg(self) -> float:
        """Angular width of one pixel [deg]."""
        return float(np.degrees(1.0 / self.focal))

    def directions(self) -> Float[np.ndarray, "R 3"]:
        """Return one ray per pixel, row by row from the upper left."""
        column, row = np.meshgrid(np.arange(self.width), np.arange(self.height))
        y = (0.5 * (self.width - 1) - column.ravel()) / self.focal
        z = (0.5 * (self.height - 1) - row.ravel()) / self.focal
        rays = np.column_stack([np.ones(len(y)), y, z])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def measure(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Add flying pixels, holes, disparity noise and rounding."""
        forward = self.directions()[:, 0]
        depth = mix_ranges(hits.distance, beside, self.mixed_share, rng) * forward
        error = gaussian_filter(rng.normal(size=(self.height, self.width)), self.correlation, mode="wrap")
        disparity = self.focal * self.baseline / depth + self.matching * error.ravel() / error.std()
        disparity = self.step * np.round(disparity / self.step)
        seen = (disparity > 0.0) & (rng.random(len(depth)) > self._hole_share(hits))
        return np.where(seen, self.focal * self.baseline / np.where(seen, disparity, 1.0) / forward, np.nan)

    def deviation(self, depth: Float[np.ndarray, "R"]) -> Float[np.ndarray, "R"]:
        """Return the standard deviation of each depth, rounding included [m]."""
        pixels = np.hypot(self.matching, self.step / np.sqrt(12.0))
        return np.asarray(pixels * depth**2 / (self.focal * self.baseline))

    def _hole_share(self, hits: Hits) -> Float[np.ndarray, "R"]:
        """Return the probability that each pixel is a hole, which is 1 at grazing incidence."""
        limit = np.cos(np.radians(self.slant_deg))
        slanted = np.clip(1.0 - hits.cosine / limit, 0.0, 1.0)
        return np.asarray(np.maximum(slanted, self.hole_share))


@dataclass(frozen=True)
class TimeOfFlight(DepthCamera):
    """A pinhole camera that measures the time of flight of modulated light, with flying pixels along edges.

    Attributes:
        sigma: standard deviation of the range near the sensor [m].
        growth: additional deviation per square of the range [1/m].
        wiggle: amplitude of the error that repeats along the range [m].
    """

    field_deg: float = 75.0
    max_range: float = 5.5
    mixed_share: float = 0.8
    sigma: float = 0.004
    growth: float = 0.0005
    wiggle: float = 0.002

    def measure(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Add flying pixels, holes, noise that grows with the range, and the wiggling error."""
        ranges = mix_ranges(hits.distance, beside, self.mixed_share, rng)
        error = (self.sigma + self.growth * ranges**2) * rng.normal(size=len(ranges))
        error += self.wiggle * np.sin(4.0 * np.pi * ranges)
        return np.where(rng.random(len(ranges)) > self._hole_share(hits), ranges + error, np.nan)


_SCANNER = Scanner()


def scan(
    meshes: Sequence[Mesh],
    pose: Pose | None = None,
    sensor: Sensor = _SCANNER,
    seed: int = 0,
    *,
    misses: bool = False,
) -> Cloud:
    """Return a simulated scan of the meshes in world coordinates.

    Every ray stops at the first surface (real occlusion); at depth edges its range may mix two surfaces.

    Args:
        misses: whether rays without a return in range are included, with their ends at ``max_range``; sensors that
            cannot distinguish them from failed measurements include none.
    """
    pose = pose or Pose()
    rng = np.random.default_rng(seed)
    origin = np.array(pose.position)
    direction = sensor.directions() @ pose.rotation.T
    caster = Caster(join_meshes(meshes))
    hits = caster.hits(origin, direction)
    beside = caster.hits(origin, _aside(direction, sensor.footprint_deg, rng)).distance
    ranges = sensor.measure(hits, beside, rng)
    seen = np.isfinite(ranges) & (ranges > sensor.nearest) & (ranges < sensor.max_range)
    points = origin + ranges[seen, None] * direction[seen]
    if not misses or not sensor.tells_misses:
        return Cloud(points, origin)
    nothing = ~seen & (hits.distance > sensor.max_range) & (beside > sensor.max_range)
    return Cloud(points, origin, misses=origin + sensor.max_range * direction[nothing])


def _aside(
    direction: Float[np.ndarray, "R 3"], footprint_deg: float, rng: np.random.Generator
) -> Float[np.ndarray, "R 3"]:
    """Return each direction moved to a random point on the edge of its footprint."""
    aside = rng.normal(size=direction.shape)
    aside -= (aside * direction).sum(axis=1, keepdims=True) * direction
    aside *= np.tan(np.radians(footprint_deg)) / np.linalg.norm(aside, axis=1, keepdims=True)
    return np.asarray((direction + aside) / np.linalg.norm(direction + aside, axis=1, keepdims=True))
