"""LAS and LAZ files (ASPRS), read by laspy and lazrs."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content, open_stream
from perception.files.scan import Scan, choose_step, note_thinning, pick_rows
from perception.limits import MAX_FILE_POINTS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_CHUNK = 200_000
_NOISE_CLASSES = (7, 18)
# Variable length records: position of their number in the header, and smallest size of one [bytes].
_N_RECORDS_AT = 100
_RECORD_BYTES = 54
# Length unit of a coordinate system: a GeoTIFF key, or OGC 01-009 text, which also holds angle units.
_LINEAR_UNITS = 3076
_UNIT_BY_CODE = {9001: "m", 9002: "ft", 9003: "ft"}
_UNIT_BY_METRES = {1.0: "m", 0.3048: "ft"}
_UNIT_IN_WORDS = re.compile(r'UNIT\s*\[\s*"[^"]*"\s*,\s*([0-9.eE+-]+)')
_DEGREE = 0.0174533


def read_las(data: Content, name: str) -> Scan:
    """Read points, thinned to at most ``MAX_POINTS``, with scale and offset applied in double precision.

    Points marked as withheld or as noise are left out.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    import laspy  # takes 0.1 s, which other formats do not need

    if data[:4] != b"LASF":
        raise CloudError(f"{name}: does not begin with 'LASF'")
    n_records = struct.unpack_from("<I", data, _N_RECORDS_AT)[0] if len(data) >= _N_RECORDS_AT + 4 else 0
    if n_records * _RECORD_BYTES > len(data):  # laspy would create all announced records, even if the file is too short
        raise CloudError(f"{name}: {n_records} records of {_RECORD_BYTES} bytes are announced in {len(data)} bytes")
    selection = laspy.DecompressionSelection
    source = laspy.open(
        open_stream(data),
        laz_backend=laspy.LazBackend.Lazrs,  # single-threaded; needs memory for one chunk only
        read_evlrs=False,
        decompression_selection=selection.XY_RETURNS_CHANNEL | selection.Z | selection.CLASSIFICATION | selection.FLAGS,
    )
    with source as reader:
        n_points = _check_count(reader.header, len(data), name)
        unit = _find_unit(reader.header)
        step, n_read, chunks = choose_step(n_points), 0, []
        for chunk in reader.chunk_iterator(_CHUNK):
            chunks.append(_select_valid(chunk, pick_rows(len(chunk), step, n_read)))
            n_read += len(chunk)
    points = np.concatenate([valid for valid, _ in chunks])
    n_dropped = sum(n for _, n in chunks)
    if n_read < n_points:
        raise CloudError(f"{name}: {n_points} points are announced, {n_read} are there")
    notes = (f"left out {n_dropped} points marked as withheld or noise",) if n_dropped else ()
    return Scan(points, notes=(*note_thinning(n_points, step), *notes), unit=unit)


def _find_unit(header: Any) -> str:
    """Return the length unit of the coordinate system; empty if unknown.  Survey feet (2e-6 longer) count as feet."""
    units: set[str] = set()
    for record in header.vlrs:
        words = getattr(record, "string", None)
        if isinstance(words, str):
            units.update(_parse_unit(number) for number in _UNIT_IN_WORDS.findall(words))
        units.update(
            _UNIT_BY_CODE.get(k.value_offset, "?") for k in getattr(record, "geo_keys", ()) if k.id == _LINEAR_UNITS
        )
    units.discard("")
    unit = units.pop() if len(units) == 1 else ""
    return unit.removesuffix("?")


def _parse_unit(number: str) -> str:
    """Return the unit with this length in metres; empty for the unit of angles, ``?`` for an unknown one."""
    try:
        metres = float(number)
    except ValueError:
        return "?"
    if abs(metres - _DEGREE) < 1e-4:
        return ""
    return next((unit for known, unit in _UNIT_BY_METRES.items() if abs(metres - known) < 1e-5), "?")


def _check_count(header: Any, n_bytes: int, name: str) -> int:
    """Return the number of points in the header, checked against the file's size."""
    n_points, stride = int(header.point_count), int(header.point_format.size)
    if n_points == 0:
        raise CloudError(f"{name}: the header announces no points; at least one is needed")
    if n_points > MAX_FILE_POINTS:
        raise CloudError(f"{name}: the header announces {n_points} points; at most {MAX_FILE_POINTS} are read")
    there = max(n_bytes - int(header.offset_to_point_data), 0)
    if not header.are_points_compressed and there < n_points * stride:
        raise CloudError(
            f"{name}: {n_points} points of {stride} bytes are announced, but only {there} bytes are there for them"
        )
    return n_points


def _select_valid(chunk: Any, rows: Int[np.ndarray, "K"] | slice) -> tuple[Float[np.ndarray, "C 3"], int]:
    """Return the (C, 3) valid points in these rows of a chunk, and the number of invalid points."""
    points = np.stack([np.asarray(axis, dtype=np.float64)[rows] for axis in (chunk.x, chunk.y, chunk.z)], axis=1)
    invalid: Bool[np.ndarray, "C"] = np.isin(np.asarray(chunk.classification)[rows], _NOISE_CLASSES)
    invalid |= np.asarray(chunk.withheld)[rows] != 0
    return points[~invalid], int(invalid.sum())
