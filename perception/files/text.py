"""Rows of numbers in text, read fast where they are plain and with care where they are not."""

from __future__ import annotations

import array
import io
import warnings
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.files.columns import shown
from perception.limits import MAX_POINTS

if TYPE_CHECKING:
    from jaxtyping import Float

_LONGEST_LINE = 2**16
COMMENTS = ("#", "//", "%")


def separator_of(line: str) -> str | None:
    """What separates the cells of a line; None: blanks."""
    return next((mark for mark in (";", ",", "\t") if mark in line), None)


def cells_of(line: str, separator: str | None) -> list[str]:
    """The cells of a line without quotes; a separator at its end opens no further cell."""
    cells = [cell.strip().strip("\"'") for cell in line.strip().split(separator)]
    return cells[:-1] if len(cells) > 1 and cells[-1] == "" else cells


def read_rows(
    body: bytes,
    columns: Sequence[int],
    name: str,
    *,
    separator: str | None = None,
    width: int | None = None,
    n_rows: int | None = None,
    first_line: int = 1,
) -> Float[np.ndarray, "R C"]:
    """The numbers in ``columns`` of each row; an empty cell is NaN.

    Args:
        body: lines, from the first row on; empty ones and comments are skipped.
        columns: which ones are wanted, counted from 0.
        name: of the file, for errors.
        separator: of cells; None: blanks.  Beside semicolons, a comma is a decimal point.
        width: how many columns there are; None: as many as in the first row.
        n_rows: how many rows are read; None: all.
        first_line: number of the body's first line in the file.

    Raises:
        CloudError: naming the line that is short, long or no number, or when there are too many.
    """
    first = body.find(b"\n")
    if (len(body) if first < 0 else first) > _LONGEST_LINE:
        raise CloudError(f"{name}: line {first_line} is longer than {_LONGEST_LINE} bytes; one row a line is needed")
    if separator == ";":
        body = body.replace(b",", b".")
    table = _plain_numbers(body, separator, n_rows)
    if table is None or table.shape[1] <= max(columns) or table.shape[1] != (width or table.shape[1]):
        table = _careful(body, columns, name, separator, width, n_rows, first_line)
    else:
        table = np.ascontiguousarray(table[:, list(columns)])
    if len(table) > MAX_POINTS:
        raise CloudError(f"{name}: more than {MAX_POINTS} rows; downsample it first")
    return table


def _plain_numbers(body: bytes, separator: str | None, n_rows: int | None) -> Float[np.ndarray, "R C"] | None:
    """All columns, when every row has as many numbers as the first."""
    n_lines = body.count(b"\n") + 1  # a larger max_rows would be set aside in advance
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty table: whoever asked for it tells
            return np.loadtxt(
                io.BytesIO(body),
                comments=None,
                delimiter=separator,
                ndmin=2,
                encoding="latin-1",
                max_rows=min(MAX_POINTS + 1 if n_rows is None else n_rows, n_lines),
            )
    except ValueError:
        return None


def _careful(
    body: bytes,
    columns: Sequence[int],
    name: str,
    separator: str | None,
    width: int | None,
    n_rows: int | None,
    first_line: int,
) -> Float[np.ndarray, "R C"]:
    numbers = array.array("d")
    n_read, n_first = 0, width
    limit = MAX_POINTS + 1 if n_rows is None else n_rows
    for number, line in enumerate(_lines(body), start=first_line):
        if not line or line.startswith(COMMENTS):
            continue
        if n_read == limit:
            break
        cells = cells_of(line, separator)
        if n_first is None and len(cells) <= max(columns):
            raise CloudError(f"{name}: line {number} has {len(cells)} columns; at least {max(columns) + 1} are needed")
        n_first = n_first or len(cells)
        if len(cells) != n_first:
            needed = f"the first has {n_first}" if width is None else f"{width} are announced"
            raise CloudError(f"{name}: line {number} has {len(cells)} columns, {needed}")
        for column in columns:
            numbers.append(_number(cells[column], name, number))
        n_read += 1
    if not numbers:
        return np.zeros((0, len(columns)))
    return np.frombuffer(numbers, dtype=np.float64).reshape(-1, len(columns))


def _lines(body: bytes) -> Iterator[str]:
    for line in io.BytesIO(body):
        yield line.decode("utf-8", errors="replace").strip()


def _number(cell: str, name: str, line: int) -> float:
    if not cell:
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        raise CloudError(f"{name}: line {line}: '{shown(cell)}' is not a number") from None
