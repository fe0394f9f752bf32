"""Units and poses: a file's numbers to metres in the frame that is asked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.errors import CloudError
from perception.limits import LARGEST_COORDINATE

METRES_BY_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}
_RIGID_TOLERANCE = 1e-4
_LARGEST_ANGLE = 2.0 * np.pi + 1e-3

Pose = Float[np.ndarray, "4 4"] | Sequence[float] | Sequence[Sequence[float]]


def metres_per(unit: str) -> float:
    """Length of one ``unit`` [m].

    Raises:
        CloudError: the unit is unknown.
    """
    if unit not in METRES_BY_UNIT:
        raise CloudError(f"unit '{unit}' is unknown; one of {', '.join(METRES_BY_UNIT)} is needed")
    return METRES_BY_UNIT[unit]


def rigid_pose(transform: Pose) -> Float[np.ndarray, "4 4"]:
    """A rigid transform from what people give.

    Args:
        transform: a 4x4 matrix (also as 16 numbers, row by row), or ``x y z yaw pitch roll`` [m, rad] (rotation about
            z, then the new y, then the new x), or ``x y z qw qx qy qz``.

    Raises:
        CloudError: it is none of these, not finite or not rigid.
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
        raise CloudError(f"transform holds {np.abs(values).max():g}; at most {LARGEST_COORDINATE:g} m would do")
    if values.size == 16:
        return _checked(values.reshape(4, 4))
    if values.size == 7:
        return pose_of_viewpoint(tuple(values.tolist()))
    largest = float(values[3:][np.argmax(np.abs(values[3:]))])
    if abs(largest) > _LARGEST_ANGLE:
        raise CloudError(
            f"transform turns by {largest:g} rad, more than once around; if these are degrees, "
            f"{np.radians(largest):.5g} rad is needed"
        )
    return _pose(Rotation.from_euler("ZYX", values[3:]), values[:3])


def pose_of_viewpoint(viewpoint: Sequence[float]) -> Float[np.ndarray, "4 4"]:
    """``x y z qw qx qy qz`` as a matrix; the quaternion may have any length but zero.

    Raises:
        CloudError: the quaternion is zero.
    """
    if np.linalg.norm(viewpoint[3:]) < 1e-6:
        raise CloudError("transform has the quaternion 0 0 0 0; one of length 1 is needed")
    return _pose(Rotation.from_quat(np.array(viewpoint[3:]), scalar_first=True), np.array(viewpoint[:3]))


def moved(
    pose: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*N 3"], scale: float = 1.0
) -> Float[np.ndarray, "*N 3"]:
    """Points (N, 3), or one (3,), in units of ``scale`` metres, taken along by a pose [m]."""
    if scale != 1.0:
        points = scale * points
    if np.array_equal(pose, np.eye(4)):
        return points
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _pose(rotation: Rotation, position: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = rotation.as_matrix()
    pose[:3, 3] = position
    return pose


def _checked(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
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
