"""Clouds as numpy archives (NPZ), read and written, and as single arrays (NPY)."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content, open_stream
from perception.files.scan import (
    COORDINATES,
    NO_RETURN,
    STARTS,
    Scan,
    choose_step,
    find_missing_axis,
    index_columns,
    note_thinning,
    parse_viewpoint,
    pick_rows,
    quote,
)
from perception.limits import MAX_FILE_BYTES, MAX_FILE_POINTS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Shaped

    from perception.cloud import Cloud

_POINTS = ("points", "xyz", "positions", "arr_0")
_ORIGIN = ("viewpoint", "origin")
_BLOCK = 2**24
# Wider arrays are images: depth images, or coordinates along the first axis.
_MOST_OF_GRID, _MOST_COLUMNS = 8, 64
_OTHERS = ("no_return", "misses", "miss_origin")


def read_npz(data: Content, name: str) -> Scan:
    """Read the array ``points`` (or ``xyz``, ``positions``, ``arr_0``), or arrays ``x``, ``y`` and ``z`` of one shape.

    Its shape is (N, 3 or more) or (H, W, 3 or more), or it is structured with columns x, y, z and optional others of
    ``scan.make_scan``.

    Optional arrays: ``viewpoint`` or ``origin`` (x y z, x y z qw qx qy qz, or (N, 3) start of each ray);
    ``no_return`` (N,), nonzero where a row is the end of a ray without a return; ``misses`` (M, 3), further such ends,
    and their ``miss_origin``.  Rows are thinned to at most ``MAX_POINTS``, the same rows of all arrays of one length.
    Pickled objects are never loaded, and declared sizes are checked before anything is unpacked.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    try:
        with zipfile.ZipFile(open_stream(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            keys = _find_coordinates(list(members))
            if not keys:
                held = quote(", ".join(members)) or "nothing"
                raise CloudError(f"{name}: holds {held}; an array 'points' of shape (N, 3) is needed")
            origin_key = next((key for key in _ORIGIN if key in members), "")
            wanted = [key for key in (*keys, origin_key, *_OTHERS) if key in members]
            loaded = {key: _load_member(archive, members[key], name) for key in wanted}
    except (zipfile.BadZipFile, ValueError, EOFError, OSError, NotImplementedError, RuntimeError, zlib.error) as error:
        if isinstance(error, CloudError):
            raise
        raise CloudError(f"{name}: is not a readable npz archive ({quote(str(error))})") from None
    parts = [loaded.pop(key) for key in keys]
    n_rows = parts[0][0]
    others = {key: array for key, (_, array) in loaded.items()}
    if len(keys) == 1:
        points, more = _split_columns(parts[0][1], keys[0], name)
    else:
        points, more = _stack_axes([array for _, array in parts], ", ".join(keys), name), {}
    origin = others.pop(origin_key, more.pop("origin", None))
    scan = _make_scan(points, origin, more | others, name)
    return replace(scan, notes=note_thinning(n_rows, choose_step(n_rows)))


def read_npy(data: Content, name: str) -> Scan:
    """Read one array of the same shape as ``points`` of an archive, thinned to at most ``MAX_POINTS`` rows.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    try:
        n_rows, array = _load_array(open_stream(data), len(data), "", name)
    except (ValueError, EOFError, OSError) as error:
        if isinstance(error, CloudError):
            raise
        raise CloudError(f"{name}: is not a readable npy array ({quote(str(error))})") from None
    points, more = _split_columns(array, "", name)
    scan = _make_scan(points, more.pop("origin", None), more, name)
    return replace(scan, notes=note_thinning(n_rows, choose_step(n_rows)))


def _find_coordinates(members: Sequence[str]) -> tuple[str, ...]:
    """Return the name of the array of points, or the names of the x, y and z arrays; empty if there are none."""
    points = next((key for key in _POINTS if key in members), "")
    if points:
        return (points,)
    axes = index_columns(members)
    return () if find_missing_axis(axes) else tuple(members[axes[axis]] for axis in COORDINATES)


def write_npz(path: Path | str, cloud: Cloud) -> None:
    """Write a cloud with all its rays as float64: ``points``, ``origin``, ``misses`` and ``miss_origin``."""
    arrays = {"points": cloud.points, "origin": cloud.origin}
    if len(cloud.misses):
        arrays["misses"] = cloud.misses
        if cloud.miss_origin is not None:
            arrays["miss_origin"] = cloud.miss_origin
    with Path(path).open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _make_scan(
    rows: Float[np.ndarray, "N 3"],
    origin: Shaped[np.ndarray, "..."] | None,
    others: Mapping[str, Shaped[np.ndarray, "..."]],
    name: str,
) -> Scan:
    starts = viewpoint = None
    if origin is not None and origin.ndim == 2 and len(origin) == len(rows):
        starts = _take_coordinates(origin, "origin", name)
    elif origin is not None and origin.ndim == 2 and len(origin) > 1:
        raise CloudError(
            f"{name}: {len(rows)} points but {len(origin)} rows of origin; one each, or one x y z, is needed"
        )
    elif origin is not None:
        viewpoint = parse_viewpoint([str(v) for v in origin.ravel()[:8]], name)
    if "no_return" in others:
        if "misses" in others:
            raise CloudError(f"{name}: holds both no_return and misses; one of them is needed")
        missed = _check_flags(others["no_return"], len(rows), name)
        if starts is None:
            return Scan(rows[~missed], viewpoint, rows[missed])
        return Scan(rows[~missed], viewpoint, rows[missed], starts[~missed], starts[missed])
    if "misses" not in others:
        return Scan(rows, viewpoint, starts=starts)
    misses = _take_coordinates(others["misses"], "misses", name)
    if "miss_origin" not in others:
        if starts is not None:
            raise CloudError(f"{name}: misses need a miss_origin, since each point has an origin of its own")
        return Scan(rows, viewpoint, misses)
    behind = _take_coordinates(np.atleast_2d(others["miss_origin"]), "miss_origin", name)
    if len(behind) not in (1, len(misses)):
        raise CloudError(f"{name}: {len(misses)} misses but {len(behind)} rows of miss_origin; one each is needed")
    return Scan(rows, viewpoint, misses, starts, np.broadcast_to(behind, misses.shape))


def _check_flags(array: Shaped[np.ndarray, "..."], n_rows: int, name: str) -> Bool[np.ndarray, "N"]:
    array = array.ravel()
    if array.shape != (n_rows,) or array.dtype.kind not in "biuf":
        raise CloudError(f"{name}: array 'no_return' is {array.dtype} of shape {array.shape}; ({n_rows},) is needed")
    return np.asarray(array != 0)


def _load_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str) -> tuple[int, Shaped[np.ndarray, "..."]]:
    with archive.open(info) as file:
        return _load_array(file, info.file_size, info.filename, name)


def _load_array(file: IO[bytes], n_bytes: int, key: str, name: str) -> tuple[int, Shaped[np.ndarray, "..."]]:
    """Return the number of rows of an array, and its rows after thinning; checks the declared size before reading."""
    version = np.lib.format.read_magic(file)
    reader = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if reader is None:
        raise ValueError(f"npy version {version}")
    try:
        shape, is_fortran, dtype = reader(file)
    except Exception as error:  # the header is Python source; numpy's parser of it can raise any error
        raise ValueError(f"header of '{key}': {error}") from None
    if dtype.hasobject:
        raise CloudError(f"{name}: {_name_array(key)} holds pickled objects; plain numbers are needed")
    if min(shape, default=0) < 0:
        raise ValueError(f"shape {shape}")
    size = math.prod(shape) * dtype.itemsize
    if max(size, n_bytes) > MAX_FILE_BYTES:
        raise CloudError(f"{name}: {_name_array(key)} claims {max(size, n_bytes)} bytes; at most {MAX_FILE_BYTES}")
    if len(shape) == 3 and not is_fortran and shape[2] <= _MOST_OF_GRID:
        shape = (shape[0] * shape[1], shape[2])  # a grid's points are thinned one by one
    n_rows = shape[0] if shape else 1
    if n_rows > MAX_FILE_POINTS:
        raise CloudError(f"{name}: {_name_array(key)} has {n_rows} rows; at most {MAX_FILE_POINTS} are read")
    if is_fortran and len(shape) > 1:
        columns = [_load_rows(file, n_rows, dtype, (), key) for _ in range(math.prod(shape[1:]))]
        return n_rows, np.stack(columns, axis=-1).reshape((-1, *shape[1:]), order="F")
    rows = _load_rows(file, n_rows, dtype, shape[1:], key)
    return n_rows, rows if shape else rows.reshape(())


def _load_rows(
    file: IO[bytes], n_rows: int, dtype: np.dtype[Any], shape: tuple[int, ...], key: str
) -> Shaped[np.ndarray, "..."]:
    """Read the next rows of a file, thinned to at most ``MAX_POINTS``."""
    stride = math.prod(shape) * dtype.itemsize
    step, block = choose_step(n_rows), max(1, _BLOCK // max(stride, 1))
    parts = [np.zeros((0, *shape), dtype)]
    for first in range(0, n_rows, block):
        n_wanted = min(block, n_rows - first)
        content = file.read(n_wanted * stride)
        if len(content) < n_wanted * stride:
            raise ValueError(f"{_name_array(key)} has {first * stride + len(content)} of {n_rows * stride} bytes")
        rows = np.frombuffer(content, dtype=dtype).reshape((n_wanted, *shape))
        parts.append(rows[pick_rows(n_wanted, step, first)])
    return np.concatenate(parts)


def _take_coordinates(array: Shaped[np.ndarray, "..."], key: str, name: str) -> Float[np.ndarray, "N 3"]:
    """Return the first three columns of an array (N, 3 or more) or (H, W, 3 or more).

    Raises:
        CloudError: the array has another shape, or is not numeric.
    """
    if array.ndim == 2 and array.shape[0] == len(COORDINATES) < array.shape[1]:
        raise CloudError(
            f"{name}: {_name_array(key)} has shape {array.shape}, which looks turned; "
            f"save its transpose {array.shape[::-1]}"
        )
    most = _MOST_OF_GRID if array.ndim == 3 else _MOST_COLUMNS
    if array.ndim not in (2, 3) or not 3 <= array.shape[-1] <= most or array.dtype.kind not in "fiu":
        raise CloudError(
            f"{name}: {_name_array(key)} is {array.dtype} of shape {array.shape}; "
            "numbers (N, 3) or (H, W, 3) are needed"
        )
    return array.reshape(-1, array.shape[-1])[:, :3].astype(np.float64)


def _split_columns(
    array: Shaped[np.ndarray, "..."], key: str, name: str
) -> tuple[Float[np.ndarray, "N 3"], dict[str, Shaped[np.ndarray, "..."]]]:
    """Return the coordinates of a structured array, and its columns ``origin`` and ``no_return`` by name.

    Raises:
        CloudError: coordinates are missing or not numeric.
    """
    if array.dtype.names is None:
        return _take_coordinates(array, key, name), {}
    indices = index_columns(array.dtype.names)
    if missing := find_missing_axis(indices):
        held = quote(", ".join(array.dtype.names))
        raise CloudError(f"{name}: {_name_array(key)} has columns {held}, and no '{missing}'; x, y and z are needed")
    columns = {column: array[array.dtype.names[at]] for column, at in indices.items()}
    more: dict[str, Shaped[np.ndarray, "..."]] = {}
    if NO_RETURN in columns:
        more[NO_RETURN] = columns[NO_RETURN]
    if all(axis in columns for axis in STARTS):
        more["origin"] = _stack_axes([columns[axis] for axis in STARTS], key, name)
    return _stack_axes([columns[axis] for axis in COORDINATES], key, name), more


def _stack_axes(columns: list[Shaped[np.ndarray, "..."]], key: str, name: str) -> Float[np.ndarray, "N 3"]:
    """Stack arrays of x, y and z into (N, 3) rows.

    Raises:
        CloudError: their shapes differ, or they are not numeric.
    """
    shapes = {column.shape for column in columns}
    if len(shapes) > 1 or any(column.dtype.kind not in "fiu" or column.ndim not in (1, 2) for column in columns):
        held = ", ".join(f"{column.dtype} {column.shape}" for column in columns)
        raise CloudError(f"{name}: {key or 'its'} columns are {held}; numbers, (N,) or (H, W) each, are needed")
    return np.stack([column.ravel().astype(np.float64) for column in columns], axis=1)


def _name_array(key: str) -> str:
    """Return the name of an array for messages; ``key`` is empty for the only array of a file."""
    return f"array '{key}'" if key else "array"
