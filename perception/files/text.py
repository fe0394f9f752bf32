"""Rows of numbers in text: a fast parser for plain rows, and a tolerant one for all others."""

from __future__ import annotations

import array
import io
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content
from perception.files.scan import choose_step, note_thinning, parse_natural, pick_row, pick_rows, quote
from perception.limits import MAX_FILE_POINTS, MAX_WHOLE_BYTES

if TYPE_CHECKING:
    from jaxtyping import Float

_LONGEST_LINE = 2**16
_BLOCK = 2**24
COMMENTS = ("#", "//", "%")
_MARKS = tuple(mark.encode() for mark in COMMENTS)
# Text for a missing number: empty cells, words of tables, NaN and infinity of Windows' C library.
_NOTHING = (
    "", "na", "n/a", "#n/a", "null", "none", "-", "nan(ind)", "-nan(ind)", "nan(snan)", "1.#qnan", "-1.#qnan",
    "1.#ind", "-1.#ind", "1.#inf", "-1.#inf",
)  # fmt: skip
_WORDS = {**dict.fromkeys(_NOTHING, float("nan")), "true": 1.0, "false": 0.0}  # true and false: flag columns


@dataclass(frozen=True)
class Rows:
    """Rows of numbers, thinned to at most ``MAX_POINTS``.

    Attributes:
        n_there: number of rows read from the text, before thinning.
        step: one of every ``step`` rows was kept.
    """

    values: Float[np.ndarray, "R C"]
    n_there: int
    step: int

    @property
    def notes(self) -> tuple[str, ...]:
        """Note about the thinning."""
        return note_thinning(self.n_there, self.step)


def find_separator(line: str) -> str | None:
    """Return the separator of a line's cells; None for blanks."""
    return next((mark for mark in (";", ",", "\t") if mark in line), None)


def split_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line without quotes; a separator at the line's end adds an empty cell."""
    row = line.strip() if separator is None else trim(line)
    return [cell.strip().strip("\"'") for cell in row.split(separator)]


def trim(line: str) -> str:
    """Return a line without blanks around it; a tab at its end is kept, since it starts an empty cell."""
    return line.lstrip().rstrip(" \r\n")


def fits(cells: Sequence[str], width: int) -> bool:
    """Return whether a row has ``width`` columns, or one more that is empty after a final separator."""
    return len(cells) == width or (len(cells) == width + 1 and cells[-1] == "")


def use_line_feeds(content: Content, mark: bytes) -> Content:
    """Replace line ends of CR alone by LF; ``mark`` is a text near the file's start that identifies a text file."""
    if isinstance(content, bytes) and b"\n" not in content and mark in content[:_LONGEST_LINE]:
        return content.replace(b"\r", b"\n")
    return content


