"""How far up and down a face goes, row by row."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from perception.detect.door.profile import Rays
from perception.detect.door.upright import Upright

_ROW = 0.02
_WAIST = (0.7, 1.4)
_BEFORE = 0.25


def face_rows(plane: Upright, low: float, high: float, rays: Rays, ground: float) -> tuple[float, bool, float, bool]:
    """Lowest and highest height to which the face goes without a break, and whether anything else lies beyond each."""
    at, end, heading = rays.crossing(plane)
    # Rays that stopped far before the face tell nothing of it.
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
    # A lintel that stands out by little is told by the mean of its row.
    mean = np.bincount(row[on], off[on], n_rows) / np.maximum(count, 1)
    aside = np.abs(mean) > np.maximum(0.008, 0.03 / np.sqrt(np.maximum(count, 1)))
    full = np.flatnonzero((total >= 2) & (share > 0.6) & ~aside)
    if not len(full):
        return 0.0, False, 0.0, False
    middle = int(full[np.argmin(np.abs(full - round(1.2 / _ROW)))])
    is_full = np.isin(np.arange(n_rows), full)
    is_broken = (total >= 3) & ((share < 0.4) | aside)
    # A bar or rail across a face is no end of it.
    is_waist = (np.arange(n_rows) * _ROW > _WAIST[0]) & (np.arange(n_rows) * _ROW < _WAIST[1])
    is_broken &= ~is_waist
    n_up, top_is_seen = _run(is_full[middle:], is_broken[middle:])
    n_down, bottom_is_seen = _run(is_full[middle::-1], is_broken[middle::-1])
    return float((middle - n_down) * _ROW), bottom_is_seen, float((middle + n_up + 1) * _ROW), top_is_seen


def _run(is_full: Bool[np.ndarray, "R"], is_broken: Bool[np.ndarray, "R"]) -> tuple[int, bool]:
    """How many rows the face goes on, and whether something else follows."""
    n_broken = np.cumsum(is_broken)
    last = 0
    for row in np.flatnonzero(is_full):
        if n_broken[row] - n_broken[last] >= 2:
            break
        last = int(row)
    return last, bool(n_broken[-1] - n_broken[last] >= 2)
