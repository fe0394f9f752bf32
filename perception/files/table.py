"""Clouds as text tables: XYZ and CSV, with or without a header."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content
from perception.files.scan import COORDINATES, Scan, index_columns, make_scan, parse_natural, parse_viewpoint, quote
from perception.files.text import COMMENTS, Rows, find_separator, fits, read_rows, split_cells, trim

_WHOLE = re.compile(r"[+-]?\d+")
_WITH_COMMA = re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?")
# First line of a CSV file that names its separator for a spreadsheet.
_SEPARATOR_TOLD = re.compile(r"sep=.", re.IGNORECASE)
_JUDGED = 2**14
_FEWEST_JUDGED = 10
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]?\s*$")
_BEFORE_BRACKET = re.compile(r"\s+(?=[\[(])")
_UNIT_AT_END = re.compile(r"^([xyz])[_ ](mm|cm|km|m|in|ft)$")
_UNITS = {
    **{unit: unit for unit in ("m", "cm", "mm", "km", "in", "ft")},
    "meter": "m", "metre": "m", "meters": "m", "metres": "m", "millimeter": "mm", "millimetre": "mm",
    "millimeters": "mm", "millimetres": "mm", "inch": "in", "inches": "in", "foot": "ft", "feet": "ft",
}  # fmt: skip
# Column names of a coordinate array in files of ParaView and similar programs.
_NUMBERED = re.compile(r"^(points[^:]*|[^:]*xyz)([:_])0$")


def read_text(data: Content, name: str) -> Scan:
    """Read rows of columns separated by blanks, tabs, commas or semicolons, thinned to at most ``MAX_POINTS``.

    A first line that is not numbers is a header and names the columns (x y z in any case, also with a unit, or
    ``Points:0`` ..., and those of ``scan.make_scan``); without a header the first three columns are x y z.  A single
    number before the rows is their minimum count.  A comment ``# viewpoint x y z [qw qx qy qz]`` gives the sensor pose.

    Raises:
        CloudError: the file cannot be used; the message names ``name``, the line and the fault.
    """
    data, at = (_clean_text(data), 0) if isinstance(data, bytes) else (data, _skip_mark(data, name))
    viewpoint: tuple[float, ...] | None = None
    header: Header | None = None
    n_announced: int | None = None
    n_lines = 0
    line = ""
    while at < len(data):
        end = data.find(b"\n", at) + 1 or len(data)
        line = trim(data[at:end].decode("utf-8", errors="replace"))
        if line.startswith(COMMENTS):
            words = line.lstrip("#/% ").split()
            if words and words[0].lower().rstrip(":") == "viewpoint":
                viewpoint = parse_viewpoint(words[1:], name)
        named = None if header else _parse_header(line.lstrip("#/% "))
        if named:
            header = named
        elif n_announced is None and parse_natural(line) is not None:
            n_announced = parse_natural(line)
        elif line and not line.startswith(COMMENTS) and not _SEPARATOR_TOLD.fullmatch(line):
            break
        at, n_lines = end, n_lines + 1
    if at >= len(data):
        what = "has a header but no points" if header else "holds no points"
        raise CloudError(f"{name}: {what}; at least one is needed")
    if header is None and _names_columns(line):
        held = ", ".join(split_cells(line, find_separator(line)))
        raise CloudError(f"{name}: line {n_lines + 1}: the header names no x, y, z; it has {quote(held)}")
    separator, has_decimal_commas = _find_separation(line)
    cells = split_cells(line, separator)
    _check_commas(data[at : at + _JUDGED], separator, header, name, n_lines + 1)
    rows = read_rows(
        data,
        tuple(header.columns.values()) if header else range(3),
        name,
        start=at,
        separator=separator,
        has_decimal_commas=has_decimal_commas,
        width=_choose_width(header, cells, name, n_lines + 1) if header else None,
        first_line=n_lines + 1,
    )
    if rows.n_there < (n_announced or 0):
        raise CloudError(f"{name}: {n_announced} points are announced, {rows.n_there} lines are there")
    columns = {key: rows.values[:, i] for i, key in enumerate(header.columns if header else COORDINATES)}
    notes = ("commas are read as decimal points", *rows.notes) if has_decimal_commas else rows.notes
    if not header:
        notes = (*notes, *_note_doubts(rows, cells, name))
    return replace(make_scan(columns, viewpoint, notes), unit=_check_unit(header, name) if header else "")


def _check_unit(header: Header, name: str) -> str:
    """Return the unit that the header gives for all three coordinates; else an empty text.

    Raises:
        CloudError: the units differ.
    """
    if len(set(header.units) - {""}) > 1:
        raise CloudError(
            f"{name}: the header has x, y, z in {', '.join(header.units)}; one unit of all three is needed"
        )
    return header.units[0] if len(set(header.units)) == 1 else ""


def _choose_width(header: Header, cells: Sequence[str], name: str, number: int) -> int | None:
    """Return the number of columns named in the header; None if column names with blanks make it ambiguous.

    Raises:
        CloudError: the names cannot be assigned to columns.
    """
    if fits(cells, header.width):
        return header.width
    if not any(cells[header.width :]) and len(cells) > header.width:  # empty columns of a spreadsheet
        return None
    is_first = sorted(header.columns.values()) == list(range(len(header.columns)))
    if len(cells) < header.width and is_first:  # only columns after the ones read may have blanks in their names
        return None
    raise CloudError(
        f"{name}: line {number} has {len(cells)} columns, the header names {header.width}; give one name for each, "
        "without blanks"
    )


def _find_separation(line: str) -> tuple[str | None, bool]:
    """Return the separator of a row's cells, and whether commas in the cells are decimal points."""
    mark = find_separator(line)
    if mark == ",":
        for other in ("\t", None):
            cells = split_cells(line, other)
            if len(cells) >= len(COORDINATES) and all(_WITH_COMMA.fullmatch(cell) for cell in cells):
                return other, True
    return mark, False


