"""PLY files (Stanford polygon format): the vertex coordinates of ascii and binary files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.errors import CloudError
from perception.files.columns import missing_coordinate, natural, parse_viewpoint, places, scan_of, shown
from perception.files.content import Content
from perception.files.scan import Scan
from perception.files.text import Rows, read_rows
from perception.files.thinning import step_of, taken, thinning_note
from perception.limits import MAX_FILE_POINTS

_HEADER_LIMIT = 65536
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class _Element:
    """One element of the header: its name, how many there are, and its (name, numpy type) properties.

    A list property has type ``list``; its width is known only while reading.
    """

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]

    @property
    def has_list(self) -> bool:
        return any(kind == "list" for _, kind in self.properties)


def read_ply(data: Content, name: str) -> Scan:
    """Vertices, thinned to as many as are used, as ``columns.scan_of`` takes them.

    A ``comment viewpoint x y z qw qx qy qz`` gives the sensor.

    Raises:
        CloudError: naming ``name`` and what is wrong.
    """
    lines, start = _header_lines(data, name)
    order = _byte_order(lines, name)
    before, vertex = _split_at_vertex(_parse_elements(lines, name), name)
    found = places([field for field, _ in vertex.properties])
    if missing := missing_coordinate(found):
        raise CloudError(f"{name}: element vertex has no property '{missing}'; x, y and z are needed")
    viewpoint = _viewpoint(lines, name)
    if order is None:
        rows = _ascii_rows(data, start, sum(e.count for e in before), vertex, list(found.values()), name)
        return scan_of({key: rows.values[:, i] for i, key in enumerate(found)}, viewpoint, rows.notes)
    start += sum(e.count * _dtype(e, order).itemsize for e in before)
    dtype = _dtype(vertex, order)
    if len(data) - start < vertex.count * dtype.itemsize:
        raise CloudError(
            f"{name}: {vertex.count} vertices of {dtype.itemsize} bytes are announced, "
            f"but only {max(len(data) - start, 0)} bytes are there for them"
        )
    table = np.frombuffer(data, dtype=dtype, count=vertex.count, offset=start)
    step = step_of(vertex.count)
    taken_rows = taken(vertex.count, step)
    columns = {key: table[str(i)][taken_rows] for key, i in found.items()}
    return scan_of(columns, viewpoint, thinning_note(vertex.count, step))


def _header_lines(data: Content, name: str) -> tuple[list[list[str]], int]:
    if data[:3] != b"ply":
        raise CloudError(f"{name}: does not begin with 'ply'")
    end = data.find(b"end_header", 0, _HEADER_LIMIT)
    newline = data.find(b"\n", end)
    if end < 0 or newline < 0:
        raise CloudError(f"{name}: no end_header in the first {_HEADER_LIMIT} bytes")
    return [line.split() for line in data[:end].decode("latin-1").splitlines()[1:] if line.split()], newline + 1


def _byte_order(lines: list[list[str]], name: str) -> str | None:
    """``<`` or ``>``; None for ascii."""
    formats = [words[1] for words in lines if words[0] == "format" and len(words) > 1]
    if not formats or formats[0] not in _FORMATS:
        raise CloudError(
            f"{name}: format '{shown(' '.join(formats))}' is unknown; one of {', '.join(_FORMATS)} is needed"
        )
    return _FORMATS[formats[0]] or None


def _parse_elements(lines: list[list[str]], name: str) -> list[_Element]:
    elements: list[_Element] = []
    for words in lines:
        if words[0] == "element":
            if len(words) != 3 or natural(words[2]) is None:
                raise CloudError(f"{name}: '{shown(' '.join(words))}' is not an element with a name and a count")
            elements.append(_Element(words[1], natural(words[2]) or 0, ()))
        elif words[0] == "property":
            kind = "list" if words[1:2] == ["list"] else _TYPES.get(words[1] if len(words) == 3 else "", "")
            if not elements or not kind:
                raise CloudError(f"{name}: '{shown(' '.join(words))}' is not a property of a known type")
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, (words[-1], kind)))
    return elements


def _split_at_vertex(elements: list[_Element], name: str) -> tuple[list[_Element], _Element]:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise CloudError(f"{name}: has no element vertex")
    at = names.index("vertex")
    before, vertex = elements[:at], elements[at]
    if vertex.has_list or any(element.has_list for element in before):
        raise CloudError(f"{name}: has list properties in or before its vertices; vertices must come first")
    if vertex.count == 0:
        raise CloudError(f"{name}: the header announces no vertices; at least one is needed")
    if max(element.count for element in elements[: at + 1]) > MAX_FILE_POINTS:
        raise CloudError(f"{name}: the header announces {vertex.count} vertices; at most {MAX_FILE_POINTS} are read")
    return before, vertex


def _dtype(element: _Element, order: str) -> np.dtype[np.void]:
    return np.dtype([(str(i), order + kind) for i, (_, kind) in enumerate(element.properties)])


def _viewpoint(lines: list[list[str]], name: str) -> tuple[float, ...] | None:
    for words in lines:
        if words[:2] == ["comment", "viewpoint"]:
            return parse_viewpoint(words[2:], name)
    return None


def _ascii_rows(data: Content, start: int, n_before: int, vertex: _Element, columns: list[int], name: str) -> Rows:
    first_line = data[:start].count(b"\n") + 1
    for _ in range(n_before):
        at = data.find(b"\n", start) + 1
        if not at:
            raise CloudError(f"{name}: ends before its vertices")
        start, first_line = at, first_line + 1
    rows = read_rows(
        data, columns, name, start=start, width=len(vertex.properties), n_rows=vertex.count, first_line=first_line
    )
    if rows.n_there < vertex.count:
        raise CloudError(f"{name}: {vertex.count} vertices are announced, {rows.n_there} lines are there")
    return rows
