"""PLY files (Stanford polygon format): the vertex coordinates of ascii and binary files."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content
from perception.files.scan import (
    Scan,
    choose_step,
    find_missing_axis,
    index_columns,
    make_scan,
    note_thinning,
    parse_natural,
    parse_viewpoint,
    pick_rows,
    quote,
)
from perception.files.text import Rows, read_rows, use_line_feeds
from perception.limits import MAX_FILE_POINTS

if TYPE_CHECKING:
    from jaxtyping import Int, Shaped

_HEADER_LIMIT = 65536
# Rows times properties that are walked one by one, which takes about a second a million.
_MOST_WALKED = 20_000_000
_LENGTH_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class _Element:
    """One element of the header: its name, its number of rows, and its (name, numpy type) properties.

    The type of a list property is the type of its length, then that of its entries: ``u1 i4``.
    """

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]

    @property
    def has_list(self) -> bool:
        return any(" " in kind for _, kind in self.properties)


def read_ply(data: Content, name: str) -> Scan:
    """Read the vertex columns of ``scan.make_scan``, thinned to at most ``MAX_POINTS`` rows.

    A ``comment viewpoint x y z qw qx qy qz`` gives the sensor pose.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    data = use_line_feeds(data, b"format ascii")
    lines, start = _read_header(data, name)
    order = _parse_byte_order(lines, name)
    elements = _parse_elements(lines, name)
    before, vertex = _split_at_vertex(elements, name)
    indices = index_columns([field for field, _ in vertex.properties])
    if missing := find_missing_axis(indices):
        raise CloudError(f"{name}: element vertex has no property '{missing}'; x, y and z are needed")
    viewpoint = _find_viewpoint(lines, name)
    if order is None:
        rows = _read_ascii(data, start, sum(e.count for e in before), vertex, indices, name)
        notes = (*_note_mesh(elements), *rows.notes)
        return make_scan({key: rows.values[:, i] for i, key in enumerate(indices)}, viewpoint, notes)
    for element in before:
        start = _find_end(data, start, element, order, name)
    step = choose_step(vertex.count)
    taken_rows = pick_rows(vertex.count, step)
    columns = {
        key: values[taken_rows] for key, values in _read_columns(data, start, vertex, indices, order, name).items()
    }
    return make_scan(columns, viewpoint, (*_note_mesh(elements), *note_thinning(vertex.count, step)))


def _note_mesh(elements: list[_Element]) -> tuple[str, ...]:
    """Return a note if the file holds a mesh, since its vertices do not sample its faces."""
    n_faces = sum(element.count for element in elements if element.name in ("face", "tristrips"))
    if not n_faces:
        return ()
    return (f"holds a mesh, of whose {n_faces} faces only the corners are read; give a known object as a mesh",)


def _read_header(data: Content, name: str) -> tuple[list[list[str]], int]:
    if data[:3] != b"ply":
        raise CloudError(f"{name}: does not begin with 'ply'")
    # All lines end as the first: LF, CR LF, or CR alone.
    mark = b"\r" if data[3:4] == b"\r" and data[4:5] != b"\n" else b"\n"
    end = data.find(mark + b"end_header", 0, _HEADER_LIMIT)
    newline = data.find(mark, end + 1)
    if end < 0 or newline < 0:
        raise CloudError(f"{name}: no end_header in the first {_HEADER_LIMIT} bytes")
    return [line.split() for line in data[:end].decode("latin-1").splitlines()[1:] if line.split()], newline + 1


def _parse_byte_order(lines: list[list[str]], name: str) -> str | None:
    """Return ``<`` or ``>``; None for ascii."""
    formats = [words[1] for words in lines if words[0] == "format" and len(words) > 1]
    if not formats or formats[0] not in _FORMATS:
        raise CloudError(
            f"{name}: format '{quote(' '.join(formats))}' is unknown; one of {', '.join(_FORMATS)} is needed"
        )
    return _FORMATS[formats[0]] or None


