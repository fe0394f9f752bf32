"""Candidates for the long faces of bars in a cloud: flat strips with few points in their plane just beside them.

In a heap a bar's points have close neighbours on all sides, but few of those are in the plane of one of its faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.nearby import Nearby
from perception.detect.shared.slender import is_slender, variances_about

_MOST_SEEDS = 220
_BALL = 0.3
_FIRST_BALL, _SECOND_BALL = 0.055, 0.11
_ROW = 0.15
_THICK = 0.02
_BIN, _FINE = 0.04, 0.01
_N_ALONG, _N_ACROSS = 15, 44
_RING = 3
_WIDTHS = (5, 10, 15)
_EDGES = {width: np.unique(np.linspace(1, width - 1, 4).astype(np.int64)) for width in _WIDTHS}
_ANGLES = np.radians(np.arange(0.0, 180.0, 12.0))
_GAP = 6
_NARROWEST, _WIDEST = 0.022, 0.17
_LEAST_BINS = 4
_LEAST_SCORE = 4
_MOST_NEAR = 250
_BATCH = 40
_FEWEST_NEAR = 20
_SHARED = 0.5
_CORRIDOR = 0.25
_WALL_CELL, _WALL_WIDE, _WALL_THICK = 0.12, 0.3, 3e-4
_MANY, _NOISY_CELL, _NOISY_THICK = 15_000, 0.25, 1e-3
_NEAR_CELL, _NEAR_THICK, _AS_THICK = 0.05, 6e-4, 2.0
_BEND_BIN = 0.04
_FEWEST_BINS, _FEWEST_IN_BIN = 6, 2
# Least rms residual of one line for a bend [m], and largest share of its squares that two lines may leave.
_BENT, _LEFT = 0.006, 0.4


@dataclass(frozen=True)
class Strip:
    """Long flat face.

    Attributes:
        place: (3,) point on its middle line [m].
        axis: (3,) unit, along it.
        normal: (3,) unit, square to it, towards the sensor.
        half: half of its width [m].
        first, last: its ends, from ``place`` along ``axis`` [m].
        members: (K, 3) its points [m].
        score: number of bins along it with few points beside them, minus those with more.
    """

    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    half: float
    first: float
    last: float
    members: Float[np.ndarray, "K 3"]
    score: float

    def places(self, n: int) -> Float[np.ndarray, "n 3"]:
        """Return n points evenly spaced on its middle line, from end to end [m]."""
        return np.asarray(self.place + np.linspace(self.first, self.last, n)[:, None] * self.axis)


def find_strips(
    points: Float[np.ndarray, "N 3"],
    towards: Float[np.ndarray, "3"],
    rng: np.random.Generator,
    most: int = 40,
) -> list[Strip]:
    """Return at most ``most`` strips, best first; most of a strip's points are in no strip found before it.

    Args:
        points: (N, 3) thinned evenly [m].
    """
    points = points[~_in_walls(points)]
    if len(points) < 20:
        return []
    tree, nearby = cKDTree(points), Nearby.of(points)
    seeds = rng.choice(len(points), min(_MOST_SEEDS, len(points)), replace=False)
    taken = np.zeros(len(points), dtype=bool)
    strips: list[Strip] = []
    for batch in np.array_split(seeds, max(1, len(seeds) // _BATCH)):
        # Points of a strip are no seeds again.
        batch = batch[~taken[batch]]
        starts = []
        for seed, near in zip(batch, tree.query_ball_point(points[batch], _BALL, return_sorted=True), strict=True):
            start = _best_at_seed(points, int(seed), np.asarray(near, dtype=np.int64), rng)
            if start is not None:
                starts.append((*start, int(seed)))
        starts.sort(key=lambda start: -start[0])
        for _, axis, normal, across, seed in starts:
            if taken[seed]:
                continue
            grown = _grow(nearby, points[seed], axis, normal, across, towards)
            if grown is None:
                continue
            strip, members = grown
            if taken[members].mean() < _SHARED:
                taken[members] = True
                strips.append(strip)
    return sorted(strips, key=lambda strip: -strip.score)[:most]


def _in_walls(points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points are in the middle of a flat surface wider than a bar."""
    variances = variances_about(points, _WALL_CELL)
    if variances is None:
        return np.zeros(len(points), dtype=bool)
    is_wall = (variances[:, 1] > _WALL_WIDE * variances[:, 2]) & (variances[:, 0] < _WALL_THICK)
    rest = np.flatnonzero(~is_wall)
    if len(rest) > _MANY:
        # A wall far from a camera is noisier, but as thick in a large neighbourhood as in a small one.
        near = variances_about(points, _NEAR_CELL)
        if near is not None:
            is_even = (variances[:, 0] < _NEAR_THICK) & (variances[:, 0] < _AS_THICK * near[:, 0])
            is_wall |= is_even & (variances[:, 1] > _WALL_WIDE * variances[:, 2])
        wider = variances_about(points[rest], _NOISY_CELL)
        if wider is not None:
            is_noisy = (wider[:, 1] > _WALL_WIDE * wider[:, 2]) & (wider[:, 0] < _NOISY_THICK)
            is_wall[rest[is_noisy & ~is_slender(points[rest])]] = True
    return np.asarray(is_wall)


