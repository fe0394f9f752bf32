"""What a request's goal demands of the end of a motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES, RobotModel
from service.request.schema import GoalRequest, PoseGoalRequest
from service.verify import AxisTarget, JointTarget, PoseTarget, Target

JOINT_TOLERANCE = 1e-3  # [rad, m]
SMALLEST_SHIFT, SMALLEST_TURN = 1e-4, 1e-3  # tolerances below these are beyond the optimiser's [m, rad]
AXES = {"x": 0, "y": 1, "z": 2}


def goal_joints(robot: RobotModel, goal: GoalRequest) -> Mapping[int, float]:
    """Value by coordinate; a posture's base stays free, since the feet stand where they stand."""
    if goal.posture is None:
        return {robot.joint_names.index(name): value for name, value in goal.joints.items()}
    posture = robot.postures[goal.posture]
    first = len(BASE_NAMES) if robot.is_floating else 0
    return {index: float(posture[index]) for index in range(first, len(posture))}


def goal_targets(robot: RobotModel, goal: GoalRequest, at: float) -> tuple[Target, ...]:
    """Targets of the verifier at path parameter ``at``, where the motion must do what the goal says."""
    return (
        *(
            JointTarget(robot.joint_names[i], value, JOINT_TOLERANCE, at)
            for i, value in goal_joints(robot, goal).items()
        ),
        *(target for pose in goal.poses for target in _pose_targets(pose, at)),
    )


def rotation_of(pose: PoseGoalRequest) -> Float[np.ndarray, "3 3"] | None:
    """Requested rotation_world_link; None where the orientation is free."""
    if pose.quaternion_wxyz is None:
        return None
    return np.asarray(Rotation.from_quat(pose.quaternion_wxyz, scalar_first=True).as_matrix())


def _pose_targets(pose: PoseGoalRequest, at: float) -> tuple[Target, ...]:
    """A pose, or a place and the direction of the axis that is not free."""
    rotation = rotation_of(pose)
    turn = max(np.deg2rad(pose.rotation_tolerance_deg), SMALLEST_TURN)
    place = np.full(3, max(pose.position_tolerance_m, SMALLEST_SHIFT))
    position = np.asarray(pose.position, dtype=float)
    if rotation is None or pose.free_axis == "none":
        return (PoseTarget(pose.link, position, rotation, place, np.full(3, turn), at),)
    axis = np.eye(3)[AXES[pose.free_axis]]
    return (
        PoseTarget(pose.link, position, None, place, np.full(3, np.inf), at),
        AxisTarget(pose.link, axis, rotation @ axis, turn, at),
    )
