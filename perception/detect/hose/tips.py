"""Ends of slender objects: points beyond which no others follow in some direction, the last ones close together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from costs.stopping import poll

_BALL = 0.17
_DEPTH = 0.06
_BEYOND = 0.012
_MOST_NEAR = 120
_LEAST_LOPSIDED = 0.03
_DIRECTIONS = 96
_LEAST_POINTS = 8
_BLOCK = 200
_APART = 0.03
_ALIKE = 0.8


@dataclass(frozen=True)
class Tip:
    """End of a slender object.

    Attributes:
        place: (3,) centre of the outermost points, the cap [m].
        axis: (3,) unit, out of the end.
        radius: of the circle that encloses the cap, across the axis [m].
        n_points: number of points of the cap.
    """

    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    n_points: int


def find_tips(points: Float[np.ndarray, "N 3"], places: Float[np.ndarray, "K 3"], widest: float) -> list[Tip]:
    """Return ends of radius below ``widest`` [m], most points first; no two with nearly equal position and axis.

    Args:
        points: (N, 3) thinned evenly [m].
        places: (K, 3) the points among them to test as ends [m].
    """
    if not len(places) or len(points) < _LEAST_POINTS:
        return []
    tree, ways = cKDTree(points), spread_directions(_DIRECTIONS)
    tips: list[Tip] = []
    for block in np.array_split(places, -(-len(places) // _BLOCK)):
        poll()
        distance, near = tree.query(block, _MOST_NEAR, distance_upper_bound=_BALL)
        is_near = np.isfinite(distance)
        offset = np.where(is_near[:, :, None], points[np.minimum(near, len(points) - 1)] - block[:, None], 0.0)
        # At an end, all neighbours lie on one side.
        mean = offset.sum(axis=1) / is_near.sum(axis=1, keepdims=True)
        lopsided = np.linalg.norm(mean, axis=1) > _LEAST_LOPSIDED
        tips += _in_block(block[lopsided], offset[lopsided], is_near[lopsided], ways, widest)
    tips.sort(key=lambda tip: -tip.n_points)
    kept: list[Tip] = []
    for tip in tips:
        poll()
        if all(np.linalg.norm(tip.place - other.place) > _APART or tip.axis @ other.axis < _ALIKE for other in kept):
            kept.append(tip)
    return kept


def _in_block(
    places: Float[np.ndarray, "K 3"],
    offset: Float[np.ndarray, "K M 3"],
    is_near: Bool[np.ndarray, "K M"],
    ways: Float[np.ndarray, "D 3"],
    widest: float,
) -> list[Tip]:
    """Return the tips among the tested points: no neighbour more than 12 mm ahead, and a cap below ``widest``."""
    poll()
    ahead = np.where(is_near[:, None], np.einsum("kmi,di->kdm", offset, ways), -np.inf)
    of_place, of_way = np.nonzero(ahead.max(axis=2) < _BEYOND)
    tips = []
    for i, j in zip(of_place.tolist(), of_way.tolist(), strict=True):
        poll()
        cap = offset[i][ahead[i, j] > -_DEPTH]
        if len(cap) < _LEAST_POINTS:
            continue
        lateral = cap - (cap @ ways[j])[:, None] * ways[j]
        middle = 0.5 * (lateral.min(axis=0) + lateral.max(axis=0))
        radius = float(np.linalg.norm(lateral - middle, axis=1).max())
        if radius < widest:
            tips.append(Tip(places[i] + middle, ways[j], radius, len(cap)))
    return tips


def spread_directions(n: int) -> Float[np.ndarray, "n 3"]:
    """Return unit directions spread evenly over the sphere (Fibonacci's lattice)."""
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
