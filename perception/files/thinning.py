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


def choose_step(n_rows: int) -> int:
    """Return the step at which rows are taken, so that there are no more than are used."""
    return max(1, -(-n_rows // MAX_POINTS))


def pick_row(groups: Int[np.ndarray, "K"], step: int) -> Int[np.ndarray, "K"]:
    """Return the row that stands for each group of ``step`` rows.

    Its place in the group varies: rows of a spinning scanner are those of its rings in turn, and one in sixteen of them
    would all be of one ring.
    """
    return np.asarray(groups * step + (groups * _SECTION % 1.0 * step).astype(np.int64))


def pick_rows(n_rows: int, step: int, first: int = 0) -> Int[np.ndarray, "K"] | slice:
    """Return the rows taken of ``n_rows``, counted from the first of them, which is row ``first`` of the file."""
    if step == 1:
        return slice(None)
    rows = pick_row(np.arange(first // step, -(-(first + n_rows) // step)), step) - first
    return rows[(rows >= 0) & (rows < n_rows)]


def note_thinning(n_rows: int, step: int) -> tuple[str, ...]:
    """Note that a file was thinned."""
    if step == 1:
        return ()
    return (f"took 1 of every {step} of its {n_rows} points, since at most {MAX_POINTS} are used",)


def limit_scan(scan: Scan) -> Scan:
    """Thin the scan to no more points and misses together than are used."""
    n_points, n_misses = len(scan.points), len(scan.misses)
    step = choose_step(n_points + n_misses)
    if step == 1:
        return scan
    points, misses = pick_rows(n_points, step), pick_rows(n_misses, step)
    return replace(
        scan,
        points=scan.points[points],
        misses=scan.misses[misses],
        starts=_pick_starts(scan.starts, points),
        miss_starts=_pick_starts(scan.miss_starts, misses),
        notes=(*scan.notes, *note_thinning(n_points + n_misses, step)),
    )


def _pick_starts(
    starts: Float[np.ndarray, "*N 3"] | None, rows: Int[np.ndarray, "K"] | slice
) -> Float[np.ndarray, "*K 3"] | None:
    return starts if starts is None or starts.ndim == 1 else starts[rows]
