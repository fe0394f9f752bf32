"""Flat patches of a cloud in any orientation, as evidence of floors, ceilings and walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.stopping import poll

_MOST_POINTS = 120_000
# Edge of a patch: share of its range, and least edge [m]; edges are the least one times a power of two.
_OF_RANGE, _SMALLEST, _LARGEST = 0.05, 0.06, 1.92
_FEWEST = 8
# Standard deviations of a flat patch as shares of its edge: least across, most along the normal.
_LEAST_WIDE, _MOST_THICK = 0.12, 0.12
_LEAST_SLENDER = 3.0
# Area of a uniform patch over the product of its two standard deviations.
_UNIFORM = 12.0
_GRAZING = 0.3


@dataclass(frozen=True)
class Surfaces:
    """Flat patches seen by a sensor.

    Attributes:
        centre: (P, 3) [m].
        normal: (P, 3) unit, towards the start of the rays.
        area: (P,) [m^2].
        range: (P,) distance from the start of the rays [m].
        edge: (P,) of the cube of its points [m].
        roughness: (P,) standard deviation of its points from its plane, along the rays [m].
    """

    centre: Float[np.ndarray, "P 3"]
    normal: Float[np.ndarray, "P 3"]
    area: Float[np.ndarray, "P"]
    range: Float[np.ndarray, "P"]
    edge: Float[np.ndarray, "P"]
    roughness: Float[np.ndarray, "P"]

    @property
    def weight(self) -> Float[np.ndarray, "P"]:
        """Area over range, the vote of a patch: near and far surfaces both count."""
        return np.asarray(self.area / np.maximum(self.range, _SMALLEST))

    def __len__(self) -> int:
        return len(self.area)

    def select(self, keep: Bool[np.ndarray, "P"]) -> Surfaces:
        """Return only these patches."""
        return Surfaces(
            self.centre[keep],
            self.normal[keep],
            self.area[keep],
            self.range[keep],
            self.edge[keep],
            self.roughness[keep],
        )


def find_surfaces(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"]) -> Surfaces:
    """Return the flat patches of a cloud: cubes of points, larger where they are far from the sensor, with a plane."""
    poll()
    step = -(-len(points) // _MOST_POINTS)
    points, starts = points[::step], starts[::step]
    ranges = np.linalg.norm(points - starts, axis=1)
    doubling = np.ceil(np.log2(np.clip(_OF_RANGE * ranges, _SMALLEST, _LARGEST) / _SMALLEST)).astype(np.int64)
    edge = _SMALLEST * 2.0**doubling
    cells = np.column_stack([doubling, np.floor(points / edge[:, None]).astype(np.int64)])
    _, first, number, count = np.unique(cells, axis=0, return_index=True, return_inverse=True, return_counts=True)
    number, n = number.reshape(-1), len(first)
    sums = [np.bincount(number, weights=column, minlength=n) for column in points.T]
    centre = np.stack(sums, axis=1) / count[:, None]
    apart = points - centre[number]
    covariance = np.empty((n, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            products = np.bincount(number, weights=apart[:, i] * apart[:, j], minlength=n)
            covariance[:, i, j] = covariance[:, j, i] = products / count
    poll()
    spread, axes = np.linalg.eigh(covariance)
    spread = np.sqrt(np.maximum(spread, 0.0))
    edge, starts, ranges = edge[first], starts[first], ranges[first]
    is_flat = (count >= _FEWEST) & (spread[:, 1] > _LEAST_WIDE * edge) & (spread[:, 0] < _MOST_THICK * edge)
    is_flat &= spread[:, 1] > _LEAST_SLENDER * spread[:, 0]
    normal = axes[:, :, 0]
    normal = normal * np.where(((starts - centre) * normal).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    area = np.minimum(_UNIFORM * spread[:, 1] * spread[:, 2], edge**2)
    return Surfaces(
        centre, normal, area, ranges, edge, spread[:, 0] * np.sqrt(count / np.maximum(count - 3.0, 1.0))
    ).select(is_flat)
