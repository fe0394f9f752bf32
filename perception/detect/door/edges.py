"""Edges of a face: its ends along its plane, and its height range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.door.profile import BAND, BIN, STOREY, Profile, Rays
from perception.detect.door.upright import Upright

_BESIDE = 0.1
_HIDDEN = 0.25
_SHARP = 0.06
_SURE_STOREYS = 6
_SURE = 2.0  # standard errors
_FEWEST = 5  # columns
_SURE_ROW = 4.0  # standard errors that no row of a face is off its plane
_ROW = 0.02
_WAIST = (0.7, 1.4)
_BEFORE = 0.25


@dataclass(frozen=True)
class Edge:
    """A side edge of a face.

    Attributes:
        at: position along the plane [m].
        jump: distance of the surface beside it out of the face's plane [m]; NaN without one.
        step: lower bound on the distance of the columns beside it from that plane [m].
        open_share: share of the height bands beside it in which rays went on behind the face's plane.
        is_seen: whether enough rays reached the columns beside it.
    """

    at: float
    jump: float
    step: float
    open_share: float
    is_seen: bool

    @property
    def strength(self) -> float:
        """Certainty that the face ends here: 0 where it continues, 1 where it ends, 0.5 where nothing was seen."""
        if not self.is_seen:
            return 0.5
        return float(max(min(self.step / 0.012, 1.0), min(self.open_share / 0.5, 1.0)))


def side_edge(
    profile: Profile, end: int, side: int, local: Float[np.ndarray, "N 3"], ground: float, uneven: float = 0.0
) -> Edge:
    """Return the edge of a face, refined on the points, with depth and openness of the columns beside it.

    Args:
        profile: profile along the face's plane.
        end: column border at which the face ends.
        side: direction out of the face, -1 or 1.
        local: (N, 3) points along the plane, up, and out of it [m].
        uneven: deviation of the face's own columns from its plane (:func:`unevenness`) [m].
    """
    n_beside = round(_BESIDE / BIN)
    beside = np.arange(end, end + n_beside) if side > 0 else np.arange(end - n_beside, end)[::-1]
    beside = beside[(beside >= 0) & (beside < len(profile.depth))]
    at = profile.low + end * BIN
    if not len(beside):
        return Edge(at, np.nan, 0.0, 0.0, False)
    solid = profile.is_solid[beside]
    seen = profile.storeys[beside] + profile.open_storeys[beside]
    open_share = float(np.sum(profile.open_storeys[beside]) / max(np.sum(seen), 1))
    jump = float("nan")
    if solid[1:].any():
        steps = profile.depth[beside[1:]][solid[1:]]
        jump = float(np.median(steps))
    step = _sure_step(profile, beside[solid], uneven)
    band = (local[:, 1] > ground + BAND[0]) & (local[:, 1] < ground + BAND[1])
    near = local[band & (np.abs(local[:, 0] - at) < _SHARP)]
    wall = _wall_before(profile, end, side)
    if wall is not None:
        at, jump, seen = profile.low + wall * BIN, float(profile.depth[wall - (side < 0)]), np.array([_SURE_STOREYS])
        step = abs(jump)
    elif solid[1:].any() and np.ptp(profile.depth[beside[1:]][solid[1:]]) < 0.02 and abs(jump) > 0.005:
        at = _step_at(at, side, jump, near)
    elif not solid[:2].any():
        at = _end_at(at, side, near)
    return Edge(at, jump, step, open_share, bool(seen.sum() >= _SURE_STOREYS))


def unevenness(profile: Profile, first: int, last: int) -> float:
    """Return the deviation of a face's columns from its plane beyond their own noise [m].

    Neighbouring pixels of a stereo camera share their noise, so that a flat face looks wavy.
    """
    mine = np.arange(first, last)[profile.is_solid[first:last]]
    if len(mine) < _FEWEST:
        return 0.0
    off = 1.4826 * np.median(np.abs(profile.depth[mine]))
    return float(np.sqrt(max(0.0, off**2 - np.median(profile.sigma[mine]) ** 2)))


def _sure_step(profile: Profile, columns: Int[np.ndarray, "K"], uneven: float) -> float:
    """Return the greatest mean distance of two neighbouring columns from the plane, less two standard errors [m]."""
    pairs = columns[:-1][np.abs(np.diff(columns)) == 1]
    if not len(pairs):
        return 0.0
    order = 1 if columns[-1] > columns[0] else -1
    weight = profile.sigma**-2
    total = weight[pairs] + weight[pairs + order]
    mean = (weight[pairs] * profile.depth[pairs] + weight[pairs + order] * profile.depth[pairs + order]) / total
    return float(np.max(np.abs(mean) - _SURE * np.sqrt(1.0 / total + uneven**2)).clip(0.0))


def _wall_before(profile: Profile, end: int, side: int) -> int | None:
    """Return the border of the column where a nearer wall begins that hides the face's edge; None without one."""
    for n in range(round(_HIDDEN / BIN)):
        at = end + n if side > 0 else end - 1 - n
        if not 0 <= at < len(profile.depth) or profile.open_storeys[at] > 2:
            return None
        if profile.is_solid[at]:
            return (at if side > 0 else at + 1) if n > 0 and profile.depth[at] > 0.02 else None
    return None


