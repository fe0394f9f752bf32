"""Simulated sensors: their pose, what each of them has, and ranges mixed up at edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.simulate.cast import Hits

_EDGE = 0.03


@dataclass(frozen=True)
class Pose:
    """Where the sensor is: position [m], then yaw, pitch (down positive) and roll [rad]."""

    position: tuple[float, float, float] = (0.12, 0.0, 1.6)
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @staticmethod
    def looking(position: tuple[float, float, float], target: Sequence[float], roll: float = 0.0) -> Pose:
        """From a place towards another."""
        x, y, z = np.subtract(target, position)
        return Pose(position, float(np.arctan2(y, x)), float(-np.arctan2(z, np.hypot(x, y))), roll)

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """World from sensor."""
        return np.asarray(Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix())

    @property
    def viewpoint(self) -> tuple[float, ...]:
        """x y z qw qx qy qz, as PCD files write it."""
        return (*self.position, *Rotation.from_matrix(self.rotation).as_quat(scalar_first=True).tolist())


class Sensor(Protocol):
    """A sensor is its rays and what it makes of where they end.

    Attributes:
        nearest: nothing nearer gives a point [m].
        max_range: nothing further gives a point [m].
        footprint_deg: width of a ray; at an edge it meets two surfaces.
        tells_misses: whether it can tell a ray that met nothing from one it failed to measure.
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
        """Unit directions of all rays in the sensor's frame (x forward, y left, z up)."""
        ...

    def measured(self, hits: Hits, beside: Float[np.ndarray, "R"], rng: np.random.Generator) -> Float[np.ndarray, "R"]:
        """Ranges as the sensor gives them [m]: NaN where it fails to measure, infinite where there was nothing.

        Args:
            hits: what the rays' middles met.
            beside: (R,) how far away is what their edges met [m].
            rng: of the noise.
        """
        ...


def mixed(
    first: Float[np.ndarray, "R"], beside: Float[np.ndarray, "R"], share: float, rng: np.random.Generator
) -> Float[np.ndarray, "R"]:
    """Ranges of which some at edges (more than 3 cm deep) lie anywhere between both surfaces.

    Args:
        first: what the rays' middles met [m].
        beside: what their edges met [m].
        share: how often an edge mixes both.
        rng: of the choice.
    """
    place = rng.random(len(first))
    both = np.isfinite(first) & np.isfinite(beside)
    gap = np.where(both, beside, 0.0) - np.where(both, first, 0.0)
    is_mixed = (np.abs(gap) > _EDGE) & (rng.random(len(first)) < share)
    return np.where(is_mixed, first + place * gap, first)
