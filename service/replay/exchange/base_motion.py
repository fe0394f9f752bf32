"""The base in messages of ROS: ``MultiDOFJointTrajectory`` and ``MultiDOFJointState`` as poses and rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from service.errors import RequestError, shown
from service.replay.exchange.fields import TakenFields, note_rest, read_stamps, to_coordinate

WORLDS = ("", "world", "map", "/world", "/map")
SAME_TIME_S = 1e-6
STILL = 1e-9  # of poses that do not move [m, and in quaternions]


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base.

    Attributes:
        name: of the joint that moves it.
        times: (K,) [s], or None.
        poses: (K, 7) position and quaternion (w, x, y, z) in the world.
        rates: (K, 6) of base_x, base_y, base_z, base_yaw, base_pitch, base_roll; None where they are not known.
        notes: assumptions.
    """

    name: str
    times: Float[np.ndarray, "K"] | None
    poses: Float[np.ndarray, "K 7"]
    rates: Float[np.ndarray, "K 6"] | None
    notes: tuple[str, ...]

    @property
    def is_still(self) -> bool:
        """Whether the base stays where it is."""
        return bool(np.all(np.abs(self.poses - self.poses[0]) <= STILL))


def read_base_motion(body: object, source: str) -> BaseMotion | None:
    """Read a ``MultiDOFJointTrajectory``; None where it has no points.

    Poses are those of the base in the world.  Twists have the world's axes: the velocity of the base's origin, and its
    angular velocity; twists that are all zero while the base moves are those of planners that fill in none.

    Raises:
        RequestError: it moves several joints, or its points are malformed.
    """
    if not isinstance(body, Mapping):
        if body is None:
            return None
        raise RequestError(f"{source}: multi_dof_joint_trajectory must be a mapping, got {shown(body)}")
    fields = TakenFields(body)
    points, header = fields.take("points"), fields.take("header")
    if points is None:
        return None
    name = _read_name(fields.take("joint_names"), source)
    if not isinstance(points, list | tuple) or not all(isinstance(point, Mapping) for point in points):
        raise RequestError(f"{source}: points of multi_dof_joint_trajectory must be a list of mappings")
    rows = [TakenFields(point) for point in points]
    poses = np.array([_read_only(row.take("transforms"), k, source) for k, row in enumerate(rows)])
    times = read_stamps([row.take("time_from_start") for row in rows], f"{source}: multi_dof_joint_trajectory")
    times = times if times is not None and np.any(times) else None
    twists = [row.take("velocities") for row in rows]
    rest = [f"multi_dof_joint_trajectory.points[].{key}" for row in rows for key in row.list_rest()]
    rest += [f"multi_dof_joint_trajectory.{key}" for key in fields.list_rest()]
    rates = _read_rates(twists, poses, source)
    notes = (*_note_frame(header, name), *note_rest(rest))
    motion = BaseMotion(name, times, poses, rates, notes)
    return BaseMotion(name, times, poses, np.zeros((len(poses), 6)), notes) if motion.is_still else motion


def read_base_pose(body: object, source: str) -> tuple[str, Float[np.ndarray, "7"]] | None:
    """Read a ``MultiDOFJointState``: the joint and its pose; None where it has none."""
    if not isinstance(body, Mapping):
        return None
    fields = TakenFields(body)
    transforms = fields.take("transforms")
    if transforms is None:
        return None
    pose = np.array(_read_only(transforms, 0, source))
    if not np.any(pose[3:]):
        raise RequestError(f"{source}: the base's quaternion is 0; expected one of length 1")
    return _read_name(fields.take("joint_names"), source), pose


def compute_angles(quaternions: Float[np.ndarray, "K 4"]) -> Float[np.ndarray, "K 3"]:
    """Return yaw, pitch and roll of quaternions (w, x, y, z) that are not 0."""
    turns = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    pitch = np.arcsin(np.clip(-turns[:, 2, 0], -1.0, 1.0))
    return np.column_stack(
        [np.arctan2(turns[:, 1, 0], turns[:, 0, 0]), pitch, np.arctan2(turns[:, 2, 1], turns[:, 2, 2])]
    )


