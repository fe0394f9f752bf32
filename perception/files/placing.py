"""Transformation of scans to the world: unit, viewpoint and transform, and checks for typical file faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from perception.cloud import Cloud, make_cloud
from perception.errors import CloudError
from perception.files.scan import Scan
from perception.limits import LARGEST_COORDINATE, MAX_INVALID_FRACTION

# Longer than any ray [m].
_MAP_DISTANCE = 1_000.0
# Smallest rounding step that is reported [m].
_COARSE_M = 0.001
_SAMPLE = 10_000
METRES_BY_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}
_RIGID_TOLERANCE = 1e-4
_LARGEST_ANGLE = 2.0 * np.pi + 1e-3

PoseInput = Float[np.ndarray, "4 4"] | Sequence[float] | Sequence[Sequence[float]]


def place_scan(
    scan: Scan,
    name: str,
    unit: str,
    transform: PoseInput | None,
    apply_viewpoint: bool,
    sensor: Sequence[float] | None,
) -> Cloud:
    """Return one file's cloud in metres in the requested frame."""
    scale = _parse_unit(unit)
    pose = np.eye(4) if transform is None else rigid_pose(transform)
    scan = _drop_empty_rows(scan, name)
    notes = (*scan.notes, *_note_rounding(scan.points, scale))
    if scan.unit and scan.unit != unit:
        notes = (f"its header says {scan.unit}, but it was read as {unit}: give the unit {scan.unit}", *notes)
    viewpoint = np.eye(4)
    if scan.viewpoint is not None:
        viewpoint = _make_viewpoint_pose(scan.viewpoint)
        viewpoint[:3, 3] *= scale
    elif apply_viewpoint:
        raise CloudError(f"{name}: gives no viewpoint to apply; add one, or leave the points as they are")
    if transform is None and not apply_viewpoint:
        notes = (*notes, *_hint_at_frame(scale * scan.points, viewpoint))
    pose_world_rows = pose @ viewpoint if apply_viewpoint else pose
    points = move_points(pose_world_rows, scan.points, scale)
    # Writers that do not know the sensor pose write the identity as viewpoint.
    has_origin = scan.starts is not None or not np.array_equal(viewpoint, np.eye(4))
    if has_origin and sensor is not None:
        notes = (*notes, "the file says where its rays started; the sensor's position that is given is not used")
    if scan.starts is not None:
        origin = move_points(pose_world_rows, scan.starts, scale)
    elif has_origin:
        origin = move_points(pose, viewpoint[:3, 3])
    else:
        origin, more = _guess_sensor(points, pose[:3, 3], sensor)
        if scan.viewpoint is None or not np.array_equal(origin, pose[:3, 3]):
            notes = (*notes, *more)
    return make_cloud(
        points,
        origin,
        notes,
        name,
        misses=move_points(pose_world_rows, scan.misses, scale),
        miss_origin=None if scan.miss_starts is None else move_points(pose_world_rows, scan.miss_starts, scale),
    )


def _guess_sensor(
    points: Float[np.ndarray, "N 3"], zero: Float[np.ndarray, "3"], sensor: Sequence[float] | None
) -> tuple[Float[np.ndarray, "3"], tuple[str, ...]]:
    """Return the assumed start of the rays [m] for a file that does not give it, and a note about the assumption.

    Args:
        zero: origin of the file's frame in the world [m].
        sensor: position given by the user [m].
    """
    if sensor is not None:
        position = np.asarray(sensor, dtype=np.float64)
        if position.shape != (3,) or not (np.abs(position) <= LARGEST_COORDINATE).all():
            raise CloudError(
                f"sensor {list(sensor)} is no position; three numbers, at most {LARGEST_COORDINATE:g} m, are needed"
            )
        return position, ()
    valid = points[np.isfinite(points).all(axis=1)]
    distance = float(np.linalg.norm(np.median(valid, axis=0) - zero)) if len(valid) else 0.0
    if distance > _MAP_DISTANCE and np.any(zero):
        note = (
            f"the file gives no sensor position, and its zero lies {distance:.0f} m away; "
            "rays are taken to start at the world's (0, 0, 0), give the sensor's position"
        )
        return np.zeros(3), (note,)
    where = ", ".join(f"{value:g}" for value in np.round(zero, 3) + 0.0)
    return zero, (f"the file gives no sensor position; rays are taken to start at ({where}), give it if they did not",)


