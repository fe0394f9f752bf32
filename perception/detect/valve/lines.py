"""Line hypotheses for slender objects in a cloud, scored by their contrast to nearby points and extended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.detect.shared.arithmetic import covariance
from perception.detect.shared.nearby import Nearby
from perception.detect.shared.slender import slim_places

_MOST_SEEDS, _MOST_LINES = 250, 60
_BALL = 0.32
_LEAST_PAIR = 0.1
_BIN = 0.04
_GAP = 5
_MOST_NEAR = 400
_SHARED, _RUNS_IN = 0.6, 0.6
_MOST_BINS = 20
# Greatest lateral error at its ends of a line started from a few points [m].
_CORRIDOR = 0.25


@dataclass(frozen=True)
class Line:
    """Straight run of points.

    Attributes:
        place: (3,) point on it [m].
        first, last: its ends along ``axis``, from ``place`` [m].
        radius: of the tube that holds its points [m].
        members: indices of its points.
        score: number of bins along it that hold points (at most 20), times their contrast to points about the tube.
    """

    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    first: float
    last: float
    radius: float
    members: Int[np.ndarray, "K"]
    score: float


def find_lines(
    points: Float[np.ndarray, "N 3"],
    rng: np.random.Generator,
    radii: tuple[float, ...],
    least_length: float,
    n_pairs: int = 14,
    slim_ball: float | None = None,
) -> list[Line]:
    """Return the best lines, best first; none runs mostly inside another's tube.

    Args:
        points: (N, 3) thinned evenly, without large planes [m].
        radii: of the tubes to try [m].
        slim_ball: only points whose neighbours within this radius spread along one direction are seeds, and that
            direction is tried as well [m]; None: every point may be a seed.
    """
    if len(points) < 12:
        return []
    tree, nearby = cKDTree(points), Nearby.of(points)
    taken = np.zeros(len(points), dtype=bool)
    slim, ways = np.arange(len(points)), None
    if slim_ball is not None:
        slim, ways = slim_places(points, tree, slim_ball)
        if not len(slim):
            return []
    chosen = np.sort(rng.choice(len(slim), min(_MOST_SEEDS, len(slim)), replace=False))
    seeds = slim[chosen]
    starts: list[tuple[float, Line]] = []
    around = tree.query_ball_point(points[seeds], _BALL, return_sorted=True)
    for i, seed, near in zip(chosen, seeds, around, strict=True):
        local = np.asarray(near, dtype=np.int64)
        if len(local) >= 10:
            way = None if ways is None else ways[i]
            starts += _best_at_seed(points, int(seed), local, rng, radii, n_pairs, way)
    starts.sort(key=lambda start: -start[0])
    lines: list[Line] = []
    for _, start in starts[: 6 * _MOST_LINES]:
        # Starts whose points mostly lie on an accepted line are skipped.
        if len(start.members) and taken[start.members].mean() > _SHARED:
            continue
        line = _grow(nearby, start)
        if line is None or line.last - line.first < least_length:
            continue
        if not _runs_in_any(line, lines):
            lines.append(line)
            taken[line.members] = True
            if len(lines) == _MOST_LINES:
                break
    return sorted(lines, key=lambda line: -line.score)


def _best_at_seed(
    points: Float[np.ndarray, "N 3"],
    seed: int,
    local: Int[np.ndarray, "K"],
    rng: np.random.Generator,
    radii: tuple[float, ...],
    n_pairs: int,
    way: Float[np.ndarray, "3"] | None,
) -> list[tuple[float, Line]]:
    """Return (score, line) of the best line through a seed for each radius."""
    poll()
    if len(local) > _MOST_NEAR:
        local = np.sort(rng.choice(local, _MOST_NEAR, replace=False))
    offset = points[local] - points[seed]
    distance = np.linalg.norm(offset, axis=1)
    partners = np.flatnonzero(distance > _LEAST_PAIR)
    if not len(partners):
        return []
    partners = rng.choice(partners, min(n_pairs, len(partners)), replace=False)
    axes = offset[partners] / distance[partners, None]
    if way is not None:
        axes = np.concatenate([way[None], axes])
    along = axes @ offset.T
    apart = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
    n_bins = int(2 * _BALL / _BIN)
    bins = np.clip(((along + _BALL) / _BIN).astype(np.int64), 0, n_bins - 1)
    best = []
    for radius in radii:
        inside = apart < radius
        filled = np.zeros((len(axes), n_bins), dtype=bool)
        row, column = np.nonzero(inside)
        filled[row, bins[row, column]] = True
        n_around = np.count_nonzero(apart < 2.0 * radius, axis=1)
        share = np.count_nonzero(inside, axis=1) / np.maximum(n_around, 1)
        score = np.count_nonzero(filled, axis=1) * _contrast(share)
        i = int(np.argmax(score))
        members = local[inside[i]]
        best.append((float(score[i]), Line(points[seed], axes[i], -_BALL, _BALL, radius, members, float(score[i]))))
    return best


def _contrast(share: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Return (K,) contrast: 0 where points about the tube are as dense as in it (on a wall), 1 where there are none."""
    return np.asarray(np.maximum(share - 0.4, 0.0) / 0.6)


