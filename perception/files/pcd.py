"""PCD files (Point Cloud Library, version 0.7): ascii, binary and binary_compressed, read and written."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.files import lzf
from perception.files.content import Content
from perception.files.scan import (
    NO_RETURN,
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
from perception.files.text import read_rows, use_line_feeds
from perception.limits import MAX_FILE_POINTS, MAX_WHOLE_BYTES

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped

    _Columns = tuple[list[Shaped[np.ndarray, "N"]], tuple[str, ...]]

_HEADER_LIMIT = 8192
_MAX_UNPACKED = 4 * MAX_WHOLE_BYTES
_NUMPY_KIND = {"F": "f", "I": "i", "U": "u"}
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_ALLOWED_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
IDENTITY_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PcdHeader:
    """Header of a PCD file.

    Attributes:
        fields: (name, numpy type, count) in file order.
        n_points: number of points given in the header.
        viewpoint: sensor pose x y z qw qx qy qz; None if the file has none.
        encoding: ``ascii``, ``binary`` or ``binary_compressed``.
        size: size of the header [bytes].
    """

    fields: tuple[tuple[str, str, int], ...]
    n_points: int
    viewpoint: tuple[float, ...] | None
    encoding: str
    size: int

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Data type of one point; field names are made unique, since padding fields repeat ``_``."""
        return np.dtype([(str(i), kind, (count,)) for i, (_, kind, count) in enumerate(self.fields)])