def _hint_at_frame(points: Float[np.ndarray, "N 3"], viewpoint: Float[np.ndarray, "4 4"]) -> tuple[str, ...]:
    """Return a note if a floor (a flat layer of points) appears only after applying the viewpoint."""
    if np.allclose(viewpoint, np.eye(4), atol=1e-6):
        return ()
    sample = points[np.isfinite(points).all(axis=1)][:: max(1, len(points) // 20_000)]
    if not len(sample):
        return ()
    if _measure_flatness(move_points(viewpoint, sample)[:, 2]) > 1.5 * _measure_flatness(sample[:, 2]):
        return ("looks sensor-framed: a floor shows only after the viewpoint is applied to the points; ask for that",)
    return ()


def _measure_flatness(heights: Float[np.ndarray, "N"]) -> float:
    """Return the share of points in the fullest horizontal layer of 4 cm."""
    layers = np.floor((heights - heights.min()) / 0.04)
    _, counts = np.unique(layers, return_counts=True)
    return float(counts.max() / len(heights))


def _drop_empty_rows(scan: Scan, name: str) -> Scan:
    """Set rows with too large coordinates to NaN, and drop rows of exactly 0 0 0, which drivers write for no return.

    A single such row is kept, since it may be a point; two exactly equal points do not occur in a scan.

    Raises:
        CloudError: all rows are 0 0 0, or nearly all have too large coordinates.
    """
    points = _blank_far_rows(scan.points)
    n_beyond = int((np.isfinite(scan.points).all(axis=1) & ~np.isfinite(points).all(axis=1)).sum())
    if n_beyond > MAX_INVALID_FRACTION * len(points):
        raise CloudError(
            f"{name}: {n_beyond} of {len(points)} points lie beyond {LARGEST_COORDINATE:g}; are x, y, z other columns, "
            "or its bytes in another order?"
        )
    scan = replace(
        scan,
        points=points,
        misses=_blank_far_rows(scan.misses),
        starts=None if scan.starts is None else _blank_far_rows(scan.starts),
        miss_starts=None if scan.miss_starts is None else _blank_far_rows(scan.miss_starts),
    )
    zero: Bool[np.ndarray, "N"] = (points == 0.0).all(axis=1)
    n_zero = int(zero.sum())
    if n_zero < 2:
        return scan
    if n_zero == len(points):
        raise CloudError(f"{name}: all {n_zero} points are 0 0 0; coordinates are needed")
    starts = scan.starts if scan.starts is None or scan.starts.ndim == 1 else scan.starts[~zero]
    note = f"dropped {n_zero} points of {len(points)} that are exactly 0 0 0, as drivers write where nothing came back"
    return replace(scan, points=points[~zero], starts=starts, notes=(*scan.notes, note))


def _blank_far_rows(rows: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    return np.where(np.abs(rows) <= LARGEST_COORDINATE, rows, np.nan)


def _note_rounding(points: Float[np.ndarray, "N 3"], metres: float) -> tuple[str, ...]:
    """Return a note if the coordinates are float32 and so large that rounding exceeds 1 mm.

    Args:
        points: coordinates in the file's unit.
        metres: length of the file's unit [m].
    """
    sample = points[:: max(1, len(points) // _SAMPLE)]
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample) or not np.array_equal(sample, sample.astype(np.float32)):
        return ()
    step = metres * float(np.spacing(np.abs(sample).max().astype(np.float32)))
    if step < _COARSE_M:
        return ()
    return (
        f"coordinates this far from zero are rounded to {step:.2g} m in float32, in which the file holds them; "
        "export it as double, or relative to a near place",
    )


def _parse_unit(unit: str) -> float:
    """Return the length of a unit [m].

    Raises:
        CloudError: the unit is unknown.
    """
    if unit not in METRES_BY_UNIT:
        raise CloudError(f"unit '{unit}' is unknown; one of {', '.join(METRES_BY_UNIT)} is needed")
    return METRES_BY_UNIT[unit]


def rigid_pose(transform: PoseInput) -> Float[np.ndarray, "4 4"]:
    """Return the (4, 4) rigid transform given by a matrix, angles or a quaternion.

    Args:
        transform: a 4x4 matrix (also as 16 numbers, row by row), or ``x y z yaw pitch roll`` [m, rad] (rotation about
            z, then the new y, then the new x), or ``x y z qw qx qy qz``.

    Raises:
        CloudError: the transform has another form, or is not finite or not rigid.
    """
    try:
        values = np.asarray(transform, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.size and not np.isfinite(values).all():
        raise CloudError("transform holds NaN or infinity; finite numbers are needed")
    if values.size not in (6, 7, 16):
        raise CloudError(
            f"transform of {values.size} numbers; a 4x4 matrix, x y z yaw pitch roll, or x y z qw qx qy qz is needed"
        )
    values = values.ravel()
    if np.abs(values).max() > LARGEST_COORDINATE:
        raise CloudError(f"transform holds {np.abs(values).max():g}; expected at most {LARGEST_COORDINATE:g} m")
    if values.size == 16:
        return _check_rigid(values.reshape(4, 4))
    if values.size == 7:
        return _make_viewpoint_pose(tuple(values.tolist()))
    largest = float(values[3:][np.argmax(np.abs(values[3:]))])
    if abs(largest) > _LARGEST_ANGLE:
        raise CloudError(
            f"transform turns by {largest:g} rad, more than once around; if these are degrees, "
            f"{np.radians(largest):.5g} rad is needed"
        )
    return _make_pose(Rotation.from_euler("ZYX", values[3:]), values[:3])


def _make_viewpoint_pose(viewpoint: Sequence[float]) -> Float[np.ndarray, "4 4"]:
    """Return the (4, 4) pose of ``x y z qw qx qy qz``; the quaternion may have any length except zero.

    Raises:
        CloudError: the quaternion is zero.
    """
    if np.linalg.norm(viewpoint[3:]) < 1e-6:
        raise CloudError("transform has the quaternion 0 0 0 0; one of length 1 is needed")
    return _make_pose(Rotation.from_quat(np.array(viewpoint[3:]), scalar_first=True), np.array(viewpoint[:3]))


def move_points(
    pose: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*N 3"], scale: float = 1.0
) -> Float[np.ndarray, "*N 3"]:
    """Return points (N, 3), or one point (3,), scaled by ``scale`` and transformed by the pose [m]."""
    if scale != 1.0:
        points = scale * points
    if np.array_equal(pose, np.eye(4)):
        return points
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _make_pose(rotation: Rotation, position: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = rotation.as_matrix()
    pose[:3, 3] = position
    return pose


def _check_rigid(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    rotation = pose[:3, :3]
    if not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
        raise CloudError(f"transform's last row is {pose[3].tolist()}; 0 0 0 1 is needed")
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > _RIGID_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise CloudError(
            "transform is not rigid (it scales, shears or mirrors); a rotation and a shift are needed, "
            "and a unit for another scale"
        )
    return pose