def _parse_elements(lines: list[list[str]], name: str) -> list[_Element]:
    elements: list[_Element] = []
    for words in lines:
        if words[0] == "element":
            if len(words) != 3 or parse_natural(words[2]) is None:
                raise CloudError(f"{name}: '{quote(' '.join(words))}' is not an element with a name and a count")
            elements.append(_Element(words[1], parse_natural(words[2]) or 0, ()))
        elif words[0] == "property":
            of_list = words[1:2] == ["list"] and len(words) == 5
            kinds = [_TYPES.get(word, "") for word in (words[2:4] if of_list else words[1:2])]
            kind = " ".join(kinds)
            if not elements or not all(kinds) or len(words) != (5 if of_list else 3) or (of_list and "f" in kinds[0]):
                raise CloudError(f"{name}: '{quote(' '.join(words))}' is not a property of a known type")
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, (words[-1], kind)))
    return elements


def _split_at_vertex(elements: list[_Element], name: str) -> tuple[list[_Element], _Element]:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise CloudError(f"{name}: has no element vertex")
    at = names.index("vertex")
    before, vertex = elements[:at], elements[at]
    if vertex.count == 0:
        raise CloudError(f"{name}: the header announces no vertices; at least one is needed")
    if vertex.count > MAX_FILE_POINTS:
        raise CloudError(f"{name}: the header announces {vertex.count} vertices; at most {MAX_FILE_POINTS} are read")
    for element in before:
        if element.count > MAX_FILE_POINTS:
            raise CloudError(
                f"{name}: the header announces {element.count} rows of element {quote(element.name)} before the "
                f"vertices; at most {MAX_FILE_POINTS} are read, put vertices first"
            )
    return before, vertex


def _find_end(data: Content, start: int, element: _Element, order: str, name: str) -> int:
    """Return where the rows of an element of a binary file end."""
    table = _read_table(data, start, element, order, name)
    return start + table.nbytes if table is not None else _walk_rows(data, start, element, order, name)[1]


def _read_columns(
    data: Content, start: int, element: _Element, indices: Mapping[str, int], order: str, name: str
) -> dict[str, Shaped[np.ndarray, "N"]]:
    """Return columns of a binary file, whatever the lengths of its lists."""
    table = _read_table(data, start, element, order, name)
    if table is not None:
        return {key: table[str(i)] for key, i in indices.items()}
    places, _ = _walk_rows(data, start, element, order, name)
    content = np.frombuffer(data, np.uint8)
    columns = {}
    for key, i in indices.items():
        kind = np.dtype(order + element.properties[i][1])
        columns[key] = content[places[:, i, None] + np.arange(kind.itemsize)].view(kind)[:, 0]
    return columns


def _walk_rows(
    data: Content, start: int, element: _Element, order: str, name: str
) -> tuple[Int[np.ndarray, "N P"], int]:
    """Return where each property of each row starts, and the end of the last, for lists of differing lengths."""
    kinds = [[np.dtype(order + part) for part in kind.split()] for _, kind in element.properties]
    unpack = [struct.Struct(order + _LENGTH_CODES[kind[0].str[1:]]).unpack_from for kind in kinds if len(kind) == 2]
    if element.count * max(1, len(kinds)) > _MOST_WALKED:
        raise CloudError(
            f"{name}: element {quote(element.name)} has lists of differing lengths in {element.count} rows, too many "
            f"to read; {_suggest_remedy(element)}"
        )
    places = np.zeros((element.count, len(kinds)), dtype=np.int64)
    at = start
    try:
        for row in range(element.count):
            readers = iter(unpack)
            for i, kind in enumerate(kinds):
                places[row, i] = at
                if len(kind) == 2:
                    length = next(readers)(data, at)[0]
                    if length < 0:
                        raise CloudError(f"{name}: element {quote(element.name)} has a list of {length} entries")
                    at += kind[0].itemsize + length * kind[1].itemsize
                else:
                    at += kind[0].itemsize
    except struct.error:
        at = len(data) + 1
    if at > len(data):
        raise CloudError(f"{name}: ends within the {element.count} rows of element {quote(element.name)}")
    return places, at


