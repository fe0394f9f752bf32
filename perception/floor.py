"""The floor: a plane under the robot's feet, what belongs to it, and the box that stands for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece
from perception.clean import Reach

SOLE_MARGIN = 0.03
_MAX_SLOPE_DEG = 6.0
_LAYER = 0.02
_BAND = 0.025
_MIN_AREA = 0.25
_CELL = 0.1
_MOST_UPRIGHT = 0.6
_MOST_BELOW = 0.05
_EXTENSION = 1.0
_THICKNESS = 0.2


@dataclass(frozen=True)
class FloorPlane:
    """The plane ``normal . x == offset``.

    Attributes:
        normal: (3,) unit, upwards.
        offset: [m].
        rms: scatter of its points about it [m].
        area: seen area [m^2].
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    rms: float
    area: float

    def height(self, xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """World z of the floor at the given places [m]."""
        return np.asarray((self.offset - xy @ self.normal[:2]) / self.normal[2])

    def above(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Distance over the plane [m], negative below."""
        return np.asarray(points @ self.normal - self.offset)


def find_floor(points: Float[np.ndarray, "N 3"], seed: int = 0) -> FloorPlane | None:
    """The lowest large plane that slopes by at most 6 degrees; None when there is none.

    Candidate planes through three random points are scored by the seen area, lower ones first when equally large.
    """
    low = points[points[:, 2] < np.percentile(points[:, 2], 1.0) + 1.0] if len(points) else points
    if len(low) < 50:
        return None
    sample = low[:: max(1, len(low) // 6000)]
    normals, offsets = _candidates(sample, np.random.default_rng(seed))
    if not len(normals):
        return None
    above = sample @ normals.T - offsets
    near = np.abs(above) < _BAND
    # Nothing lies under a floor but noise; a table with things under it is none.
    counts = near.sum(axis=0) * ((above < -2 * _BAND).mean(axis=0) < _MOST_BELOW)
    if not counts.any():
        return None
    # A table can hold more points than the floor: take the lowest of those that hold a good part of the most.
    strong = np.flatnonzero(counts >= 0.5 * counts.max())
    heights = np.array([np.median(sample[near[:, i], 2]) for i in strong])
    lowest = strong[heights <= heights.min() + _LAYER]
    best = int(lowest[np.argmax(counts[lowest])])
    return _refined(low, normals[best], float(offsets[best]))


def _candidates(
    points: Float[np.ndarray, "N 3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "H 3"], Float[np.ndarray, "H"]]:
    """Planes through random triples, nearly horizontal ones only."""
    triples = points[rng.integers(len(points), size=(600, 3))]
    # A second batch from thin layers: a floor that holds few of the points is met by it as well.
    heights = points[np.argsort(points[:, 2])]
    starts = rng.integers(max(1, len(heights) - 60), size=(300, 1))
    triples = np.concatenate([triples, heights[np.minimum(starts + rng.integers(60, size=(300, 3)), len(heights) - 1)]])
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    upright = np.abs(normals[:, 2]) > np.cos(np.radians(_MAX_SLOPE_DEG)) * np.maximum(lengths, 1e-9)
    normals = normals[upright] / (lengths[upright] * np.sign(normals[upright, 2]))[:, None]
    return normals, (normals * triples[upright, 0]).sum(axis=1)


def _refined(points: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, "3"], offset: float) -> FloorPlane | None:
    """Least-squares plane of the points near the candidate, taken thrice with a narrowing band."""
    for band in (2 * _BAND, _BAND, _BAND):
        members = points[np.abs(points @ normal - offset) < band]
        if len(members) < 50:
            return None
        centre = members.mean(axis=0)
        normal = np.linalg.eigh(np.cov((members - centre).T))[1][:, 0]
        normal = normal * np.sign(normal[2])
        offset = float(normal @ centre)
    area = len(np.unique(np.floor(members[:, :2] / _CELL), axis=0)) * _CELL**2
    if area < _MIN_AREA or normal[2] < np.cos(np.radians(_MAX_SLOPE_DEG)):
        return None
    if _is_slice(points, np.abs(points @ normal - offset), members):
        return None
    return FloorPlane(normal, offset, float(np.std(members @ normal - offset)), float(area))


def _is_slice(
    points: Float[np.ndarray, "N 3"], distance: Float[np.ndarray, "N"], members: Float[np.ndarray, "K 3"]
) -> bool:
    """Whether most places of the plane go on above or below it: then it cuts through walls and clutter."""

    def places(of: Float[np.ndarray, "M 3"]) -> set[tuple[int, int]]:
        return {(int(i), int(j)) for i, j in np.unique(np.floor(of[:, :2] / _CELL), axis=0)}

    mine = places(members)
    going_on = places(points[(distance > 2 * _BAND) & (distance < 10 * _BAND)])
    return len(mine & going_on) > _MOST_UPRIGHT * len(mine)


def on_floor(
    points: Float[np.ndarray, "N 3"],
    floor: FloorPlane,
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    clearance: float = 0.02,
) -> Bool[np.ndarray, "N"]:
    """Points that belong to the floor: below it, up to ``clearance`` over it, and up to 3 cm over it under a sole.

    Args:
        points: (N, 3) [m].
        floor: the plane.
        soles: corners (S, 3) of each convex sole, any order, world [m].
        clearance: [m].
    """
    above = floor.above(points)
    mask = above <= clearance
    for sole in soles:
        mask |= (above <= SOLE_MARGIN) & _under(points[:, :2], np.asarray(sole)[:, :2])
    return np.asarray(mask)


def _under(xy: Float[np.ndarray, "N 2"], polygon: Float[np.ndarray, "S 2"]) -> Bool[np.ndarray, "N"]:
    """Which places lie inside the convex polygon, corners in any order."""
    centre = polygon.mean(axis=0)
    order = np.argsort(np.arctan2(*(polygon - centre).T[::-1]))
    corners = polygon[order]
    edges = np.roll(corners, -1, axis=0) - corners
    relative = xy[:, None, :] - corners
    return np.asarray((edges[:, 0] * relative[..., 1] - edges[:, 1] * relative[..., 0] >= -1e-12).all(axis=1))


def floor_piece(floor: FloorPlane, reach: Reach) -> ConvexPiece:
    """A box ``floor`` 0.2 m thick whose top face is the plane, reaching 1 m beyond the reach."""
    half = reach.radius + _EXTENSION
    xy = np.array([(reach.x + sx * half, reach.y + sy * half) for sx in (-1, 1) for sy in (-1, 1)])
    top = np.column_stack([xy, floor.height(xy)])
    return ConvexPiece("floor", np.concatenate([top, top - [0.0, 0.0, _THICKNESS]]), kind="floor")
