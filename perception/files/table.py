"""Clouds as text tables: XYZ and CSV, with or without a header."""

from __future__ import annotations

import codecs
import re

from perception.errors import CloudError
from perception.files.columns import COORDINATES, parse_viewpoint, places, scan_of
from perception.files.content import Content
from perception.files.scan import Scan
from perception.files.text import COMMENTS, cells_of, read_rows, separator_of

_TRIPLES = (COORDINATES, ("points:0", "points:1", "points:2"), ("points_0", "points_1", "points_2"))
_AFTER_NAME = re.compile(r"\s*[\[(].*$")


def read_text(data: Content, name: str) -> Scan:
    """Rows, thinned to as many as are used, of columns separated by blanks, tabs, commas or semicolons.

    A first line that is not numbers is a header and names the columns (x y z in any case, or ``Points:0`` ..., and
    those of ``columns.scan_of``); without one the first three columns are taken.  A comment
    ``# viewpoint x y z [qw qx qy qz]`` gives the sensor.

    Raises:
        CloudError: naming ``name``, the line and what is wrong.
    """
    data, at = (_as_lines(data), 0) if isinstance(data, bytes) else (data, _start_of(data, name))
    viewpoint: tuple[float, ...] | None = None
    found = dict(zip(COORDINATES, range(3), strict=True))
    separator: str | None = None
    n_lines = 0
    has_header = False
    while at < len(data):
        end = data.find(b"\n", at) + 1 or len(data)
        line = data[at:end].decode("utf-8", errors="replace").strip()
        if line.startswith(COMMENTS):
            words = line.lstrip("#/% ").split()
            if words[:1] == ["viewpoint"]:
                viewpoint = parse_viewpoint(words[1:], name)
        header = {} if has_header else _header(line.lstrip("#/% "))
        if header:
            found, has_header = header, True
        elif line and not line.startswith(COMMENTS):
            separator = separator_of(line)
            break
        at, n_lines = end, n_lines + 1
    if at >= len(data):
        what = "has a header but no points" if has_header else "holds no points"
        raise CloudError(f"{name}: {what}; at least one is needed")
    rows = read_rows(data, tuple(found.values()), name, start=at, separator=separator, first_line=n_lines + 1)
    return scan_of({key: rows.values[:, i] for i, key in enumerate(found)}, viewpoint, rows.notes)


def _as_lines(data: bytes) -> bytes:
    """Without byte order mark, lines ending in a line feed."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", errors="replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8)
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def _start_of(data: Content, name: str) -> int:
    """Where the lines of a large file begin, which is not turned into another encoding."""
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        raise CloudError(f"{name}: is UTF-16 text of {len(data)} bytes; save so large a file as UTF-8")
    return len(codecs.BOM_UTF8) if data[:3] == codecs.BOM_UTF8 else 0


def _header(line: str) -> dict[str, int]:
    """Where the columns stand that ``line`` names; empty when it does not name x, y and z."""
    if not line:
        return {}
    names = [_AFTER_NAME.sub("", cell.lower()) for cell in cells_of(line, separator_of(line))]
    for triple in _TRIPLES:
        if all(column in names for column in triple):
            coordinates = {axis: names.index(column) for axis, column in zip(COORDINATES, triple, strict=True)}
            return places(names) | coordinates
    return {}
