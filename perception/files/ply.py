"""PLY files (Stanford polygon format): the vertex coordinates of ascii and binary files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.errors import CloudError
from perception.limits import MAX_POINTS

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


def read_ply(data: bytes, name: str) -> tuple[Float[np.ndarray, "N 3"], tuple[float, ...] | None]:
    """Vertex coordinates, and the viewpoint when a ``comment viewpoint x y z qw qx qy qz`` gives it.

    Raises:
        CloudError: naming ``name`` and what is wrong.
    """
    lines, start = _header_lines(data, name)
    order = _byte_order(lines, name)
    before, vertex = _split_at_vertex(_parse_elements(lines, name), name)
    names = [field for field, _ in vertex.properties]
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise CloudError(f"{name}: element vertex has no property '{missing[0]}'; x, y and z are needed")
    columns = [names.index(axis) for axis in "xyz"]
    body = data[start:]
    if order is None:
        return _ascii_points(body, sum(e.count for e in before), vertex, columns, name), _viewpoint(lines, name)
    skip = sum(e.count * _dtype(e, order).itemsize for e in before)
    dtype = _dtype(vertex, order)
    if len(body) - skip < vertex.count * dtype.itemsize:
        raise CloudError(
            f"{name}: {vertex.count} vertices of {dtype.itemsize} bytes are announced, "
            f"but only {max(len(body) - skip, 0)} bytes follow the header"
        )
    table = np.frombuffer(body, dtype=dtype, count=vertex.count, offset=skip)
    return np.stack([table[str(i)].astype(np.float64) for i in columns], axis=1), _viewpoint(lines, name)


def _header_lines(data: bytes, name: str) -> tuple[list[list[str]], int]:
    if not data.startswith(b"ply"):
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
        raise CloudError(f"{name}: format '{' '.join(formats)}' is unknown; one of {', '.join(_FORMATS)} is needed")
    return _FORMATS[formats[0]] or None


def _parse_elements(lines: list[list[str]], name: str) -> list[_Element]:
    elements: list[_Element] = []
    for words in lines:
        if words[0] == "element":
            if len(words) != 3 or not words[2].isdigit():
                raise CloudError(f"{name}: '{' '.join(words)}' is not an element with a name and a count")
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[0] == "property":
            kind = "list" if words[1:2] == ["list"] else _TYPES.get(words[1] if len(words) == 3 else "", "")
            if not elements or not kind:
                raise CloudError(f"{name}: '{' '.join(words)}' is not a property of a known type")
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
    if max(element.count for element in elements[: at + 1]) > MAX_POINTS:
        raise CloudError(f"{name}: the header announces {vertex.count} vertices; at most {MAX_POINTS} are read")
    return before, vertex


def _dtype(element: _Element, order: str) -> np.dtype[np.void]:
    return np.dtype([(str(i), order + kind) for i, (_, kind) in enumerate(element.properties)])


def _viewpoint(lines: list[list[str]], name: str) -> tuple[float, ...] | None:
    for words in lines:
        if words[:2] == ["comment", "viewpoint"]:
            return parse_viewpoint(words[2:], name)
    return None


def parse_viewpoint(words: list[str], name: str) -> tuple[float, ...]:
    """``x y z`` or ``x y z qw qx qy qz`` as seven numbers."""
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = ()
    if len(numbers) == 3:
        numbers = (*numbers, 1.0, 0.0, 0.0, 0.0)
    if len(numbers) != 7 or not np.isfinite(numbers).all() or np.linalg.norm(numbers[3:]) < 1e-6:
        raise CloudError(f"{name}: viewpoint '{' '.join(words)}' is not x y z, or x y z and a quaternion w x y z")
    return numbers


def _ascii_points(body: bytes, skip: int, vertex: _Element, columns: list[int], name: str) -> Float[np.ndarray, "N 3"]:
    lines = [line for line in body.splitlines() if line.strip()][skip : skip + vertex.count]
    width = len(vertex.properties)
    if len(lines) < vertex.count:
        raise CloudError(f"{name}: {vertex.count} vertices are announced, {len(lines)} lines are there")
    rows = [line.split() for line in lines]
    for i, row in enumerate(rows):
        if len(row) != width:
            raise CloudError(f"{name}: vertex {i} has {len(row)} numbers; {width} are needed")
    try:
        return np.array(rows)[:, columns].astype(np.float64)
    except ValueError as error:
        raise CloudError(f"{name}: {error}; numbers are needed") from None