def _grow(nearby: Nearby, line: Line) -> Line | None:
    """Return the line refitted to its points and extended over their run of bins; None with too few points."""
    poll()
    if not len(line.members):
        return None
    points, corridor = nearby.points, nearby.list_along(line.place, line.axis, _CORRIDOR)
    corridor = corridor[_about(points[corridor], line.place, line.axis)[1] < _CORRIDOR]
    local = points[corridor]
    place, axis = points[line.members].mean(axis=0), line.axis
    low, high = -_BALL, _BALL
    for _ in range(4):
        along, apart = _about(local, place, axis)
        inside = apart < line.radius
        if not inside.any():
            return None
        low, high = _run(along[inside])
        members = local[inside & (along >= low) & (along <= high)]
        if len(members) < 8:
            return None
        place = members.mean(axis=0)
        new = np.linalg.eigh(covariance(members))[1][:, 2]
        axis = new * np.sign(new @ axis)
    along, apart = _about(local, place, axis)
    inside = apart < line.radius
    if not inside.any():
        return None
    low, high = _run(along[inside])
    beside = (along >= low) & (along <= high)
    inside &= beside
    share = inside.sum() / max(1, int((beside & (apart < 2.0 * line.radius)).sum()))
    filled = len(np.unique(np.floor(along[inside] / _BIN)))
    return Line(
        place, axis, low, high, line.radius, corridor[inside], float(min(filled, _MOST_BINS) * _contrast(share))
    )


def _about(
    points: Float[np.ndarray, "N 3"], place: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return (N,) positions of points along a line and (N,) distances from it [m]."""
    offset = points - place
    along = offset @ axis
    return along, np.sqrt(np.maximum(np.einsum("ni,ni->n", offset, offset) - along**2, 0.0))


def _run(along: Float[np.ndarray, "K"]) -> tuple[float, float]:
    """Return both ends of the run of filled bins nearest to position 0, gaps of up to five bins included [m]."""
    bins = np.unique(np.floor(along / _BIN).astype(np.int64))
    breaks = np.flatnonzero(np.diff(bins) > _GAP)
    begins, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(bins) - 1]])
    distance = np.maximum(np.maximum(bins[begins], -1 - bins[ends]), 0)
    best = int(np.argmin(distance))
    return float(bins[begins[best]] * _BIN), float((bins[ends[best]] + 1) * _BIN)


def _runs_in_any(line: Line, others: Sequence[Line]) -> bool:
    """Return whether most of a line's length lies inside another's tube."""
    if not others:
        return False
    places = line.place + np.linspace(line.first, line.last, 9)[:, None] * line.axis
    offset = places - np.array([other.place for other in others])[:, None]
    along = np.einsum("kpi,ki->kp", offset, np.array([other.axis for other in others]))
    apart = np.sqrt(np.maximum((offset**2).sum(axis=2) - along**2, 0.0))
    first, last, radius = np.array([(other.first, other.last, other.radius) for other in others]).T[:, :, None]
    inside = (apart < radius) & (along >= first) & (along <= last)
    return bool((inside.mean(axis=1) > _RUNS_IN).any())