def check_times(motion: BaseMotion, count: int, times: Float[np.ndarray, "K"] | None, source: str) -> None:
    """Check that base and joints have as many points, at the same times.

    Raises:
        RequestError: they have not; the message says where.
    """
    if len(motion.poses) != count:
        raise RequestError(
            f"{source}: multi_dof_joint_trajectory has {len(motion.poses)} points, joint_trajectory {count}; "
            "expected the same"
        )
    own, other = (np.zeros(count) if values is None else values for values in (motion.times, times))
    off = np.abs(own - other)
    if np.any(off > SAME_TIME_S):
        row = int(np.argmax(off > SAME_TIME_S))
        raise RequestError(
            f"{source}: point {row} of multi_dof_joint_trajectory is at {own[row]:g} s, of joint_trajectory at "
            f"{other[row]:g} s; expected the same times"
        )


def _read_name(names: object, source: str) -> str:
    if not isinstance(names, list | tuple) or not names:
        raise RequestError(f"{source}: multi_dof_joint_trajectory names no joint; joint_names is needed")
    if len(names) > 1:
        listed = ", ".join(shown(name) for name in names[:5])
        raise RequestError(
            f"{source}: moves {len(names)} joints by multi_dof_joint_trajectory ({listed}); expected one"
        )
    return str(names[0])


def _read_only(entries: object, row: int, source: str) -> list[float]:
    """Return position and quaternion of the only transform of a point."""
    if not isinstance(entries, list | tuple) or len(entries) != 1 or not isinstance(entries[0], Mapping):
        count = len(entries) if isinstance(entries, list | tuple) else 0
        raise RequestError(f"{source}: point {row} has {count} transforms; expected one, that of the base")
    translation, rotation = entries[0].get("translation"), entries[0].get("rotation")
    return [
        *_read_axes(translation, ("x", "y", "z"), f"translation of point {row}", source),
        *_read_axes(rotation, ("w", "x", "y", "z"), f"rotation of point {row}", source),
    ]


def _read_axes(value: object, axes: Sequence[str], field: str, source: str) -> list[float]:
    if not isinstance(value, Mapping) or not set(axes) <= set(value):
        raise RequestError(f"{source}: {field} is {shown(value)}; expected {', '.join(axes)}")
    return [to_coordinate(value[axis], field, source) for axis in axes]


def _read_rates(twists: list[Any], poses: Float[np.ndarray, "K 7"], source: str) -> Float[np.ndarray, "K 6"] | None:
    """Return rates of position and z-y-x angles from twists; None where there are none, or only zeros."""
    if all(twist is None for twist in twists):
        return None
    values = np.zeros((len(twists), 6))
    for row, entries in enumerate(twists):
        if not isinstance(entries, list | tuple) or len(entries) != 1 or not isinstance(entries[0], Mapping):
            raise RequestError(f"{source}: point {row} of multi_dof_joint_trajectory has no velocity, others have one")
        for k, part in enumerate(("linear", "angular")):
            field = f"{part} velocity of point {row}"
            values[row, 3 * k : 3 * k + 3] = _read_axes(entries[0].get(part), ("x", "y", "z"), field, source)
    if not np.any(values):
        return None
    if not np.all(np.linalg.norm(poses[:, 3:], axis=1) > 0.0):
        return values  # that these are no rotations is for the reader of the poses to say
    yaw, pitch, _ = compute_angles(poses[:, 3:]).T
    x, y, z = values[:, 3:].T
    along = x * np.cos(yaw) + y * np.sin(yaw)
    cosine = np.where(np.abs(np.cos(pitch)) > 1e-6, np.cos(pitch), 1e-6)
    rolls, pitches = along / cosine, y * np.cos(yaw) - x * np.sin(yaw)
    return np.column_stack([values[:, :3], z + rolls * np.sin(pitch), pitches, rolls])


def _note_frame(header: object, name: str) -> list[str]:
    frame = header.get("frame_id", "") if isinstance(header, Mapping) else ""
    if frame in WORLDS:
        return []
    return [f"poses of {shown(name)} are read in the request's world; their frame_id is {shown(frame)}"]