def read_pcd(data: Content, name: str) -> Scan:
    """Read the columns of ``scan.make_scan``, NaN included, thinned to at most ``MAX_POINTS`` rows, and the VIEWPOINT.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    data = use_line_feeds(data, b"DATA ascii")
    header = _parse_header(data, name)
    names = [field for field, _, _ in header.fields]
    indices = index_columns(names)
    if missing := find_missing_axis(indices):
        raise CloudError(f"{name}: FIELDS '{quote(' '.join(names))}' has no '{missing}'; x, y and z are needed")
    read = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_packed}[header.encoding]
    columns, notes = read(data, header, list(indices.values()), name)
    return make_scan(dict(zip(indices, columns, strict=True)), header.viewpoint, notes)


def write_pcd(
    path: Path | str,
    points: Float[np.ndarray, "N 3"],
    viewpoint: Sequence[float] = IDENTITY_VIEWPOINT,
    encoding: str = "binary_compressed",
    misses: Float[np.ndarray, "M 3"] | None = None,
) -> None:
    """Write x y z as float32.

    Args:
        viewpoint: sensor pose x y z qw qx qy qz in the frame of the points.
        encoding: one of ``ascii``, ``binary``, ``binary_compressed``.
        misses: (M, 3) ends of rays without a return [m]; written after the points, with 1 in an additional field
            ``no_return``.
    """
    if encoding not in _ENCODINGS:
        raise ValueError(f"encoding '{encoding}' is unknown; one of {', '.join(_ENCODINGS)} is needed")
    layout = [(axis, "<f4") for axis in "xyz"] + ([] if misses is None else [(NO_RETURN, "u1")])
    rows = np.asarray(points) if misses is None else np.concatenate([points, misses])
    table = np.zeros(len(rows), layout)
    for i, axis in enumerate("xyz"):
        table[axis] = rows[:, i]
    if misses is not None:
        table[NO_RETURN][len(points) :] = 1
    flagged = "" if misses is None else " "
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {' '.join(name for name, _ in layout)}\n"
        f"SIZE 4 4 4{flagged and ' 1'}\nTYPE F F F{flagged and ' U'}\nCOUNT 1 1 1{flagged and ' 1'}\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT {' '.join(f'{v:.9g}' for v in viewpoint)}\n"
        f"POINTS {len(rows)}\nDATA {encoding}\n"
    )
    if encoding == "ascii":
        body = "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in table.tolist()).encode()
    elif encoding == "binary":
        body = table.tobytes()
    else:
        raw = b"".join(table[field].tobytes() for field, _ in layout)
        packed = lzf.compress(raw)
        body = struct.pack("<II", len(packed), len(raw)) + packed
    Path(path).write_bytes(header.encode() + body)


def _parse_header(data: Content, name: str) -> PcdHeader:
    entries: dict[str, list[str]] = {}
    at = 0
    while True:
        end = data.find(b"\n", at, _HEADER_LIMIT)
        if end < 0:
            raise CloudError(f"{name}: no DATA line in the first {_HEADER_LIMIT} bytes; a PCD header ends with one")
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
            if words[0].upper() == "DATA":
                break
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in _ENCODINGS:
        raise CloudError(f"{name}: DATA '{quote(encoding)}' is unknown; one of {', '.join(_ENCODINGS)} is needed")
    return PcdHeader(
        _parse_fields(entries, name), _parse_count(entries, name), _parse_viewpoint(entries, name), encoding, at
    )


def _parse_fields(entries: dict[str, list[str]], name: str) -> tuple[tuple[str, str, int], ...]:
    fields = entries.get("FIELDS", entries.get("COLUMNS", []))
    if not fields:
        raise CloudError(f"{name}: the header has no FIELDS; x, y and z are needed")
    for key in ("SIZE", "TYPE"):
        if len(entries.get(key, [])) != len(fields):
            raise CloudError(f"{name}: {len(fields)} FIELDS but {len(entries.get(key, []))} {key}; one each is needed")
    counts = entries.get("COUNT", ["1"] * len(fields))
    if len(counts) != len(fields):
        raise CloudError(f"{name}: {len(fields)} FIELDS but {len(counts)} COUNT; one each is needed")
    parsed = []
    for field, size, word, count in zip(fields, entries["SIZE"], entries["TYPE"], counts, strict=True):
        kind = word.upper()
        if kind not in _NUMPY_KIND or parse_natural(size) not in _ALLOWED_SIZES[kind]:
            raise CloudError(
                f"{name}: field '{quote(field)}' has TYPE {quote(word)} SIZE {quote(size)}; "
                "F 4|8, I or U 1|2|4|8 are possible"
            )
        repeats = parse_natural(count) or 0
        if not 1 <= repeats <= 65536:
            raise CloudError(f"{name}: field '{quote(field)}' has COUNT {quote(count)}; a positive number is needed")
        parsed.append((field, f"<{_NUMPY_KIND[kind]}{parse_natural(size)}", repeats))
    return tuple(parsed)


def _parse_count(entries: dict[str, list[str]], name: str) -> int:
    numbers = {}
    for key in ("WIDTH", "HEIGHT", "POINTS"):
        if key in entries:
            word = " ".join(entries[key])
            number = parse_natural(word)
            if number is None:
                raise CloudError(f"{name}: {key} '{quote(word)}' is not a whole number of at least 0")
            numbers[key] = number
    shape = numbers.get("WIDTH", 0) * numbers.get("HEIGHT", 1)
    n_points = numbers.get("POINTS", shape)
    if "WIDTH" in numbers and shape != n_points:
        raise CloudError(f"{name}: WIDTH x HEIGHT is {shape} but POINTS is {n_points}; they must agree")
    if n_points == 0:
        raise CloudError(f"{name}: the header announces no points; at least one is needed")
    if n_points > MAX_FILE_POINTS:
        raise CloudError(f"{name}: the header announces {n_points} points; at most {MAX_FILE_POINTS} are read")
    return n_points


def _parse_viewpoint(entries: dict[str, list[str]], name: str) -> tuple[float, ...] | None:
    if "VIEWPOINT" not in entries:
        return None
    return parse_viewpoint(entries["VIEWPOINT"], name)


def _read_ascii(data: Content, header: PcdHeader, fields: list[int], name: str) -> _Columns:
    offsets = np.concatenate([[0], np.cumsum([count for _, _, count in header.fields])])
    first_line = data[: header.size].count(b"\n") + 1
    columns = [int(offsets[i]) for i in fields]
    rows = read_rows(
        data, columns, name, start=header.size, width=int(offsets[-1]), n_rows=header.n_points, first_line=first_line
    )
    if rows.n_there < header.n_points:
        raise CloudError(f"{name}: {header.n_points} points are announced, {rows.n_there} lines are there")
    return list(rows.values.T), rows.notes


def _read_binary(data: Content, header: PcdHeader, fields: list[int], name: str) -> _Columns:
    there, n, stride = len(data) - header.size, header.n_points, header.dtype.itemsize
    if there < n * stride:
        raise CloudError(
            f"{name}: {n} points of {stride} bytes are announced, but only {there} bytes follow the header"
        )
    table = np.frombuffer(data, dtype=header.dtype, count=n, offset=header.size)
    rows = pick_rows(n, choose_step(n))
    return [table[str(i)][rows, 0] for i in fields], note_thinning(n, choose_step(n))


def _read_packed(data: Content, header: PcdHeader, fields: list[int], name: str) -> _Columns:
    """Read ``binary_compressed`` data, which stores field after field, each for all points."""
    n = header.n_points
    raw = _unpack(data, header.size, n * header.dtype.itemsize, name)
    starts = np.concatenate([[0], np.cumsum([np.dtype(kind).itemsize * count for _, kind, count in header.fields])]) * n
    columns = []
    for i in fields:
        _, kind, count = header.fields[i]
        column = np.frombuffer(raw, dtype=kind, count=n * count, offset=int(starts[i]))
        columns.append(column.reshape(n, count)[pick_rows(n, choose_step(n)), 0])
    return columns, note_thinning(n, choose_step(n))


def _unpack(data: Content, start: int, size: int, name: str) -> bytes:
    if len(data) < start + 8:
        raise CloudError(f"{name}: ends before the sizes of its compressed data")
    packed_size, raw_size = struct.unpack_from("<II", data, start)
    there = len(data) - start - 8
    if raw_size != size:
        raise CloudError(f"{name}: compressed data announce {raw_size} bytes, the header's points need {size}")
    if packed_size > MAX_WHOLE_BYTES:
        raise CloudError(
            f"{name}: {packed_size} compressed bytes, which are unpacked as a whole; at most {MAX_WHOLE_BYTES} are "
            "read, save it as DATA binary"
        )
    if size > _MAX_UNPACKED:
        raise CloudError(f"{name}: unpacks to {size} bytes; at most {_MAX_UNPACKED} are read, leave out some fields")
    if there < packed_size:
        raise CloudError(f"{name}: {packed_size} compressed bytes are announced, {there} are there")
    try:
        return lzf.decompress(data[start + 8 : start + 8 + packed_size], size)
    except ValueError as error:
        raise CloudError(f"{name}: the compressed data are damaged: {error}") from None
