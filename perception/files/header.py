"""The line of a table that names its columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from perception.files.columns import COORDINATES, places
from perception.files.text import cells_of, separator_of

_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]?\s*$")
_BEFORE_BRACKET = re.compile(r"\s+(?=[\[(])")
_UNIT_AT_END = re.compile(r"^([xyz])[_ ](mm|cm|km|m|in|ft)$")
_UNITS = {
    **{unit: unit for unit in ("m", "cm", "mm", "km", "in", "ft")},
    "meter": "m", "metre": "m", "meters": "m", "metres": "m", "millimeter": "mm", "millimetre": "mm",
    "millimeters": "mm", "millimetres": "mm", "inch": "in", "inches": "in", "foot": "ft", "feet": "ft",
}  # fmt: skip
# Columns of one array of coordinates, as ParaView and its like number them.
_NUMBERED = re.compile(r"^(points[^:]*|[^:]*xyz)([:_])0$")


@dataclass(frozen=True)
class Header:
    """What a line names.

    Attributes:
        columns: where those stand that are read, by name.
        width: how many it names.
        units: of x, y and z; empty where it does not say.
    """

    columns: dict[str, int]
    width: int
    units: tuple[str, str, str] = ("", "", "")


def header_of(line: str) -> Header | None:
    """The columns that a line names; None when x, y and z are not among them."""
    cells = cells_of(_BEFORE_BRACKET.sub("", line), separator_of(line))
    while len(cells) > 1 and not cells[-1]:
        cells = cells[:-1]
    named = [_name_and_unit(cell.lower()) for cell in cells]
    names = [name for name, _ in named]
    coordinates = _coordinates(names)
    if not coordinates:
        return None
    x, y, z = (named[coordinates[axis]][1] for axis in COORDINATES)
    return Header(places(names) | coordinates, len(cells), (x, y, z))


def names_columns(line: str) -> bool:
    """Whether a line looks like names of at least three columns, whatever they are."""
    cells = cells_of(line, separator_of(line))[:3]
    return len(cells) == 3 and all(cell[:1].isalpha() and not _is_number(cell) for cell in cells)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _name_and_unit(cell: str) -> tuple[str, str]:
    """``X [mm]``, ``x_mm`` and ``field.x`` as name and unit."""
    bracket = _BRACKET.search(cell)
    unit = ""
    if bracket is not None:
        cell, unit = cell[: bracket.start()], _UNITS.get(bracket[1], "")
    cell = cell.rpartition(".")[2]
    if with_unit := _UNIT_AT_END.match(cell):
        cell, unit = with_unit[1], with_unit[2]
    return cell, unit


def _coordinates(names: Sequence[str]) -> dict[str, int]:
    triples: list[tuple[str, ...]] = [COORDINATES]
    triples += [tuple(f"{match[1]}{match[2]}{i}" for i in range(3)) for match in map(_NUMBERED.match, names) if match]
    for triple in triples:
        if all(column in names for column in triple):
            return {axis: names.index(column) for axis, column in zip(COORDINATES, triple, strict=True)}
    return {}
