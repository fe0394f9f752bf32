"""A solid-state lidar with turning prisms: a rosette within a cone that never repeats itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.simulate.cast import Hits
from perception.simulate.sensor import mixed

# Turns per second of the two prisms: their ratio is far from a ratio of small whole numbers, so the rosette fills.
_TURNS = (121.5, -77.7)


@dataclass(frozen=True)
class SolidState:
    """What it sees in one exposure.

    Attributes:
        n_points: pulses.
        rate: pulses per second.
        field_deg: full angle of the cone.
        sigma: standard deviation of the range at right angles to the surface [m].
        grazing_gain: further deviation per tangent of the angle of incidence [m].
        max_range: [m].
        footprint_deg: width of a beam.
        mixed_share: how often a beam on an edge gives a range between both surfaces.
        nearest: [m].
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
        """Two prisms of equal strength bend the beam one after the other."""
        time = np.arange(self.n_points) / self.rate
        bent = sum(np.exp(2j * np.pi * turns * time) for turns in _TURNS) * np.radians(self.field_deg) / 4.0
        angle = np.abs(bent)
        side = np.sin(angle) / np.maximum(angle, 1e-12)
        return np.column_stack([np.cos(angle), side * np.real(bent), side * np.imag(bent)])

    def measured(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Mixed pixels at edges, and noise that grows on surfaces seen at a slant."""
        ranges = mixed(hits.distance, beside, self.mixed_share, rng)
        return np.asarray(ranges + rng.normal(0.0, 1.0, len(ranges)) * self.deviation(hits))

    def deviation(self, hits: Hits) -> Float[np.ndarray, "R"]:
        """Standard deviation of each range [m]."""
        slant = np.sqrt(1.0 - hits.cosine**2) / np.maximum(hits.cosine, 0.1)
        return np.asarray(self.sigma + self.grazing_gain * slant)
