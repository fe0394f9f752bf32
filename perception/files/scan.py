"""Rows as read from a cloud file, with its viewpoint and notes, thinned to at most ``MAX_POINTS``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.limits import LARGEST_COORDINATE, MAX_POINTS

if TYPE_CHECKING:  # the parser process starts faster without it
    from jaxtyping import Float, Int, Shaped

COORDINATES = ("x", "y", "z")
STARTS = ("vp_x", "vp_y", "vp_z")
NO_RETURN = "no_return"
_UNREADABLE = re.compile("\ufffd+")
_KNOWN = (*COORDINATES, *STARTS, NO_RETURN)
# Golden ratio: the fractional parts of its multiples are evenly distributed in [0, 1).
_SECTION = 0.6180339887498949


@dataclass(frozen=True)
class Scan:
    """Content of a cloud file as its reader returns it, in the file's unit and frame.

    Attributes:
        points: (N, 3) coordinates in the file's unit; a row with NaN is invalid.
        viewpoint: sensor pose x y z qw qx qy qz; None if the file has none.
        misses: (M, 3) ends of rays without a return.
        starts: (3,) common start of all rays, or (N, 3) start of each point's ray; None: at the viewpoint.
        miss_starts: (M, 3) starts of the rays without a return; None: the (3,) ``starts``, or the viewpoint.
        notes: sentences for the user.
        unit: length unit given in the file; empty if none.
    """

    points: Float[np.ndarray, "N 3"]
    viewpoint: tuple[float, ...] | None = None
    misses: Float[np.ndarray, "M 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    starts: Float[np.ndarray, "*N 3"] | None = None
    miss_starts: Float[np.ndarray, "M 3"] | None = None
    notes: tuple[str, ...] = ()
    unit: str = ""


def index_columns(names: Sequence[str]) -> dict[str, int]:
    """Return the index of each known column in ``names``, ignoring case; of repeated names the first counts."""
    lowered = [name.lower() for name in names]
    return {name: lowered.index(name) for name in _KNOWN if name in lowered}


def find_missing_axis(columns: Mapping[str, int]) -> str:
    """Return the first of x, y, z that is missing; empty if none is missing."""
    return next((axis for axis in COORDINATES if axis not in columns), "")


def make_scan(
    columns: Mapping[str, Shaped[np.ndarray, "N"]], viewpoint: tuple[float, ...] | None, notes: tuple[str, ...] = ()
) -> Scan:
    """Make a scan from columns.

    Args:
        columns: x, y, z; ``vp_x``, ``vp_y``, ``vp_z``: start of each ray; ``no_return``: nonzero if the row is the end
            of a ray without a return instead of a point.
        viewpoint: sensor pose x y z qw qx qy qz.
    """
    rows = _stack_columns(columns, COORDINATES)
    starts = _stack_columns(columns, STARTS) if all(name in columns for name in STARTS) else None
    if NO_RETURN not in columns:
        return Scan(rows, viewpoint, starts=starts, notes=notes)
    missed = np.nan_to_num(columns[NO_RETURN].astype(np.float64)) != 0.0
    return Scan(
        rows[~missed],
        viewpoint,
        rows[missed],
        None if starts is None else starts[~missed],
        None if starts is None else starts[missed],
        notes,
    )


def parse_viewpoint(words: Sequence[str], name: str) -> tuple[float, ...]:
    """Parse ``x y z`` or ``x y z qw qx qy qz``; return seven numbers.

    Raises:
        CloudError: the words are not three or seven finite numbers.
    """
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = ()
    if len(numbers) == 3:
        numbers = (*numbers, 1.0, 0.0, 0.0, 0.0)
    if len(numbers) != 7 or not np.abs(numbers).max() <= LARGEST_COORDINATE or np.linalg.norm(numbers[3:]) < 1e-6:
        raise CloudError(
            f"{name}: viewpoint '{quote(' '.join(words))}' is not x y z, or x y z and a quaternion w x y z"
        )
    return numbers


def parse_natural(word: str) -> int | None:
    """Return a non-negative integer written in decimal digits; None for other words and absurdly large numbers."""
    return int(word) if word.isdecimal() and word.isascii() and len(word) <= 15 else None


def quote(text: str) -> str:
    """Return an extract of a file for an error message: short, on one line, printable."""
    clean = "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))
    clean = _UNREADABLE.sub("?", clean)
    return clean if len(clean) <= 80 else f"{clean[:77]}..."


def _stack_columns(columns: Mapping[str, Shaped[np.ndarray, "N"]], names: Sequence[str]) -> Float[np.ndarray, "N 3"]:
    rows = np.empty((len(columns[names[0]]), len(names)))
    for i, name in enumerate(names):
        rows[:, i] = columns[name]
    return rows


def choose_step(n_rows: int) -> int:
    """Return the smallest thinning step that leaves at most ``MAX_POINTS`` rows."""
    return max(1, -(-n_rows // MAX_POINTS))


def pick_row(groups: Int[np.ndarray, "K"], step: int) -> Int[np.ndarray, "K"]:
    """Return the index of the row kept from each group of ``step`` rows.

    Its position in the group varies, since a spinning scanner writes its rings in turn, and every 16th row could
    belong to the same ring.
    """
    return np.asarray(groups * step + (groups * _SECTION % 1.0 * step).astype(np.int64))


def pick_rows(n_rows: int, step: int, first: int = 0) -> Int[np.ndarray, "K"] | slice:
    """Return the indices of the kept ones among ``n_rows`` rows, the first of which is row ``first`` of the file."""
    if step == 1:
        return slice(None)
    rows = pick_row(np.arange(first // step, -(-(first + n_rows) // step)), step) - first
    return rows[(rows >= 0) & (rows < n_rows)]


def note_thinning(n_rows: int, step: int) -> tuple[str, ...]:
    """Return a note that the file was thinned; empty if it was not."""
    if step == 1:
        return ()
    return (f"took 1 of every {step} of its {n_rows} points, since at most {MAX_POINTS} are used",)


def limit_scan(scan: Scan) -> Scan:
    """Thin the scan to at most ``MAX_POINTS`` rays, with and without a return."""
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
