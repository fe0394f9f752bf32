"""Clouds as text tables (XYZ, CSV, with or without header) and as numpy archives (NPZ)."""

from __future__ import annotations

import io
import math
import zipfile

import numpy as np
from jaxtyping import Float

from perception.errors import CloudError
from perception.files.ply import parse_viewpoint
from perception.limits import MAX_FILE_BYTES, MAX_POINTS

_TRIPLES = (("x", "y", "z"), ("points:0", "points:1", "points:2"), ("points_0", "points_1", "points_2"))
_COMMENTS = ("#", "//", "%")
_ARRAY_NAMES = ("points", "xyz", "positions", "arr_0")
_ORIGIN_NAMES = ("viewpoint", "origin")


def read_text(data: bytes, name: str) -> tuple[Float[np.ndarray, "N 3"], tuple[float, ...] | None]:
    """Coordinates from columns separated by blanks, tabs, commas or semicolons.

    A first line that is not numbers is a header and names the columns (x y z in any case, or ``Points:0`` ...);
    without one the first three columns are taken.  A comment ``# viewpoint x y z [qw qx qy qz]`` gives the sensor.

    Raises:
        CloudError: naming ``name``, the line and what is wrong.
    """
    viewpoint = None
    rows: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(data.decode("utf-8-sig", errors="replace").splitlines(), start=1):
        text = line.strip()
        if text.startswith(_COMMENTS) and not (not rows and _names(text.lstrip("#/% "))):
            words = text.lstrip("#/% ").split()
            if words[:1] == ["viewpoint"]:
                viewpoint = parse_viewpoint(words[1:], name)
        elif text:
            rows.append(text)
            numbers.append(number)
    if not rows:
        raise CloudError(f"{name}: holds no points; at least one is needed")
    columns = [0, 1, 2]
    header = _names(rows[0].lstrip("#/% "))
    if header:
        columns = _coordinate_columns(header, name)
        rows, numbers = rows[1:], numbers[1:]
    if not rows:
        raise CloudError(f"{name}: has a header but no points; at least one is needed")
    if len(rows) > MAX_POINTS:
        raise CloudError(f"{name}: {len(rows)} lines; at most {MAX_POINTS} are read, downsample it first")
    return _numbers(rows, numbers, columns, name), viewpoint


def _separator(line: str) -> str:
    return next((mark for mark in (";", ",", "\t") if mark in line), " ")


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    cells = [cell.strip() for cell in line.split(separator)]
    return cells[:-1] if cells and cells[-1] == "" else cells


def _names(line: str) -> list[str]:
    """The column names in ``line``; empty when the line holds no names."""
    cells = [cell.strip("\"' ").lower() for cell in _cells(line, _separator(line))]
    return cells if any(all(name in cells for name in triple) for triple in _TRIPLES) else []


def _coordinate_columns(header: list[str], name: str) -> list[int]:
    for triple in _TRIPLES:
        if all(column in header for column in triple):
            return [header.index(column) for column in triple]
    raise CloudError(f"{name}: columns {', '.join(header)} do not name x, y and z")


def _numbers(rows: list[str], numbers: list[int], columns: list[int], name: str) -> Float[np.ndarray, "N 3"]:
    separator = _separator(rows[0])
    table = [_cells(row, separator) for row in rows]
    width = len(table[0])
    if width <= max(columns):
        raise CloudError(f"{name}: line {numbers[0]} has {width} columns; at least {max(columns) + 1} are needed")
    for number, cells in zip(numbers, table, strict=True):
        if len(cells) != width:
            raise CloudError(f"{name}: line {number} has {len(cells)} columns, the first has {width}")
    picked = [[cells[i] for i in columns] for cells in table]
    if separator == ";":
        # Decimal commas come with semicolons.
        picked = [[cell.replace(",", ".") for cell in cells] for cells in picked]
    try:
        return np.array(picked, dtype=np.float64)
    except ValueError:
        for number, cells in zip(numbers, picked, strict=True):
            for cell in cells:
                if not _is_number(cell):
                    raise CloudError(f"{name}: line {number}: '{cell[:40]}' is not a number") from None
        raise


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_npz(data: bytes, name: str) -> tuple[Float[np.ndarray, "N 3"], tuple[float, ...] | None]:
    """The array ``points`` (or ``xyz``, ``positions``, ``arr_0``) of shape (N, 3 or more); optional ``viewpoint``.

    Pickled objects are never loaded and declared sizes are checked before anything is unpacked.

    Raises:
        CloudError: naming ``name`` and what is wrong.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            found = [key for key in _ARRAY_NAMES if key in members]
            if not found:
                raise CloudError(
                    f"{name}: holds {', '.join(members) or 'nothing'}; an array 'points' of shape (N, 3) is needed"
                )
            points = _load(archive, members[found[0]], name)
            origin = next((_load(archive, members[key], name) for key in _ORIGIN_NAMES if key in members), None)
    except (zipfile.BadZipFile, ValueError, EOFError, OSError, NotImplementedError, zipfile.zlib.error) as error:  # type: ignore[attr-defined]
        if isinstance(error, CloudError):
            raise
        raise CloudError(f"{name}: is not a readable npz archive ({_one_line(error)})") from None
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise CloudError(
            f"{name}: array '{found[0]}' is {points.dtype} of shape {points.shape}; numbers (N, 3) are needed"
        )
    viewpoint = None if origin is None else parse_viewpoint([str(v) for v in np.ravel(origin)], name)
    return points[:, :3].astype(np.float64), viewpoint


def _load(archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str) -> np.ndarray:
    """One array of the archive, its declared size checked first."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        reader = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
        if reader is None:
            raise ValueError(f"npy version {version}")
        shape, _, dtype = reader(member)
        if dtype.hasobject:
            raise CloudError(f"{name}: array '{info.filename}' holds pickled objects; plain numbers are needed")
        size = math.prod(shape) * dtype.itemsize
    if max(size, info.file_size) > MAX_FILE_BYTES:
        raise CloudError(
            f"{name}: array '{info.filename}' claims {max(size, info.file_size)} bytes; at most {MAX_FILE_BYTES}"
        )
    with archive.open(info) as member:
        return np.asarray(np.lib.format.read_array(member, allow_pickle=False))


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
