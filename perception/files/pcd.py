"""PCD files (Point Cloud Library, version 0.7): ascii, binary and binary_compressed, read and written."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from perception.errors import CloudError
from perception.files import lzf
from perception.limits import MAX_POINTS

_HEADER_LIMIT = 8192
_NUMPY_KIND = {"F": "f", "I": "i", "U": "u"}
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_ALLOWED_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
IDENTITY_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PcdHeader:
    """What the text before the data says.

    Attributes:
        fields: (name, numpy type, count) in file order.
        n_points: points announced.
        viewpoint: x y z qw qx qy qz of the sensor; None when the file does not say.
        encoding: ``ascii``, ``binary`` or ``binary_compressed``.
        size: bytes up to the data.
    """

    fields: tuple[tuple[str, str, int], ...]
    n_points: int
    viewpoint: tuple[float, ...] | None
    encoding: str
    size: int

    @property
    def dtype(self) -> np.dtype[np.void]:
        """One point in memory; field names are made unique, since padding fields repeat ``_``."""
        return np.dtype([(str(i), kind, (count,)) for i, (_, kind, count) in enumerate(self.fields)])


def read_pcd(data: bytes, name: str) -> tuple[Float[np.ndarray, "N 3"], tuple[float, ...] | None]:
    """Coordinates, NaN included, and the VIEWPOINT.

    Raises:
        CloudError: naming ``name`` and what is wrong.
    """
    header = _parse_header(data, name)
    columns = []
    for axis in "xyz":
        found = [i for i, (field, _, _) in enumerate(header.fields) if field == axis]
        if not found:
            names = " ".join(field for field, _, _ in header.fields)
            raise CloudError(f"{name}: FIELDS '{names}' has no '{axis}'; x, y and z are needed")
        columns.append(found[0])
    body = data[header.size :]
    if header.encoding == "ascii":
        points = _ascii_points(body, header, columns, name)
    else:
        points = _binary_points(body, header, columns, name)
    return points, header.viewpoint


def write_pcd(
    path: Path | str,
    points: Float[np.ndarray, "N 3"],
    viewpoint: tuple[float, ...] = IDENTITY_VIEWPOINT,
    encoding: str = "binary_compressed",
) -> None:
    """Write x y z as float32.

    Args:
        path: file to write.
        points: (N, 3) [m].
        viewpoint: x y z qw qx qy qz of the sensor in the frame of the points.
        encoding: one of ``ascii``, ``binary``, ``binary_compressed``.
    """
    if encoding not in _ENCODINGS:
        raise ValueError(f"encoding '{encoding}' is unknown; one of {', '.join(_ENCODINGS)} is needed")
    values = np.ascontiguousarray(points, dtype="<f4")
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(values)}\nHEIGHT 1\nVIEWPOINT {' '.join(f'{v:.9g}' for v in viewpoint)}\n"
        f"POINTS {len(values)}\nDATA {encoding}\n"
    )
    if encoding == "ascii":
        body = "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in values.tolist()).encode()
    elif encoding == "binary":
        body = values.tobytes()
    else:
        raw = np.ascontiguousarray(values.T).tobytes()
        packed = lzf.compress(raw)
        body = struct.pack("<II", len(packed), len(raw)) + packed
    Path(path).write_bytes(header.encode() + body)


def _parse_header(data: bytes, name: str) -> PcdHeader:
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
        raise CloudError(f"{name}: DATA '{encoding}' is unknown; one of {', '.join(_ENCODINGS)} is needed")
    return PcdHeader(
        _parse_fields(entries, name), _parse_count(entries, name), _parse_viewpoint(entries, name), encoding, at
    )


def _parse_fields(entries: dict[str, list[str]], name: str) -> tuple[tuple[str, str, int], ...]:
    fields = entries.get("FIELDS", entries.get("COLUMNS", []))
    for key in ("SIZE", "TYPE"):
        if len(entries.get(key, [])) != len(fields):
            raise CloudError(f"{name}: {len(fields)} FIELDS but {len(entries.get(key, []))} {key}; one each is needed")
    counts = entries.get("COUNT", ["1"] * len(fields))
    if len(counts) != len(fields):
        raise CloudError(f"{name}: {len(fields)} FIELDS but {len(counts)} COUNT; one each is needed")
    parsed = []
    for field, size, kind, count in zip(fields, entries["SIZE"], entries["TYPE"], counts, strict=True):
        if kind not in _NUMPY_KIND or not size.isdigit() or int(size) not in _ALLOWED_SIZES[kind]:
            raise CloudError(f"{name}: field '{field}' has TYPE {kind} SIZE {size}; F 4|8, I or U 1|2|4|8 are possible")
        if not count.isdigit() or not 1 <= int(count) <= 65536:
            raise CloudError(f"{name}: field '{field}' has COUNT {count}; a positive number is needed")
        parsed.append((field, f"<{_NUMPY_KIND[kind]}{size}", int(count)))
    return tuple(parsed)


def _parse_count(entries: dict[str, list[str]], name: str) -> int:
    numbers = {}
    for key in ("WIDTH", "HEIGHT", "POINTS"):
        if key in entries:
            word = " ".join(entries[key])
            if not word.isdigit():
                raise CloudError(f"{name}: {key} '{word}' is not a whole number of at least 0")
            numbers[key] = int(word)
    shape = numbers.get("WIDTH", 0) * numbers.get("HEIGHT", 1)
    n_points = numbers.get("POINTS", shape)
    if "WIDTH" in numbers and shape != n_points:
        raise CloudError(f"{name}: WIDTH x HEIGHT is {shape} but POINTS is {n_points}; they must agree")
    if n_points == 0:
        raise CloudError(f"{name}: the header announces no points; at least one is needed")
    if n_points > MAX_POINTS:
        raise CloudError(f"{name}: the header announces {n_points} points; at most {MAX_POINTS} are read")
    return n_points


def _parse_viewpoint(entries: dict[str, list[str]], name: str) -> tuple[float, ...] | None:
    if "VIEWPOINT" not in entries:
        return None
    try:
        viewpoint = tuple(float(word) for word in entries["VIEWPOINT"])
    except ValueError:
        viewpoint = ()
    if len(viewpoint) != 7 or not np.isfinite(viewpoint).all() or np.linalg.norm(viewpoint[3:]) < 1e-6:
        text = " ".join(entries["VIEWPOINT"])
        raise CloudError(f"{name}: VIEWPOINT '{text}' is not x y z and a quaternion w x y z")
    return viewpoint


def _ascii_points(body: bytes, header: PcdHeader, columns: list[int], name: str) -> Float[np.ndarray, "N 3"]:
    offsets = np.concatenate([[0], np.cumsum([count for _, _, count in header.fields])])
    width = int(offsets[-1])
    words = body.split()
    if len(words) < header.n_points * width:
        raise CloudError(
            f"{name}: {header.n_points} points of {width} numbers are announced, {len(words)} numbers are there"
        )
    table = np.array(words[: header.n_points * width]).reshape(header.n_points, width)
    try:
        return table[:, offsets[columns]].astype(np.float64)
    except ValueError as error:
        raise CloudError(f"{name}: {str(error).replace('np.bytes_(b', '').rstrip(')')}; numbers are needed") from None


def _binary_points(body: bytes, header: PcdHeader, columns: list[int], name: str) -> Float[np.ndarray, "N 3"]:
    n, stride = header.n_points, header.dtype.itemsize
    if header.encoding == "binary":
        if len(body) < n * stride:
            raise CloudError(
                f"{name}: {n} points of {stride} bytes are announced, but only {len(body)} bytes follow the header"
            )
        table = np.frombuffer(body, dtype=header.dtype, count=n)
        return np.stack([table[str(i)][:, 0].astype(np.float64) for i in columns], axis=1)
    raw = _unpack(body, n * stride, name)
    # binary_compressed stores field after field, each for all points.
    starts = np.concatenate([[0], np.cumsum([np.dtype(kind).itemsize * count for _, kind, count in header.fields])]) * n
    out = []
    for i in columns:
        _, kind, count = header.fields[i]
        column = np.frombuffer(raw, dtype=kind, count=n * count, offset=int(starts[i]))
        out.append(column.reshape(n, count)[:, 0].astype(np.float64))
    return np.stack(out, axis=1)


def _unpack(body: bytes, size: int, name: str) -> bytes:
    if len(body) < 8:
        raise CloudError(f"{name}: ends before the sizes of its compressed data")
    packed_size, raw_size = struct.unpack("<II", body[:8])
    if raw_size != size:
        raise CloudError(f"{name}: compressed data announce {raw_size} bytes, the header's points need {size}")
    if len(body) - 8 < packed_size:
        raise CloudError(f"{name}: {packed_size} compressed bytes are announced, {len(body) - 8} are there")
    try:
        return lzf.decompress(body[8 : 8 + packed_size], size)
    except ValueError as error:
        raise CloudError(f"{name}: the compressed data are damaged: {error}") from None
