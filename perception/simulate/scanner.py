"""A spinning line scanner: beams in a fan that turns about the sensor's forward axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.simulate.cast import Hits
from perception.simulate.sensor import mixed


@dataclass(frozen=True)
class Scanner:
    """What a scan looks like.

    Attributes:
        n_beams: beams of the fan.
        fan_deg: angle of the fan, about the forward axis.
        n_lines: positions of the fan over half a turn, which together see all around.
        sigma: standard deviation of the range [m].
        max_range: beams that meet nothing nearer give no point [m].
        footprint_deg: width of a beam; when it meets two surfaces the range can lie between.
        mixed_share: how often it then does.
        nearest: what is nearer gives no point [m].
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
        """Unit directions of all beams in the sensor's frame (x forward, z up)."""
        beam = np.radians(np.linspace(-self.fan_deg / 2, self.fan_deg / 2, self.n_beams))
        turn = np.pi * np.arange(self.n_lines) / self.n_lines
        beam, turn = (grid.ravel() for grid in np.meshgrid(beam, turn))
        return np.column_stack([np.cos(beam), np.sin(beam) * np.cos(turn), np.sin(beam) * np.sin(turn)])

    def measured(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Mixed pixels at edges, and noise that does not depend on the range."""
        ranges = mixed(hits.distance, beside, self.mixed_share, rng)
        return ranges + rng.normal(0.0, self.sigma, len(ranges))