_Start = tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"], tuple[float, float]]


def _best_at_seed(
    points: Float[np.ndarray, "N 3"], seed: int, local: Int[np.ndarray, "K"], rng: np.random.Generator
) -> _Start | None:
    """Return the best strip through a seed: score, axis, normal, and its two edges across, from the seed [m]."""
    poll()
    if len(local) < _FEWEST_NEAR:
        return None
    if len(local) > _MOST_NEAR:
        local = np.sort(rng.choice(local, _MOST_NEAR, replace=False))
    offset = points[local] - points[seed]
    distance2 = np.einsum("ni,ni->n", offset, offset)
    for radius in (_FIRST_BALL, _SECOND_BALL):
        patch = offset[distance2 < radius**2]
        if len(patch) < 6:
            continue
        values, vectors = np.linalg.eigh(np.cov(patch.T))
        # One row of a scan has no normal.
        if values[1] > _ROW * values[2]:
            break
    else:
        return None
    normal = vectors[:, 0]
    # Fit the normal again to a larger patch near that plane.
    patch = offset[(distance2 < _SECOND_BALL**2) & (np.abs((offset - patch.mean(axis=0)) @ normal) < _THICK)]
    if len(patch) < 8:
        return None
    normal, middle = np.linalg.eigh(np.cov(patch.T))[1][:, 0], patch.mean(axis=0)
    flat = offset[np.abs((offset - middle) @ normal) < _THICK]
    first = cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    second = cross(normal, first)
    x, y = flat @ first, flat @ second
    cos, sin = np.cos(_ANGLES)[:, None], np.sin(_ANGLES)[:, None]
    along = ((cos * x + sin * y + _BALL) / _BIN).astype(np.int64).clip(0, _N_ALONG - 1)
    across = np.floor((cos * y - sin * x) / _FINE).astype(np.int64) + _N_ACROSS // 2
    is_near = (across >= 0) & (across < _N_ACROSS)
    cell = (np.arange(len(_ANGLES))[:, None] * _N_ALONG + along) * _N_ACROSS + across
    shape = (len(_ANGLES), _N_ALONG, _N_ACROSS)
    count = np.bincount(cell[is_near], minlength=int(np.prod(shape))).reshape(shape)
    total = np.zeros((*shape[:2], _N_ACROSS + 1), dtype=np.int64)
    np.cumsum(count, axis=2, out=total[:, :, 1:])
    best: tuple[float, int, tuple[int, int]] | None = None
    for width in _WIDTHS:
        lows = _N_ACROSS // 2 - _EDGES[width]
        highs = lows + width
        inside = total[:, :, highs] - total[:, :, lows]
        beside = total[:, :, highs + _RING] - total[:, :, highs] + total[:, :, lows] - total[:, :, lows - _RING]
        clear = (inside > 0) & (2 * beside * width <= inside * _RING)
        # Rows of a scan may be further apart than bins.
        bridged = (inside[:, 1:-1] == 0) & clear[:, :-2] & clear[:, 2:]
        score = 2.0 * clear.sum(axis=1) - (inside > 0).sum(axis=1) + bridged.sum(axis=1) - 0.1 * width / 5
        i, j = np.unravel_index(int(np.argmax(score)), score.shape)
        if best is None or score[i, j] > best[0]:
            best = (float(score[i, j]), int(i), (int(lows[j]), int(highs[j])))
    assert best is not None
    score, turn, (low, high) = best
    if score < _LEAST_BINS - 1:
        return None
    axis = np.cos(_ANGLES[turn]) * first + np.sin(_ANGLES[turn]) * second
    edges = ((low - _N_ACROSS // 2) * _FINE, (high - _N_ACROSS // 2) * _FINE)
    return score, axis, normal, edges


def _grow(
    nearby: Nearby,
    seed: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
    edges: tuple[float, float],
    towards: Float[np.ndarray, "3"],
) -> tuple[Strip, Int[np.ndarray, "K"]] | None:
    """Return the strip fitted to its points and extended to its first long gaps, and its points' indices."""
    poll()
    side = cross(normal, axis)
    # The axis' sign in _best_at_seed: across is measured along normal x axis.
    place = seed + 0.5 * (edges[0] + edges[1]) * side
    half, low, high = 0.5 * (edges[1] - edges[0]), -_BALL, _BALL
    corridor = nearby.list_along(place, axis, np.sqrt(2.0) * _CORRIDOR)
    away = np.abs((nearby.points[corridor] - place) @ np.column_stack([normal, side]))
    corridor = corridor[(away[:, 0] < _CORRIDOR) & (away[:, 1] < _CORRIDOR)]
    points = nearby.points[corridor]
    members = np.zeros(0, dtype=np.int64)
    for _ in range(4):
        offset = points - place
        along, across, over = offset @ axis, offset @ side, offset @ normal
        inside = np.flatnonzero((np.abs(over) < _THICK) & (np.abs(across) < half + 0.01))
        inside = inside[(along[inside] > low - 0.3) & (along[inside] < high + 0.3)]
        if len(inside) < 12:
            return None
        low, high = _run(along[inside], 0.5 * (low + high))
        members = inside[(along[inside] >= low) & (along[inside] <= high)]
        if len(members) < 12:
            return None
        chosen = points[members]
        place = chosen.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((chosen - place).T))
        if values[1] > 0.5 * values[2]:
            return None
        axis, normal = vectors[:, 2] * np.sign(vectors[:, 2] @ axis), vectors[:, 0]
        side = cross(normal, axis)
        spread = (chosen - place) @ side
        middle, half = middle_and_half(spread)
        place = place + middle * side
        along = (chosen - place) @ axis
        low, high = float(along.min()), float(along.max())
    if not _NARROWEST < 2.0 * half < _WIDEST or high - low < _LEAST_BINS * _BIN:
        return None
    clear = _clear(points, place, axis, side, normal, half, low, high)
    score = float(clear.sum())
    if score < _LEAST_SCORE:
        return None
    # Bins at its ends with points beside them belong to another object.
    filled = low + _BIN * np.flatnonzero(clear > 0)
    low, high = max(low, float(filled[0])), min(high, float(filled[-1]) + _BIN)
    normal = normal * np.sign((towards - place) @ normal)
    return Strip(place, axis, normal, half, low, high, points[members], score), corridor[members]


def middle_and_half(spread: Float[np.ndarray, "K"]) -> tuple[float, float]:
    """Return a strip's middle and half width from its points' offsets across, outermost ignored [m]."""
    left, right = np.percentile(spread, [4.0, 96.0])
    return 0.5 * float(left + right), 0.5 * float(right - left) / 0.92


def _clear(
    points: Float[np.ndarray, "N 3"],
    place: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    side: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
    half: float,
    low: float,
    high: float,
) -> Int[np.ndarray, "K"]:
    """Return for each bin: 1 if it has points and few beside them in the plane, -1 if more, 0 without points."""
    offset = points - place
    near = offset[np.abs(offset @ normal) < _THICK]
    along, across = near @ axis, np.abs(near @ side)
    n_bins = int((high - low) / _BIN) + 1
    bins = ((along - low) / _BIN).astype(np.int64)
    is_between = (along >= low) & (along <= high)
    inside = np.bincount(bins[is_between & (across <= half + 0.005)], minlength=n_bins)
    ring = is_between & (across > half + 0.01) & (across < half + 0.04)
    beside = np.bincount(bins[ring], minlength=n_bins)
    clear = 2.0 * beside * 2.0 * half <= inside * 0.06
    marks = np.where(inside > 0, np.where(clear, 1, -1), 0)
    marks[1:-1][(marks[1:-1] == 0) & (marks[:-2] == 1) & (marks[2:] == 1)] = 1
    return marks


def _run(along: Float[np.ndarray, "K"], middle: float) -> tuple[float, float]:
    """Return the ends [m] of the run of filled bins nearest to ``middle``, with gaps of up to six bins."""
    bins = np.unique(np.floor(along / _BIN).astype(np.int64))
    breaks = np.flatnonzero(np.diff(bins) > _GAP)
    begins, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(bins) - 1]])
    at = middle / _BIN
    distance = np.maximum(np.maximum(bins[begins] - at, at - 1.0 - bins[ends]), 0.0)
    best = int(np.argmin(distance))
    return float(bins[begins[best]] * _BIN), float((bins[ends[best]] + 1) * _BIN)


