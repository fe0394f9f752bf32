"""Circle hypotheses drawn through seeds of a cloud and pairs of points near each, for many seeds at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.cleaning.clean import row_keys
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.nearby import Nearby, Neighbours
from perception.detect.valve.circle_fit import Circles, Inliers, ScoredCircles, score_circles, sort_points

_SUBSAMPLE, _LOOKED_AT, _KEPT = 80, 8, 2
_FEWEST_NEAR = 12
_LEAST_SQUARE = 1e-8
_FAR = 100.0  # where missing points are put, so that they lie on no circle [m]
_AT_ONCE = 24  # seeds, so that the arrays stay in the cache


@dataclass(frozen=True)
class Ball:
    """Neighbourhood in which circles are drawn.

    Attributes:
        radius: [m].
        radii: least and greatest radius of the circles [m].
        n_points, n_pairs: number of points, and of pairs of them, drawn about each seed.
        cell: edge of the cells that have seeds of their own [m].
        n_seeds: number of slender seeds and of others in each cell.
    """

    radius: float
    radii: tuple[float, float]
    n_points: int
    n_pairs: int
    cell: float
    n_seeds: tuple[int, int]


def draw_circles(nearby: Nearby, seeds: Int[np.ndarray, "S"], ball: Ball) -> Iterator[ScoredCircles]:
    """Yield the two best circles through each seed and two points in the ball about it, or fewer.

    In clutter, two points on the seed's rim are drawn sooner than three points on one rim.  The most likely ones by a
    part of the points are compared on all points drawn.  What is drawn depends on the points about the seed alone.
    """
    places = nearby.points[seeds]
    for near in nearby.list_near(places, np.full(len(seeds), ball.radius)):
        some = places[near.first : near.last]
        for first in range(0, len(some), _AT_ONCE):
            poll()
            part = slice(first, first + _AT_ONCE)
            local, counts = _sample(nearby, near, some, part, ball)
            enough = counts >= _FEWEST_NEAR
            if enough.any():
                yield _draw(local[enough], counts[enough], some[part][enough], ball)


def _sample(
    nearby: Nearby, near: Neighbours, places: Float[np.ndarray, "P 3"], part: slice, ball: Ball
) -> tuple[Float[np.ndarray, "S 3 K"], Int[np.ndarray, "S"]]:
    """Return points about some seeds, from the seed [m], evenly chosen from those in the ball, and their numbers."""
    first = int(near.counts[: part.start].sum())
    counts = near.counts[part]
    of = np.repeat(np.arange(len(counts)), counts)
    offset = nearby.points.take(near.points[first : first + len(of)], 0) - places[part].take(of, 0)
    inside = np.flatnonzero(np.einsum("ki,ki->k", offset, offset) < ball.radius**2)
    n_inside = np.bincount(of[inside], minlength=len(counts))
    before = np.cumsum(n_inside) - n_inside
    step = np.arange(ball.n_points)
    spread = ((step + _fractions(places[part], 1)[:, :1]) * (n_inside / ball.n_points)[:, None]).astype(np.int64)
    chosen = np.where((n_inside > ball.n_points)[:, None], spread, step)
    is_there = chosen < n_inside[:, None]
    local = np.full((len(counts), 3, ball.n_points), _FAR, dtype=np.float32)
    row, column = np.nonzero(is_there)
    local[row, :, column] = offset[inside[before[row] + chosen[row, column]]]
    return local, np.minimum(n_inside, ball.n_points)


def _draw(
    local: Float[np.ndarray, "S 3 K"], counts: Int[np.ndarray, "S"], places: Float[np.ndarray, "S 3"], ball: Ball
) -> ScoredCircles:
    """Return the best circles of each seed by its sample."""
    rows = np.arange(len(local))[:, None]
    pairs = (_fractions(places, 2 * ball.n_pairs) * counts[:, None]).astype(np.int64)
    u, v = (local[rows, :, pairs[:, i::2]] for i in range(2))
    centres, axes, radii, is_there = _circles_through(u, v)
    is_there &= (radii >= ball.radii[0]) & (radii <= ball.radii[1])
    # The circles that are there come first.
    order = np.argsort(~is_there, axis=1, kind="stable")[:, : max(1, int(is_there.sum(axis=1).max()))]
    centres, axes, radii, is_there = (x[rows, order] for x in (centres, axes, radii, is_there))
    some = ((np.arange(_SUBSAMPLE) + 0.5) / _SUBSAMPLE * counts[:, None]).astype(np.int64)
    quality, _ = _compare(np.take_along_axis(local, some[:, None], axis=2), centres, axes, radii, is_there)
    likely = np.argsort(-quality, axis=1, kind="stable")[:, :_LOOKED_AT]
    centres, axes, radii, is_there = (x[rows, likely] for x in (centres, axes, radii, is_there))
    quality, on = _compare(local, centres, axes, radii, is_there)
    best = np.argsort(-quality, axis=1, kind="stable")[:, :_KEPT]
    return _score(local, places, best, quality, on, (centres, axes, radii, is_there))


def _circles_through(
    u: Float[np.ndarray, "S T 3"], v: Float[np.ndarray, "S T 3"]
) -> tuple[Float[np.ndarray, "S T 3"], Float[np.ndarray, "S T 3"], Float[np.ndarray, "S T"], Bool[np.ndarray, "S T"]]:
    """Return centres, axes and radii of the circles through zero, u and v, and which of these are not collinear."""
    normal = cross(u, v)
    square = (normal**2).sum(axis=2)
    good = square > _LEAST_SQUARE
    square = np.where(good, square, 1.0)
    uu, vv = (u**2).sum(axis=2)[:, :, None], (v**2).sum(axis=2)[:, :, None]
    centres = (uu * cross(v, normal) + vv * cross(normal, u)) / (2.0 * square[:, :, None])
    return centres, normal / np.sqrt(square)[:, :, None], np.sqrt((centres**2).sum(axis=2)), good


def _compare(
    local: Float[np.ndarray, "S 3 K"],
    centres: Float[np.ndarray, "S C 3"],
    axes: Float[np.ndarray, "S C 3"],
    radii: Float[np.ndarray, "S C"],
    is_there: Bool[np.ndarray, "S C"],
) -> tuple[Float[np.ndarray, "S C"], Bool[np.ndarray, "S C K"]]:
    """Return count times share of the points on each circle, -1 for one that is not there, and these points."""
    poll()
    # Squares of the points' heights over each circle's plane and of their distances from its centre.
    height = axes @ local - (axes * centres).sum(axis=2)[:, :, None]
    height *= height
    square = (-2.0 * centres) @ local
    square += (local**2).sum(axis=1)[:, None]
    square += (centres**2).sum(axis=2)[:, :, None]
    on, in_disc = sort_points(height, square, radii[:, :, None])
    count = np.count_nonzero(on, axis=2)
    share = count / np.maximum(np.count_nonzero(in_disc, axis=2), 1)
    return np.where(is_there, count * share, -1.0), on


def _score(
    local: Float[np.ndarray, "S 3 K"],
    places: Float[np.ndarray, "S 3"],
    best: Int[np.ndarray, "S B"],
    quality: Float[np.ndarray, "S C"],
    on: Bool[np.ndarray, "S C K"],
    circles: tuple[np.ndarray, ...],
) -> ScoredCircles:
    """Return the chosen circles of each seed that are there, with their scores, in the world."""
    rows = np.arange(len(local))[:, None]
    seed, column = np.nonzero(circles[3][rows, best])
    which = best[seed, column]
    centres, axes, radii = (x[seed, which].astype(np.float64) for x in circles[:3])
    circle, point = np.nonzero(on[seed, which])
    count = np.bincount(circle, minlength=len(seed))
    offset = local[seed[circle], :, point] - centres[circle]
    share = quality[seed, which] / np.maximum(count, 1)
    mine = Circles(places[seed] + centres, axes, radii)
    return score_circles(mine, Inliers(circle, offset, count, share))


def _fractions(places: Float[np.ndarray, "S 3"], n: int) -> Float[np.ndarray, "S n"]:
    """Return numbers from 0 to 1 that look random and depend on each place alone."""
    drawn = np.random.default_rng(0).random(n)
    turn = (row_keys(places).view(np.uint64) >> np.uint64(11)).astype(np.float64) / 2.0**53
    return np.asarray((drawn + turn[:, None]) % 1.0)