def read_rows(
    content: Content,
    columns: Sequence[int],
    name: str,
    *,
    start: int = 0,
    stop: int | None = None,
    separator: str | None = None,
    has_decimal_commas: bool = False,
    width: int | None = None,
    n_rows: int | None = None,
    first_line: int = 1,
    step: int | None = None,
) -> Rows:
    """Read the numbers in ``columns`` of each row; an empty cell is NaN.

    Args:
        content: text; empty lines and comments are skipped.
        columns: indices of the columns to read, from 0.
        name: name of the file in errors.
        start, stop: byte range of the rows; None: end of the content.
        separator: separator of cells; None for blanks.
        has_decimal_commas: whether a comma is a decimal point, as it always is between semicolons.
        width: number of columns; None: as in the first row.
        n_rows: number of rows to read; None: all.
        first_line: line number of the first row in the file.
        step: keep one of every ``step`` rows; None: thin to at most ``MAX_POINTS``.

    Raises:
        CloudError: a line is too short, too long or not numeric (the message gives its number), or too many rows.
    """
    stop = len(content) if stop is None else stop
    first = content.find(b"\n", start, stop)
    if (stop if first < 0 else first) - start > _LONGEST_LINE:
        raise CloudError(f"{name}: line {first_line} is longer than {_LONGEST_LINE} bytes; one row a line is needed")
    n_lines = sum(block.count(b"\n") for block in _read_blocks(content, start, stop)) + (
        content[stop - 1 : stop] != b"\n"
    )
    if n_rows is None and n_lines > MAX_FILE_POINTS:
        raise CloudError(f"{name}: more than {MAX_FILE_POINTS} rows; downsample it first")
    if step is None:
        step = max(choose_step(n_lines if n_rows is None else n_rows), -(-(stop - start) // MAX_WHOLE_BYTES))
    n_there = None
    if step == 1:
        body = content[start:stop]
    else:
        body, n_there = _pick_lines(content, start, stop, step, n_rows)
        n_rows = None
    has_decimal_commas |= separator == ";"
    table = _parse_plain(body.replace(b",", b".") if has_decimal_commas else body, separator, n_rows)
    if table is None or table.shape[1] <= max(columns) or table.shape[1] != (width or table.shape[1]):
        table = _parse_with_care(body, columns, name, separator, has_decimal_commas, width, n_rows, first_line, step)
    else:
        table = np.ascontiguousarray(table[:, list(columns)])
    return Rows(table, len(table) if n_there is None else n_there, step)


def skip_lines(content: Content, start: int, n_lines: int) -> int:
    """Return the offset after ``n_lines`` lines from ``start``, the last possibly without LF; -1 if there are fewer."""
    at = start
    while n_lines:
        block = content[at : at + (_BLOCK if n_lines > 1 else _LONGEST_LINE)]
        n_here = block.count(b"\n")
        if n_here >= n_lines:
            ends = np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n"))
            return at + int(ends[n_lines - 1]) + 1
        at, n_lines = at + len(block), n_lines - n_here
        if at >= len(content):
            return at if n_lines == 1 and at > start and content[at - 1 : at] != b"\n" else -1
    return at


def _read_blocks(content: Content, start: int, stop: int) -> Iterator[bytes]:
    """Yield blocks of whole lines, a few megabytes each."""
    while start < stop:
        end = stop
        if end - start > _BLOCK:
            end = content.rfind(b"\n", start, start + _BLOCK) + 1 or content.find(b"\n", start, stop) + 1 or end
        yield content[start:end]
        start = end


def _pick_lines(content: Content, start: int, stop: int, step: int, n_rows: int | None) -> tuple[bytes, int]:
    """Return one of every ``step`` rows among the first ``n_rows``, and the number of these rows."""
    body, n_there = bytearray(), 0
    for block in _read_blocks(content, start, stop):
        lines = [line for line in block.split(b"\n") if line and not line.isspace()]
        if any(mark in block for mark in _MARKS):
            lines = [line for line in lines if not line.lstrip().startswith(_MARKS)]
        if n_rows is not None:
            lines = lines[: n_rows - n_there]
        body += b"".join(lines[i] + b"\n" for i in np.arange(len(lines))[pick_rows(len(lines), step, n_there)])
        n_there += len(lines)
    return bytes(body), n_there


def _parse_plain(body: bytes, separator: str | None, n_rows: int | None) -> Float[np.ndarray, "R C"] | None:
    """Return all (R, C) numbers, or None if the rows differ in length or hold other text."""
    n_lines = body.count(b"\n") + 1  # numpy allocates max_rows in advance
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller reports an empty table
            return np.loadtxt(
                io.BytesIO(body),
                comments=None,
                delimiter=separator,
                ndmin=2,
                encoding="latin-1",
                max_rows=n_lines if n_rows is None else min(n_rows, n_lines),
            )
    except ValueError:
        return None


def _parse_with_care(
    body: bytes,
    columns: Sequence[int],
    name: str,
    separator: str | None,
    has_decimal_commas: bool,
    width: int | None,
    n_rows: int | None,
    first_line: int,
    step: int,
) -> Float[np.ndarray, "R C"]:
    numbers = array.array("d")
    n_read, n_first, is_open = 0, width, False
    for place, line in enumerate(_split_lines(body)):
        number = first_line + (place if step == 1 else int(pick_row(np.array(place), step)))
        if not line or line.startswith(COMMENTS):
            continue
        if n_read == n_rows:
            break
        cells = split_cells(line, separator)
        if n_first is None and len(cells) <= max(columns):
            raise CloudError(f"{name}: line {number} has {len(cells)} columns; at least {max(columns) + 1} are needed")
        if n_first is None:
            n_first = len(cells)
            is_open = cells[-1] == "" and n_first > max(columns) + 1  # a final separator may start a column
        if not fits(cells, n_first) and not (is_open and fits(cells, n_first - 1)):
            needed = f"the first has {n_first - is_open}" if width is None else f"{width} are announced"
            is_count = len(cells) == 1 and parse_natural(cells[0]) is not None
            more = "; if it counts the points of a further scan, give a file for each scan" if is_count else ""
            raise CloudError(f"{name}: line {number} has {len(cells)} columns, {needed}{more}")
        for column in columns:
            numbers.append(_parse_number(cells[column], has_decimal_commas, name, number))
        n_read += 1
    if not numbers:
        return np.zeros((0, len(columns)))
    return np.frombuffer(numbers, dtype=np.float64).reshape(-1, len(columns))


def _split_lines(body: bytes) -> Iterator[str]:
    for line in io.BytesIO(body):
        yield trim(line.decode("utf-8", errors="replace"))


def _parse_number(cell: str, has_decimal_commas: bool, name: str, line: int) -> float:
    if cell.lower() in _WORDS:
        return _WORDS[cell.lower()]
    try:
        return float(cell.replace(",", ".") if has_decimal_commas else cell)
    except ValueError:
        is_comma = "," in cell and not has_decimal_commas
        comma = "; is the comma a decimal point? use a point, or semicolons between columns" if is_comma else ""
        raise CloudError(f"{name}: line {line}: '{quote(cell)}' is not a number{comma}") from None