def _read_table(data: Content, start: int, element: _Element, order: str, name: str) -> Shaped[np.ndarray, "N"] | None:
    """Read the rows of an element of a binary file; None if its lists differ in length.

    Raises:
        CloudError: the file is too short.
    """
    there = max(len(data) - start, 0)
    layout: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    at = start
    for i, (_, kind) in enumerate(element.properties):
        kinds = [np.dtype(order + part) for part in kind.split()]
        if len(kinds) == 2:
            bytes_of_length = data[at : at + kinds[0].itemsize]
            is_whole = len(bytes_of_length) == kinds[0].itemsize
            length = int(np.frombuffer(bytes_of_length, kinds[0])[0]) if element.count and is_whole else 0
            if not 0 <= length * kinds[1].itemsize <= there:
                raise CloudError(
                    f"{name}: element {quote(element.name)} has a list of {length} entries, more than it holds"
                )
            layout += [(f"{i} length", kinds[0].str), (str(i), kinds[1].str, (length,))]
            at += kinds[0].itemsize + length * kinds[1].itemsize
        else:
            layout.append((str(i), kinds[0].str))
            at += kinds[0].itemsize
    dtype = np.dtype(layout)
    if not element.count or not dtype.itemsize:
        return np.zeros(0, dtype)
    lists = [field for field in dtype.names or () if field.endswith("length")]
    n_there = min(element.count, there // dtype.itemsize)
    table = np.frombuffer(data, dtype=dtype, count=n_there, offset=start)
    if any((table[field] != table[field][:1]).any() for field in lists):
        return None
    if n_there < element.count:
        if lists:  # the first lists may be longer than the others
            return None
        what = "vertices" if element.name == "vertex" else f"rows of element {quote(element.name)}"
        raise CloudError(
            f"{name}: {element.count} {what} of {dtype.itemsize} bytes are announced, but only {there} bytes are there "
            "for them"
        )
    return table


def _suggest_remedy(element: _Element) -> str:
    """Return the advice for an element whose lists differ in length."""
    if element.name != "vertex":
        return "put vertices first"
    return f"leave out {quote(', '.join(name for name, kind in element.properties if ' ' in kind))}"


def _find_viewpoint(lines: list[list[str]], name: str) -> tuple[float, ...] | None:
    for words in lines:
        if words[0] == "comment" and words[1:] and words[1].lower().rstrip(":") == "viewpoint":
            return parse_viewpoint(words[2:], name)
    return None


def _read_ascii(
    data: Content, start: int, n_before: int, vertex: _Element, indices: Mapping[str, int], name: str
) -> Rows:
    first_line = data[:start].count(b"\n") + 1
    for _ in range(n_before):
        at = data.find(b"\n", start) + 1
        if not at:
            raise CloudError(f"{name}: ends before its vertices")
        start, first_line = at, first_line + 1
    if vertex.has_list:
        return _read_listed_rows(data, start, vertex, list(indices.values()), name)
    offsets = list(range(len(vertex.properties) + 1))
    rows = read_rows(
        data,
        [offsets[i] for i in indices.values()],
        name,
        start=start,
        width=offsets[-1],
        n_rows=vertex.count,
        first_line=first_line,
    )
    if rows.n_there < vertex.count:
        raise CloudError(f"{name}: {vertex.count} vertices are announced, {rows.n_there} lines are there")
    return rows


def _read_listed_rows(data: Content, start: int, vertex: _Element, columns: list[int], name: str) -> Rows:
    """Read columns of rows of text that hold lists, of any lengths."""
    lines = bytes(data[start:]).split(b"\n")
    lines = [line for line in lines if line.strip()][: vertex.count]
    if len(lines) < vertex.count:
        raise CloudError(f"{name}: {vertex.count} vertices are announced, {len(lines)} lines are there")
    step = choose_step(vertex.count)
    taken = pick_rows(len(lines), step)
    chosen = lines if isinstance(taken, slice) else [lines[i] for i in taken]
    values = np.empty((len(chosen), len(columns)))
    for row, line in enumerate(chosen):
        words = line.split()
        places, at = [], 0
        for _, kind in vertex.properties:
            places.append(at)
            length = parse_natural(words[at].decode("latin-1")) if " " in kind and at < len(words) else 0
            at += 1 + (length or 0)
        try:
            values[row] = [float(words[places[column]]) for column in columns]
        except (IndexError, ValueError):
            raise CloudError(
                f"{name}: vertex {row} is '{quote(line.decode('latin-1'))}', no row as announced"
            ) from None
    return Rows(values, len(lines), step)