def _check_commas(body: bytes, separator: str | None, header: Header | None, name: str, first_line: int) -> None:
    """Refuse integers between commas if each pair may be one number with a decimal comma.

    Raises:
        CloudError: the first rows all have exactly twice the expected columns, and only integers.
    """
    if separator != ",":
        return
    lines = (line.strip() for line in body.decode("utf-8", errors="replace").splitlines())
    rows = [split_cells(line, ",") for line in islice((line for line in lines if line), 100)]
    width = 2 * (header.width if header else len(COORDINATES))
    if all(len(cells) == width and _are_whole(cells) for cells in rows[: max(1, len(rows) - 1)]):
        raise CloudError(
            f"{name}: line {first_line} has {width} whole numbers between commas; if commas are decimal points, "
            "separate columns by semicolons, else name all columns in a header"
        )


def _note_doubts(rows: Rows, cells: Sequence[str], name: str) -> tuple[str, ...]:
    """Return a note if the first three columns of a table without a header look like colours instead of x, y, z.

    Raises:
        CloudError: the first of four or more columns is a row index.
    """
    if len(rows.values) < _FEWEST_JUDGED or (rows.values != np.round(rows.values)).any(axis=0)[0]:
        return ()
    first = rows.values[:, 0]
    if len(cells) > len(COORDINATES) and first[0] >= 0 and (np.diff(first) > 0).all() and first[-1] <= rows.n_there:
        raise CloudError(f"{name}: its first column counts the rows; name all columns in a header")
    is_colour = (rows.values == np.round(rows.values)) & (rows.values >= 0) & (rows.values <= 255)
    if len(cells) >= 2 * len(COORDINATES) and is_colour.all() and not _are_whole(cells[3:6]):
        return (
            "its first three columns hold nothing but whole numbers from 0 to 255, as colours do; if x, y, z come "
            "after them, name all columns in a header",
        )
    return ()


def _are_whole(cells: Sequence[str]) -> bool:
    return all(_WHOLE.fullmatch(cell) for cell in cells)


def _clean_text(data: bytes) -> bytes:
    """Return the text as UTF-8 without byte order mark, with line feeds as line ends."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", errors="replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8)
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def _skip_mark(data: Content, name: str) -> int:
    """Return the offset of the first line of a large file, after any byte order mark; its encoding is not converted."""
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        raise CloudError(f"{name}: is UTF-16 text of {len(data)} bytes; save so large a file as UTF-8")
    return len(codecs.BOM_UTF8) if data[:3] == codecs.BOM_UTF8 else 0


@dataclass(frozen=True)
class Header:
    """Columns that the first line of a table names.

    Attributes:
        columns: index of each column that is read, by name.
        width: number of columns named.
        units: units of x, y and z; empty if not given.
    """

    columns: dict[str, int]
    width: int
    units: tuple[str, str, str] = ("", "", "")


def _parse_header(line: str) -> Header | None:
    """Return the columns named in a line; None if x, y or z is missing."""
    cells = split_cells(_BEFORE_BRACKET.sub("", line), find_separator(line))
    while len(cells) > 1 and not cells[-1]:
        cells = cells[:-1]
    named = [_split_unit(cell.lower()) for cell in cells]
    names = [name for name, _ in named]
    coordinates = _find_coordinates(names)
    if not coordinates:
        return None
    x, y, z = (named[coordinates[axis]][1] for axis in COORDINATES)
    return Header(index_columns(names) | coordinates, len(cells), (x, y, z))


def _names_columns(line: str) -> bool:
    """Return whether a line looks like a header with at least three columns."""
    cells = split_cells(line, find_separator(line))[:3]
    return len(cells) == 3 and all(cell[:1].isalpha() and not _is_number(cell) for cell in cells)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _split_unit(cell: str) -> tuple[str, str]:
    """Split ``X [mm]``, ``x_mm`` and ``field.x`` into name and unit."""
    bracket = _BRACKET.search(cell)
    unit = ""
    if bracket is not None:
        cell, unit = cell[: bracket.start()], _UNITS.get(bracket[1], "")
    cell = cell.rpartition(".")[2]
    if with_unit := _UNIT_AT_END.match(cell):
        cell, unit = with_unit[1], with_unit[2]
    return cell, unit


def _find_coordinates(names: Sequence[str]) -> dict[str, int]:
    triples: list[tuple[str, ...]] = [COORDINATES]
    triples += [tuple(f"{match[1]}{match[2]}{i}" for i in range(3)) for match in map(_NUMBERED.match, names) if match]
    for triple in triples:
        if all(column in names for column in triple):
            return {axis: names.index(column) for axis, column in zip(COORDINATES, triple, strict=True)}
    return {}
