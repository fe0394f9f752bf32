"""Targets of the verifier that a request demands: its goal at the end of a motion, kept poses along all of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel, turn_near
from costs.rotation import quaternion_matrix
from costs.work_space import borrow_data
from service.demands.regions import SMALLEST_SHIFT, SMALLEST_TURN, find_axis, make_goal_region, make_kept_region
from service.request.keep import KeepRequest
from service.request.tasks.reach import GoalPartRequest, GoalRequest, PoseGoalRequest
from service.verify import AxisTarget, JointTarget, PoseTarget, RegionTarget, RelativePoseTarget

JOINT_TOLERANCE = 1e-3  # [rad, m]


GoalTarget = JointTarget | PoseTarget | AxisTarget | RegionTarget
"""A target at a path parameter ``at``."""


def find_goal_joints(
    robot: RobotModel, goal: GoalRequest | GoalPartRequest, near: Float[np.ndarray, "n"]
) -> Mapping[int, float]:
    """Return the goal's value by coordinate; a posture's base stays free, since the planted feet do not move.

    A joint without limits is at its goal after any number of turns; its value is the one nearest to ``near``. A value
    that rounding put beyond a limit is at the limit.
    """
    q = np.array(near, dtype=float)
    if goal.posture is None:
        columns = {name: k for k, name in enumerate(robot.joint_names)}
        wanted = {columns[name]: value for name, value in goal.joints.items() if name in columns}  # no followers
    else:
        posture = robot.postures[goal.posture]
        first = len(BASE_NAMES) if robot.is_floating else 0
        wanted = {index: float(posture[index]) for index in range(first, len(posture))}
    q[list(wanted)] = list(wanted.values())
    turned = turn_near(robot, q, near)
    inside = np.clip(turned, robot.lower, robot.upper)
    value = np.where(np.abs(inside - turned) <= JOINT_TOLERANCE, inside, turned)
    return {index: float(value[index]) for index in wanted}


def make_goal_targets(
    robot: RobotModel, goal: GoalRequest | GoalPartRequest, near: Float[np.ndarray, "n"]
) -> tuple[GoalTarget, ...]:
    """Return the targets of a phase's goal, whose path parameter the phase sets; joints by turns to ``near``."""
    return (
        *(
            JointTarget(robot.joint_names[i], value, JOINT_TOLERANCE, 0.0)
            for i, value in find_goal_joints(robot, goal, near).items()
        ),
        *(target for pose in goal.poses for target in _pose_targets(pose)),
    )


def make_pose_goal(
    frame: str,
    pose: Float[np.ndarray, "4 4"],
    tolerance_m: float,
    rotation_tolerance_deg: float,
    free_axis: str = "none",
) -> PoseGoalRequest:
    """Return the goal of a frame at a pose."""
    from scipy.spatial.transform import Rotation  # slow to import

    w, x, y, z = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True).tolist()
    at = pose[:3, 3].tolist()
    if free_axis == "all":
        return PoseGoalRequest(frame, (at[0], at[1], at[2]), None, tolerance_m)
    return PoseGoalRequest(
        frame,
        (at[0], at[1], at[2]),
        (w, x, y, z),
        tolerance_m,
        rotation_tolerance_deg,
        free_axis,  # type: ignore[arg-type]
    )


def make_goal_rotation(pose: PoseGoalRequest) -> Float[np.ndarray, "3 3"] | None:
    """Return the requested rotation_world_link; None where the orientation is free."""
    if pose.quaternion_wxyz is None:
        return None
    return quaternion_matrix(pose.quaternion_wxyz)


def _pose_targets(pose: PoseGoalRequest) -> tuple[PoseTarget | AxisTarget | RegionTarget, ...]:
    """Return a pose target, or a position and the direction of the free axis, or a region."""
    if not pose.is_plain:
        return (make_goal_region(pose),)
    rotation = make_goal_rotation(pose)
    turn = max(np.deg2rad(pose.rotation_tolerance_deg), SMALLEST_TURN)
    place = np.full(3, max(pose.position_tolerance_m, SMALLEST_SHIFT))
    position, axis = np.asarray(pose.origin, dtype=float), find_axis(pose.free_axis)
    if rotation is None or axis is None:
        return (PoseTarget(pose.link, position, rotation, place, np.full(3, turn)),)
    return (
        PoseTarget(pose.link, position, None, place, np.full(3, np.inf)),
        AxisTarget(pose.link, axis, rotation @ axis, turn),
    )


def make_kept_target(
    robot: RobotModel, start: Float[np.ndarray, "n"], keep: KeepRequest
) -> RelativePoseTarget | RegionTarget:
    """Return the target of one kept pose or region, relative to the configuration at the start."""
    pose = make_kept_pose(keep, _relative_pose(robot, start, keep.link, keep.relative_to))
    if not keep.is_plain:
        return make_kept_region(keep, pose)
    return RelativePoseTarget(
        keep.link,
        keep.relative_to,
        pose[:3, 3],
        pose[:3, :3],
        keep.position_tolerance_m,
        float(np.deg2rad(keep.rotation_tolerance_deg)),
        find_axis(keep.free_axis),
    )


def make_kept_pose(keep: KeepRequest, held: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the kept pose: the request's where it gives one, else ``held``, the one at the start."""
    wanted = held.copy()
    if keep.position is not None:
        wanted[:3, 3] = keep.position
    if keep.quaternion_wxyz is not None:
        wanted[:3, :3] = quaternion_matrix(keep.quaternion_wxyz)
    return wanted


def _relative_pose(
    robot: RobotModel, q: Float[np.ndarray, "n"], link: str, reference: str | None
) -> Float[np.ndarray, "4 4"]:
    """Return ``pose_reference_link`` at one configuration."""
    data = borrow_data(robot.model)
    pin.framesForwardKinematics(robot.model, data, q)
    pose = data.oMf[robot.model.getFrameId(link)]
    if reference is not None:
        pose = data.oMf[robot.model.getFrameId(reference)].actInv(pose)
    return np.array(pose.homogeneous)
