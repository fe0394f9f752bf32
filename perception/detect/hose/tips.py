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
_BLOCK = 100  # places, so that the arrays stay in the cache
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
    # The tree gives the number of points for a neighbour that is missing.
    padded = np.concatenate([points, np.zeros((1, 3))])
    tips: list[Tip] = []
    for block in np.array_split(places, -(-len(places) // _BLOCK)):
        poll()
        distance, near = (np.asarray(of) for of in tree.query(block, _MOST_NEAR, distance_upper_bound=_BALL))
        is_near = np.isfinite(distance)
        # At an end, all neighbours lie on one side.
        mean = padded.take(near, 0).sum(axis=1) / is_near.sum(axis=1, keepdims=True)
        lopsided = np.flatnonzero(np.linalg.norm(mean - block, axis=1) > _LEAST_LOPSIDED)
        block, is_near = block[lopsided], is_near[lopsided]
        offset = np.where(is_near[:, :, None], padded[near[lopsided]] - block[:, None], 0.0).astype(np.float32)
        tips += _in_block(block, offset, is_near, ways, widest)
    tips.sort(key=lambda tip: -tip.n_points)
    return _drop_duplicates(tips)


def _drop_duplicates(tips: list[Tip]) -> list[Tip]:
    """Return the tips without those of nearly the position and axis of one before them."""
    if not tips:
        return []
    places, axes = np.array([tip.place for tip in tips]), np.array([tip.axis for tip in tips])
    is_left = np.ones(len(tips), dtype=bool)
    kept: list[Tip] = []
    for i, tip in enumerate(tips):
        if not is_left[i]:
            continue
        poll()
        kept.append(tip)
        is_alike = (((places[i:] - places[i]) ** 2).sum(axis=1) <= _APART**2) & (axes[i:] @ axes[i] >= _ALIKE)
        is_left[i:][is_alike] = False
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
    if not len(places):
        return []
    ahead = offset @ ways.T.astype(np.float32)
    ahead[~is_near] = -np.inf
    of_place, of_way = np.nonzero(ahead.max(axis=1) < _BEYOND)
    is_cap = ahead[of_place, :, of_way] > -_DEPTH
    n_points = np.count_nonzero(is_cap, axis=1)
    enough = n_points >= _LEAST_POINTS
    of_place, of_way, is_cap, n_points = of_place[enough], of_way[enough], is_cap[enough], n_points[enough]
    poll()
    axes = ways[of_way]
    lateral = offset[of_place] - ahead[of_place, :, of_way].clip(-1.0)[:, :, None] * axes[:, None]
    low = np.where(is_cap[:, :, None], lateral, np.inf).min(axis=1)
    high = np.where(is_cap[:, :, None], lateral, -np.inf).max(axis=1)
    middle = 0.5 * (low + high)
    poll()
    away = ((lateral - middle[:, None]) ** 2).sum(axis=2)
    radius = np.sqrt(np.where(is_cap, away, 0.0).max(axis=1))
    return [
        Tip(places[of_place[i]] + middle[i], axes[i], float(radius[i]), int(n_points[i]))
        for i in np.flatnonzero(radius < widest)
    ]


def spread_directions(n: int) -> Float[np.ndarray, "n 3"]:
    """Return unit directions spread evenly over the sphere (Fibonacci's lattice)."""
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
