"""Start configuration of a request, and checks of joint names and limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES, RobotModel
from service.errors import RequestError, would_do
from service.request.schema import StartRequest

SNAP_TOLERANCE = 1e-3  # rounding of joint positions reported by a robot [rad, m]
STANDING_POSTURE = "stand"
LARGEST_PITCH_DEG = 85.0


def make_start_configuration(robot: RobotModel, start: StartRequest) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    """Return the start configuration, and notes about assumed and snapped joints.

    Raises:
        RequestError: an unknown posture or joint, or a joint beyond its limits by more than 1e-3.
    """
    q, notes = _posture(robot, start)
    positions = start.positions_by_joint
    problems = find_unknown_joints(robot, positions, "start.joints")
    if problems:
        raise RequestError(problems)
    for name, position in positions.items():
        q[robot.joint_names.index(name)] = position
    if start.base is not None:
        if not robot.is_floating:
            raise RequestError("start.base: this robot's base is fixed; leave it out, or give robot.root: floating")
        q[:3] = start.base.position
        q[3:6] = _yaw_pitch_roll(start.base.quaternion_wxyz)
    return _snap_to_limits(robot, q, notes)


def find_unknown_joints(robot: RobotModel, names: Mapping[str, float] | Sequence[str], field: str) -> list[str]:
    """Return one line per name that is not a joint of the robot."""
    joints = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    return [
        f"unknown joint {name!r} in {field}; {robot.name} has {would_do(name, joints)}"
        for name in names
        if name not in joints
    ]


def find_limit_violations(
    robot: RobotModel, positions: Mapping[str, float], field: str, tolerance: float = 0.0
) -> list[str]:
    """Return one line per joint position beyond its limits by more than ``tolerance``."""
    problems = []
    for name, position in positions.items():
        index = robot.joint_names.index(name)
        lower, upper = float(robot.lower[index]), float(robot.upper[index])
        if not lower - tolerance <= position <= upper + tolerance:
            problems.append(
                f"{field}.{name}: {position:.6g} is outside the joint's limits; expected {lower:.6g} to {upper:.6g}"
            )
    return problems


def _posture(robot: RobotModel, start: StartRequest) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    if start.posture is not None:
        if start.posture not in robot.postures:
            known = would_do(start.posture, robot.postures) or "no postures; give start.joints"
            raise RequestError(f"unknown posture {start.posture!r} in start.posture; {robot.name} has {known}")
        return robot.postures[start.posture].copy(), ()
    if STANDING_POSTURE in robot.postures:
        return robot.postures[STANDING_POSTURE].copy(), ()
    q = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    joints = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    n_assumed = len(set(joints).difference(start.positions_by_joint))
    if not n_assumed:
        return q, ()
    return q, (f"{n_assumed} joints without a start position start at 0 or at the nearest limit",)


def _yaw_pitch_roll(quaternion_wxyz: tuple[float, float, float, float]) -> Float[np.ndarray, "3"]:
    """Return the base's intrinsic z-y-x angles, which are not unique at a pitch of 90 degrees."""
    rotation = Rotation.from_quat(quaternion_wxyz, scalar_first=True)
    pitch_deg = math.degrees(math.asin(np.clip(-rotation.as_matrix()[2, 0], -1.0, 1.0)))
    if abs(pitch_deg) > LARGEST_PITCH_DEG:
        raise RequestError(
            f"start.base.quaternion_wxyz: a pitch of {pitch_deg:.0f} deg is too near to 90; "
            f"expected at most {LARGEST_PITCH_DEG:.0f}"
        )
    return np.asarray(rotation.as_euler("ZYX"))


def _snap_to_limits(
    robot: RobotModel, q: Float[np.ndarray, "n"], notes: tuple[str, ...]
) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    problems = find_limit_violations(
        robot, dict(zip(robot.joint_names, q, strict=True)), "start.joints", SNAP_TOLERANCE
    )
    if problems:
        raise RequestError(problems)
    inside = np.clip(q, robot.lower, robot.upper)
    for index in np.flatnonzero(inside != q):
        notes += (f"start: {robot.joint_names[index]} snapped from {q[index]:.6g} to its limit {inside[index]:.6g}",)
    return inside, notes