def straight_parts(strip: Strip) -> list[Strip]:
    """Return the strip, or its two parts when two straight pieces fit its middle line and width much better."""
    side = cross(strip.normal, strip.axis)
    local = (strip.members - strip.place) @ np.stack([strip.axis, side, strip.normal], axis=1)
    number = np.floor((local[:, 0] - strip.first) / _BEND_BIN).clip(0).astype(np.int64)
    bins, course = _course(number, local)
    if len(bins) < 2 * _FEWEST_BINS:
        return [strip]
    total = _misfit(bins, course)
    breaks = np.arange(_FEWEST_BINS, len(bins) - _FEWEST_BINS + 1)
    misfits = [_misfit(bins[:k], course[:k]) + _misfit(bins[k:], course[k:]) for k in breaks]
    best = int(np.argmin(misfits))
    if total < len(bins) * _BENT**2 or misfits[best] > _LEFT * total:
        return [strip]
    before = number < bins[breaks[best]]
    return [_refit(strip, strip.members[part]) for part in (before, ~before)]


def _course(
    number: Int[np.ndarray, "N"], local: Float[np.ndarray, "N 3"]
) -> tuple[Int[np.ndarray, "B"], Float[np.ndarray, "B 3"]]:
    """Return bins with points, and the middle, half width and height of each bin's points [m]."""
    n = np.bincount(number)
    bins = np.flatnonzero(n >= _FEWEST_IN_BIN)
    across, square, over = (np.bincount(number, weight)[bins] / n[bins] for weight in _moments(local))
    spread = np.sqrt(np.maximum(square - across**2, 0.0))
    return bins, np.column_stack([across, np.sqrt(3.0) * spread, over])


