"""E57 files (ASTM E2807), read by pye57: all scans of a file, each transformed by its pose."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.errors import CloudError
from perception.files.pcd import IDENTITY_VIEWPOINT
from perception.files.scan import Scan, choose_step, note_thinning, pick_rows
from perception.limits import MAX_FILE_POINTS

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_VALID, _DIRECTION_ONLY = 0, 1
_BLOCK = 500_000


def read_e57(path: Path, name: str) -> Scan:
    """Read the points of all scans in the file's frame, thinned to at most ``MAX_POINTS``.

    A ray with only a valid direction has no return.  The file does not give its free distance, which is set to the
    median range of the scan's points.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    from pye57 import ScanHeader, libe57  # optional

    file = libe57.ImageFile(str(path), "r")
    try:
        headers = [ScanHeader(node) for node in file.root()["data3D"]]
        n_points = sum(int(header.point_count) for header in headers)
        if n_points == 0:
            raise CloudError(f"{name}: holds {len(headers)} scans without points; at least one point is needed")
        if n_points > MAX_FILE_POINTS:
            raise CloudError(
                f"{name}: its {len(headers)} scans announce {n_points} points; at most {MAX_FILE_POINTS} are read"
            )
        step = choose_step(n_points)
        headers = [header for header in headers if header.point_count]
        stations = [_read_station(libe57, file, header, step, name) for header in headers]
        is_placed = any(_is_placed(*_read_pose(header, name)) for header in headers)
    finally:
        file.close()
    points = np.concatenate([points for points, _, _ in stations])
    misses = np.concatenate([misses for _, misses, _ in stations])
    notes = note_thinning(n_points, step)
    if len(misses):
        notes = (*notes, f"{len(misses)} rays without a return count as free up to their scan's median range")
    if not is_placed:
        return Scan(points, IDENTITY_VIEWPOINT, misses=misses, notes=notes)
    if len(stations) == 1:
        return Scan(points, misses=misses, starts=stations[0][2], notes=notes)
    starts = np.concatenate([np.broadcast_to(start, points.shape) for points, _, start in stations])
    miss_starts = np.concatenate([np.broadcast_to(start, misses.shape) for _, misses, start in stations])
    return Scan(points, misses=misses, starts=starts, miss_starts=miss_starts, notes=notes)


def _read_station(
    libe57: Any, file: Any, header: Any, step: int, name: str
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "M 3"], Float[np.ndarray, "3"]]:
    """Read points, ends of rays without a return, and sensor position of one scan in the file's frame."""
    rotation, position = _read_pose(header, name)
    columns, state = _read_columns(libe57, file, header, step, name)
    local = columns if all(field in header.point_fields for field in _CARTESIAN) else _to_cartesian(columns)
    points = local[state == _VALID]
    directions = local[state == _DIRECTION_ONLY]
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    reach = float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 0.0
    misses = reach * directions[lengths[:, 0] > 0.0] / lengths[lengths[:, 0] > 0.0]
    return points @ rotation.T + position, misses @ rotation.T + position, position


def _read_columns(
    libe57: Any, file: Any, header: Any, step: int, name: str
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "N"]]:
    """Return the coordinates of every ``step``-th point as stored, and their validity codes."""
    system = next((s for s in (_CARTESIAN, _SPHERICAL) if all(field in header.point_fields for field in s)), None)
    if system is None:
        raise CloudError(f"{name}: a scan has neither cartesian nor spherical coordinates")
    n_points = int(header.point_count)
    n_block = min(n_points, _BLOCK)
    arrays = {field: np.zeros(n_block) for field in system}
    flag = "cartesianInvalidState" if system is _CARTESIAN else "sphericalInvalidState"
    state = np.zeros(n_block, dtype=np.int8)
    buffers = libe57.VectorSourceDestBuffer()
    for field, array in (arrays | ({flag: state} if flag in header.point_fields else {})).items():
        buffers.append(libe57.SourceDestBuffer(file, field, array, n_block, True, True))
    reader = header.points.reader(buffers)
    blocks, states, n_read = [], [], 0
    while n := int(reader.read()):
        rows = pick_rows(n, step, n_read)
        blocks.append(np.stack([arrays[field][:n][rows] for field in system], axis=1))
        states.append(state[:n][rows].astype(np.int64))
        n_read += n
    reader.close()
    if n_read != n_points:
        raise CloudError(f"{name}: a scan announces {n_points} points, {n_read} are there")
    columns, valid = np.concatenate(blocks), np.concatenate(states)
    if system is _SPHERICAL:
        columns[valid == _DIRECTION_ONLY, 0] = 1.0  # a direction has no range
    return columns, valid


def _is_placed(rotation: Float[np.ndarray, "3 3"], position: Float[np.ndarray, "3"]) -> bool:
    """Return whether a pose differs from the identity, which writers without a known pose store."""
    return bool(position.any()) or not np.array_equal(rotation, np.eye(3))


def _to_cartesian(spherical: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Convert (range, azimuth, elevation) rows to x y z."""
    distance, azimuth, elevation = spherical.T
    flat = distance * np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


def _read_pose(header: Any, name: str) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return rotation and position of a scan in the file's frame; the identity if it has no pose."""
    if not header.has_pose():
        return np.eye(3), np.zeros(3)
    pose = header.node["pose"]
    w, x, y, z = (
        (float(pose["rotation"][axis].value()) for axis in "wxyz")
        if pose.isDefined("rotation")
        else (1.0, 0.0, 0.0, 0.0)
    )
    position = (
        np.array([float(pose["translation"][axis].value()) for axis in "xyz"])
        if pose.isDefined("translation")
        else np.zeros(3)
    )
    length = np.sqrt(w * w + x * x + y * y + z * z)
    if not np.isfinite([length, *position]).all() or not length > 1e-6:
        raise CloudError(f"{name}: a scan's pose is no finite position and quaternion")
    w, x, y, z = w / length, x / length, y / length, z / length
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, position
