"""Seat cushion completed from a partly visible level patch, by the open and occupied cells about it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.stopping import poll
from perception.detect.vehicle.level import YAWS, Patch, is_inside

USUAL_WIDTH, USUAL_DEPTH = 0.5, 0.46
_CELL = 0.025
_REACH = 0.9
# Depth below the top at which a ray's crossing is located and depth it must reach; heights of risen points [m].
_UNDER = (0.05, 0.08)
_OVER = (0.08, 0.5)
_ROW = 0.04
_BEYOND = 0.1
_INTO = 0.03
_SEEN_EDGE = 0.3
_PER_AREA = 0.05
_ENDS = (0.7, 99.3)  # percentiles, to ignore outliers
_ROUNDS = 2
_LEAST_ROWS = 5
_NO_WORSE = 0.001
_SCATTER = 0.004
_LEAST_TURN, _MOST_TURN = np.radians(2.0), np.radians(15.0)
_NEXT = 0.06
_MOST_POINTS = 3000


@dataclass(frozen=True)
class Surround:
    """Plan view about a patch: centres of 2.5 cm cells; cells in neither list are unseen.

    Attributes:
        opened: (J, 2) cells in which rays passed down through the patch's height [m].
        risen: (B, 2) cells with points higher than the patch [m].
    """

    opened: Float[np.ndarray, "J 2"]
    risen: Float[np.ndarray, "B 2"]


@dataclass(frozen=True)
class Cushion:
    """Patch as the top of a cushion that faces along x.

    Attributes:
        pose: (4, 4) origin in the middle of the top, x forward, z up.
        width, depth: of the top [m].
        filled: share of its seen cells that hold points.
        n_guessed: number of unseen edges set by the usual width or depth.
    """

    pose: Float[np.ndarray, "4 4"]
    width: float
    depth: float
    filled: float
    n_guessed: int


def surround_of(
    patch: Patch,
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "R 3"],
    ends: Float[np.ndarray, "R 3"],
) -> Surround:
    """Return the open and the higher cells within 0.9 m of a patch, from points and rays."""
    poll()
    low, high = patch.centre[:2] - _REACH, patch.centre[:2] + _REACH
    level = patch.centre[2] - _UNDER[0]
    down = np.flatnonzero((ends[:, 2] < patch.centre[2] - _UNDER[1]) & (starts[:, 2] > level))
    start, end = starts[down], ends[down]
    share = (level - start[:, 2]) / (end[:, 2] - start[:, 2])
    through = start[:, :2] + share[:, None] * (end - start)[:, :2]
    over = is_inside(
        points, np.array([*low, patch.centre[2] + _OVER[0]]), np.array([*high, patch.centre[2] + _OVER[1]])
    )
    opened = _cells(through[((through > low) & (through < high)).all(axis=1)])
    return Surround(opened, _cells(points[over, :2]))


def _cells(flat: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "C 2"]:
    """Return centres of the cells that hold points [m]."""
    poll()
    return np.asarray((np.unique(np.floor(flat / _CELL).astype(np.int64), axis=0) + 0.5) * _CELL).reshape(-1, 2)


def square_up(patch: Patch, about: Surround) -> Patch:
    """Return the patch with the bounding rectangle of least open area, turned along its visible edges."""
    few = patch.points[:: max(1, len(patch.points) // _MOST_POINTS), :2] - patch.centre[:2]
    opened = about.opened - patch.centre[:2]
    yaw = float(YAWS[np.argmin(_costs(few, opened, YAWS))])
    for _ in range(_ROUNDS):
        turn = _turn_of_edges(few, opened, yaw)
        # Smaller turns are within the uncertainty of the edges.
        if abs(turn) < _LEAST_TURN:
            break
        turned = yaw + turn
        before, after = _costs(few, opened, np.array([yaw, turned]))
        if after > before + _NO_WORSE:
            break
        yaw = turned
    way = _ways(np.array([yaw]))[:, :, 0]
    low, high = np.percentile(few @ way.T, _ENDS, axis=0)
    centre = patch.centre + np.append(0.5 * (low + high) @ way, 0.0)
    size = high - low
    area = patch.filled * float(np.prod(patch.size))
    return replace(patch, centre=centre, yaw=yaw, size=size, filled=min(area / float(np.prod(size)), 1.0))


def _costs(
    few: Float[np.ndarray, "K 2"], opened: Float[np.ndarray, "J 2"], yaws: Float[np.ndarray, "A"]
) -> Float[np.ndarray, "A"]:
    """Return the open area in the patch's bounding rectangle at each yaw, plus 5 % of the rectangle's area [m^2]."""
    poll()
    ways = _ways(yaws)
    low, high = np.percentile(few @ ways, _ENDS, axis=1)
    places = opened @ ways
    inside = (places > low[:, None] + 0.5 * _CELL) & (places < high[:, None] - 0.5 * _CELL)
    return np.asarray(inside.all(axis=0).sum(axis=0) * _CELL**2 + _PER_AREA * np.prod(high - low, axis=0))


def _ways(yaws: Float[np.ndarray, "A"]) -> Float[np.ndarray, "2 2 A"]:
    """Return unit vectors of both directions at each yaw: axes direction, x and y, yaw."""
    return np.stack([np.stack([np.cos(yaws), np.sin(yaws)]), np.stack([-np.sin(yaws), np.cos(yaws)])])


def _turn_of_edges(few: Float[np.ndarray, "K 2"], opened: Float[np.ndarray, "J 2"], yaw: float) -> float:
    """Return the angle from ``yaw`` to the visible edges: mean of their slopes, long ones weighted more [rad]."""
    way = _ways(np.array([yaw]))[:, :, 0]
    top, free = few @ way.T, opened @ way.T
    slopes, weights = [], []
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            along, out = _row_ends(top, free, axis, sign)
            if len(along) < _LEAST_ROWS:
                continue
            i, j = np.triu_indices(len(along), len(along) // 2)
            slope = float(np.median((out[j] - out[i]) / (along[j] - along[i])))
            off = out - slope * along
            scatter = float(np.median(np.abs(off - np.median(off))))
            slopes.append(-slope if axis == 0 else slope)
            weights.append(float(np.ptp(along)) ** 2 / (scatter**2 + _SCATTER**2))
    if not slopes:
        return 0.0
    return float(np.clip(np.average(slopes, weights=weights), -_MOST_TURN, _MOST_TURN))


def _row_ends(
    top: Float[np.ndarray, "K 2"], free: Float[np.ndarray, "J 2"], axis: int, sign: float
) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R"]]:
    """Return positions along and across an edge where rows of the patch end at open cells [m]."""
    other = 1 - axis
    low = float(top[:, other].min())
    n_rows = int((top[:, other].max() - low) / _ROW) + 1
    row = np.floor((top[:, other] - low) / _ROW).astype(int)
    last = np.full(n_rows, -np.inf)
    np.maximum.at(last, row, sign * top[:, axis])
    beyond = np.floor((free[:, other] - low) / _ROW).astype(int)
    near = _within(beyond, n_rows)
    ahead = sign * free[near, axis] - last[beyond[near]]
    followed = np.bincount(beyond[near][(ahead > 0.0) & (ahead < _NEXT)], minlength=n_rows) > 0
    kept = np.flatnonzero(followed & np.isfinite(last))
    return low + (kept + 0.5) * _ROW, sign * last[kept]


def as_cushion(patch: Patch, about: Surround, turn: int) -> Cushion:
    """Return the patch as a cushion that faces along one direction of its rectangle.

    Args:
        about: open and higher cells about the patch.
        turn: quarter turns of x from the rectangle's first direction.
    """
    yaw = patch.yaw + 0.5 * np.pi * turn
    c, s = np.cos(yaw), np.sin(yaw)
    basis = np.array([[c, -s], [s, c]])
    depth, width = patch.size if turn % 2 == 0 else patch.size[::-1]
    top, opened, risen = (
        (flat - patch.centre[:2]) @ basis for flat in (_cells(patch.points[:, :2]), about.opened, about.risen)
    )
    half = 0.5 * np.array([depth, width])
    known = np.concatenate([opened, risen])
    seen = [[_is_edge(top, known, axis, sign, half) for sign in (-1.0, 1.0)] for axis in (0, 1)]
    low, high = -half, half.copy()
    n_guessed = 0
    for axis, usual in enumerate((USUAL_DEPTH, USUAL_WIDTH)):
        missing = usual - (high - low)[axis]
        # With two unseen edges neither is moved, since the nearer one is unknown.
        if missing > 0.0 and sum(seen[axis]) == 1:
            n_guessed += 1
            if seen[axis][0]:
                high[axis] += missing
            else:
                low[axis] -= missing
    middle = 0.5 * (low + high)
    pose = np.eye(4)
    pose[:2, :2] = basis
    pose[:3, 3] = patch.centre + np.append(basis @ middle, 0.0)
    free = ((opened > -half + _INTO) & (opened < half - _INTO)).all(axis=1).sum()
    filled = max(patch.filled, len(top) / max(len(top) + free, 1))
    size = high - low
    return Cushion(pose, float(size[1]), float(size[0]), float(filled), n_guessed)


def _is_edge(
    top: Float[np.ndarray, "K 2"],
    known: Float[np.ndarray, "J 2"],
    axis: int,
    sign: float,
    half: Float[np.ndarray, "2"],
) -> bool:
    """Return whether an edge was seen: in over 30 % of its rows a known cell follows the last point."""
    other = 1 - axis
    n_rows = max(round(2.0 * half[other] / _ROW), 1)
    row_of = [np.floor((flat[:, other] / (2.0 * half[other]) + 0.5) * n_rows).astype(int) for flat in (top, known)]
    last = np.full(n_rows, -np.inf)
    mine = _within(row_of[0], n_rows)
    np.maximum.at(last, row_of[0][mine], sign * top[mine, axis])
    followed = np.zeros(n_rows, dtype=bool)
    near = _within(row_of[1], n_rows)
    row, after = row_of[1][near], sign * known[near, axis]
    ahead = after - last[row]
    followed[row[(ahead > 0.0) & (ahead < _BEYOND)]] = True
    rows = np.isfinite(last) & (last > half[axis] - _BEYOND)
    return bool(rows.any() and followed[rows].mean() > _SEEN_EDGE)


def _within(row: np.ndarray, n_rows: int) -> Bool[np.ndarray, "N"]:
    return np.asarray((row >= 0) & (row < n_rows))