def _moments(local: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N"], ...]:
    return local[:, 1], local[:, 1] ** 2, local[:, 2]


def _misfit(bins: Int[np.ndarray, "B"], course: Float[np.ndarray, "B 3"]) -> float:
    """Return the squared residuals of middle and height to straight lines, and of the width to its mean [m^2]."""
    x = bins - bins.mean()
    off = course - course.mean(axis=0)
    slope = (x @ off) / max(float(x @ x), 1e-9) * np.array([1.0, 0.0, 1.0])
    return float(((off - x[:, None] * slope) ** 2).sum())


def _refit(strip: Strip, members: Float[np.ndarray, "K 3"]) -> Strip:
    """Return the strip fitted to some of its points: length, width and direction."""
    middle = members.mean(axis=0)
    vectors = np.linalg.eigh(np.cov((members - middle).T))[1]
    axis = vectors[:, 2] * np.sign(vectors[:, 2] @ strip.axis)
    normal = vectors[:, 0] * np.sign(vectors[:, 0] @ strip.normal)
    side = cross(normal, axis)
    off, half = middle_and_half((members - middle) @ side)
    place = middle + off * side
    along = (members - place) @ axis
    share = len(members) / len(strip.members)
    return Strip(place, axis, normal, half, float(along.min()), float(along.max()), members, strip.score * share)
