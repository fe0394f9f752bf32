"""Files with more points than are used: which rows are taken, the same ones however the file is read."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from perception.files.scan import Scan
from perception.limits import MAX_POINTS

if TYPE_CHECKING:
    from jaxtyping import Float, Int

# The golden section: its multiples fill the unit interval evenly, however many there are.
_SECTION = 0.6180339887498949


def step_of(n_rows: int) -> int:
    """One row of so many is taken, so that there are no more than are used."""
    return max(1, -(-n_rows // MAX_POINTS))


def row_of(groups: Int[np.ndarray, "K"], step: int) -> Int[np.ndarray, "K"]:
    """The row that stands for each group of ``step`` rows.

    Its place in the group varies: rows of a spinning scanner are those of its rings in turn, and one in sixteen of them
    would all be of one ring.
    """
    return np.asarray(groups * step + (groups * _SECTION % 1.0 * step).astype(np.int64))


def taken(n_rows: int, step: int, first: int = 0) -> Int[np.ndarray, "K"] | slice:
    """Which of ``n_rows`` rows are taken, counted from the first of them, which is row ``first`` of the file."""
    if step == 1:
        return slice(None)
    rows = row_of(np.arange(first // step, -(-(first + n_rows) // step)), step) - first
    return rows[(rows >= 0) & (rows < n_rows)]


def thinning_note(n_rows: int, step: int) -> tuple[str, ...]:
    """What to tell a user about it."""
    if step == 1:
        return ()
    return (f"took 1 of every {step} of its {n_rows} points, since at most {MAX_POINTS} are used",)


def bounded(scan: Scan) -> Scan:
    """The scan with no more points and misses together than are used."""
    n_points, n_misses = len(scan.points), len(scan.misses)
    step = step_of(n_points + n_misses)
    if step == 1:
        return scan
    points, misses = taken(n_points, step), taken(n_misses, step)
    return replace(
        scan,
        points=scan.points[points],
        misses=scan.misses[misses],
        starts=_of(scan.starts, points),
        miss_starts=_of(scan.miss_starts, misses),
        notes=(*scan.notes, *thinning_note(n_points + n_misses, step)),
    )


def _of(
    starts: Float[np.ndarray, "*N 3"] | None, rows: Int[np.ndarray, "K"] | slice
) -> Float[np.ndarray, "*K 3"] | None:
    return starts if starts is None or starts.ndim == 1 else starts[rows]
