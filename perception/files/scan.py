"""Scan of a file: the rows as they stand in it, the columns they may have, and quotes of it in errors."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.limits import LARGEST_COORDINATE

if TYPE_CHECKING:  # the process that parses files is quicker to start without it
    from jaxtyping import Float, Shaped

COORDINATES = ("x", "y", "z")
STARTS = ("vp_x", "vp_y", "vp_z")
NO_RETURN = "no_return"
_UNREADABLE = re.compile("\ufffd+")
_KNOWN = (*COORDINATES, *STARTS, NO_RETURN)


@dataclass(frozen=True)
class Scan:
    """Rows as they stand in a file, in its unit and frame, from its reader.

    Attributes:
        points: (N, 3) coordinates in the file's unit; a row with NaN is no point.
        viewpoint: x y z qw qx qy qz of the sensor; None when the file does not say.
        misses: (M, 3) places up to which rays met nothing.
        starts: (3,) where all rays started, or (N, 3) where that of each point did; None: at the viewpoint.
        miss_starts: (M, 3) where each of the others started; None: as the points' (3,), or at the viewpoint.
        notes: sentences a user should read.
        unit: of its lengths, where the file says so; empty where it does not.
    """

    points: Float[np.ndarray, "N 3"]
    viewpoint: tuple[float, ...] | None = None
    misses: Float[np.ndarray, "M 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    starts: Float[np.ndarray, "*N 3"] | None = None
    miss_starts: Float[np.ndarray, "M 3"] | None = None
    notes: tuple[str, ...] = ()
    unit: str = ""


def index_columns(names: Sequence[str]) -> dict[str, int]:
    """Return the index of each column we read among ``names``, case aside; the first of each name counts."""
    lowered = [name.lower() for name in names]
    return {name: lowered.index(name) for name in _KNOWN if name in lowered}


def find_missing_axis(columns: Mapping[str, int]) -> str:
    """Return the first of x, y, z that is missing; empty if none is."""
    return next((axis for axis in COORDINATES if axis not in columns), "")


def make_scan(
    columns: Mapping[str, Shaped[np.ndarray, "N"]], viewpoint: tuple[float, ...] | None, notes: tuple[str, ...] = ()
) -> Scan:
    """Make a scan of columns.

    Args:
        columns: x, y, z; ``vp_x``, ``vp_y``, ``vp_z``: where each ray started; ``no_return``: other than 0 where the
            row is no point but a place up to which the ray met nothing.
        viewpoint: x y z qw qx qy qz.
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
    """Parse ``x y z`` or ``x y z qw qx qy qz`` to seven numbers.

    Raises:
        CloudError: they are not such numbers.
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
    """Parse a whole number of at least 0 in decimal digits; None if it is none, or larger than any file's content."""
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
