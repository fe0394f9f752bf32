"""Upright planes of walls and door leaves, found by voting over yaw and offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import poll
from perception.cleaning.clean import voxel_downsample, voxel_index

_MOST_PLANES = 10
_VOXEL = 0.04
_BIN = 0.03
_ANGLES = np.radians(np.arange(0.0, 180.0, 1.0))
_LEAST_HEIGHT = 6  # voxels one above the other that make a column
_LEAST_COLUMNS = 6


@dataclass(frozen=True)
class Upright:
    """The vertical plane ``normal . x == offset``, with coordinates on it.

    Attributes:
        normal: (3,) unit, horizontal, towards the sensor.
    """

    normal: Float[np.ndarray, "3"]
    offset: float

    @property
    def along(self) -> Float[np.ndarray, "3"]:
        """(3,) unit, horizontal, in the plane; along, up and minus the normal are right-handed."""
        return np.array([-self.normal[1], self.normal[0], 0.0])

    def local(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Return (N, 3) coordinates along the plane, up (world z), and out of it towards the sensor [m]."""
        poll()
        return np.column_stack([points @ self.along, points[:, 2], points @ self.normal - self.offset])

    def place(self, along: float, height: float = 0.0, out: float = 0.0) -> Float[np.ndarray, "3"]:
        """Return (3,) world coordinates of a position given in the coordinates of :meth:`local` [m]."""
        return np.asarray((self.offset + out) * self.normal + along * self.along + [0.0, 0.0, height])


def fit_upright(points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"]) -> Upright:
    """Return the least-squares vertical plane, its normal towards ``origin``."""
    centre = points[:, :2].mean(axis=0)
    flat = np.linalg.eigh(np.cov((points[:, :2] - centre).T))[1][:, 0]
    normal = np.array([flat[0], flat[1], 0.0])
    if normal[:2] @ (origin[:2] - centre) < 0.0:
        normal = -normal
    return Upright(normal, float(normal[:2] @ centre))


def settle_plane(
    start: Upright, points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], band: float
) -> Upright:
    """Return the plane refitted five times to the points within ``band`` of it [m]."""
    plane = start
    for _ in range(5):
        near = np.abs(points @ plane.normal - plane.offset) < band
        if near.sum() < 10:
            return plane
        plane = fit_upright(points[near], origin)
    return plane


def find_uprights(points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"]) -> list[Upright]:
    """Return vertical planes by the votes of the columns of points on them, most first.

    Parallel faces within a few centimetres (a leaf in its wall) give one plane: votes do not separate them.

    Args:
        points: (N, 3) without floor [m].
    """
    if len(points) < 20:
        return []
    means, _ = voxel_downsample(points, _VOXEL)
    flat = np.column_stack([means[:, :2], np.zeros(len(means))])
    column, n_columns = voxel_index(flat, _VOXEL)
    height = np.bincount(column, minlength=n_columns)
    centre = np.stack([np.bincount(column, means[:, k], n_columns) for k in range(2)], axis=1) / height[:, None]
    tall = height >= _LEAST_HEIGHT
    centre, weight = centre[tall], np.minimum(height[tall], 30).astype(float)
    planes: list[Upright] = []
    standing = np.ones(len(means), dtype=bool)
    left = np.ones(len(centre), dtype=bool)
    for _ in range(_MOST_PLANES):
        if left.sum() < _LEAST_COLUMNS:
            break
        plane = _most_voted(centre[left], weight[left], origin)
        plane = settle_plane(plane, means[standing], origin, 0.04)
        on = left & (np.abs(centre @ plane.normal[:2] - plane.offset) < 0.05)
        if on.sum() < _LEAST_COLUMNS:
            break
        planes.append(plane)
        left &= ~on
    return planes


def _most_voted(
    centre: Float[np.ndarray, "C 2"], weight: Float[np.ndarray, "C"], origin: Float[np.ndarray, "3"]
) -> Upright:
    normals = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    offset = centre @ normals
    cell = np.floor(offset / _BIN).astype(int)
    low = int(cell.min())
    width = int(cell.max()) - low + 2
    votes = np.zeros(len(_ANGLES) * width)
    index = np.arange(len(_ANGLES)) * width + cell - low
    votes += np.bincount(index.ravel(), np.broadcast_to(weight[:, None], index.shape).ravel(), len(votes))
    grid = votes.reshape(len(_ANGLES), width)
    pairs = grid[:, :-1] + grid[:, 1:]
    angle, place = np.unravel_index(int(np.argmax(pairs)), pairs.shape)
    normal = np.array([*normals[:, angle], 0.0])
    value = (place + low + 1) * _BIN
    if normal @ origin < value:
        normal, value = -normal, -value
    return Upright(normal, float(value))