def _step_at(at: float, side: int, jump: float, local: Float[np.ndarray, "N 3"]) -> float:
    """Return the position along the plane where points change from on the face to ``jump`` out of it [m]."""
    place, off = (local[:, 0] - at) * side, local[:, 2]
    mine = np.abs(off) < abs(jump) + 0.04
    if mine.sum() < 10:
        return at
    place, off = place[mine], off[mine]
    # Log odds that the point lies on the face, against the surface beside it.
    vote = np.clip(((off - jump) ** 2 - off**2) / (2.0 * 0.01**2), -3.0, 3.0)
    order = np.argsort(place, kind="stable")
    place, total = place[order], np.cumsum(vote[order])
    best = int(np.argmax(total))
    inner = float(place[best])
    outer = float(place[best + 1]) if best + 1 < len(place) else inner
    return at + side * 0.5 * (inner + outer)


def _end_at(at: float, side: int, local: Float[np.ndarray, "N 3"]) -> float:
    """Return the position along the plane of the face's outermost points, the last 2 % ignored [m]."""
    place = (local[np.abs(local[:, 2]) < 0.025, 0] - at) * side
    place = place[np.abs(place) < 0.5 * _SHARP]
    if len(place) < 10:
        return at
    return at + side * float(np.percentile(place, 98.0))


def row_error(profile: Profile, first: int, last: int) -> float:
    """Return the standard error of the mean of a face's row, from that of its columns [m]."""
    mine = np.arange(first, last)[profile.is_solid[first:last]]
    if not len(mine):
        return 0.0
    height = float(np.median(profile.storeys[mine])) * STOREY
    return float(np.median(profile.sigma[mine]) * np.sqrt(height / (len(mine) * BIN)))


def face_rows(
    plane: Upright, low: float, high: float, rays: Rays, ground: float, error: float = 0.0
) -> tuple[float, bool, float, bool]:
    """Return (bottom, is seen, top, is seen) of the unbroken face: heights above ground [m], whether it ends there.

    Args:
        error: standard error of a row's mean that its points share (:func:`row_error`) [m].
    """
    at, end, heading = rays.crossing(plane)
    # Rays that stopped far before the face are no evidence about it.
    mine = heading & (at[:, 0] > low + 0.03) & (at[:, 0] < high - 0.03) & (end < _BEFORE)
    height, off = at[mine, 1] - ground, end[mine]
    n_rows = round(2.6 / _ROW)
    row = np.floor(height / _ROW).astype(int)
    valid = (row >= 0) & (row < n_rows)
    row, off = row[valid], off[valid]
    on = np.abs(off) < 0.035
    total = np.bincount(row, minlength=n_rows)
    count = np.bincount(row, on, n_rows)
    share = count / np.maximum(total, 1)
    # A lintel that stands out slightly shows in the mean depth of its row.
    mean = np.bincount(row[on], off[on], n_rows) / np.maximum(count, 1)
    aside = np.abs(mean) > np.maximum(max(0.008, _SURE_ROW * error), 0.03 / np.sqrt(np.maximum(count, 1)))
    full = np.flatnonzero((total >= 2) & (share > 0.6) & ~aside)
    if not len(full):
        return 0.0, False, 0.0, False
    middle = int(full[np.argmin(np.abs(full - round(1.2 / _ROW)))])
    is_full = np.isin(np.arange(n_rows), full)
    is_broken = (total >= 3) & ((share < 0.4) | aside)
    # A bar or rail across a face does not end it.
    is_waist = (np.arange(n_rows) * _ROW > _WAIST[0]) & (np.arange(n_rows) * _ROW < _WAIST[1])
    is_broken &= ~is_waist
    n_up, top_is_seen = _run(is_full[middle:], is_broken[middle:])
    n_down, bottom_is_seen = _run(is_full[middle::-1], is_broken[middle::-1])
    return float((middle - n_down) * _ROW), bottom_is_seen, float((middle + n_up + 1) * _ROW), top_is_seen


def _run(is_full: Bool[np.ndarray, "R"], is_broken: Bool[np.ndarray, "R"]) -> tuple[int, bool]:
    """Return the number of rows over which the face continues, and whether broken rows follow."""
    n_broken = np.cumsum(is_broken)
    last = 0
    for row in np.flatnonzero(is_full):
        if n_broken[row] - n_broken[last] >= 2:
            break
        last = int(row)
    return last, bool(n_broken[-1] - n_broken[last] >= 2)
