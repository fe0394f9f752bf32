"""A wheel on the optimiser's side: the body that turns it, the wrist, and what the tool's way round it comes to."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, locate_frame
from costs.robot import RobotModel
from costs.rotation import make_tangent_basis
from service.body.whole_body import WholeBody
from service.demands.wheel import HAND_AXIS, Hand, Wheel, add_wheel_joint


def wrist_of(hand: Hand, robot: RobotModel) -> tuple[int, float]:
    """The coordinate that turns a hand about its axis, and its sense about the tool's z axis."""
    joint, pose_joint_tool = locate_frame(robot, hand.tool)
    column = int(robot.model.joints[joint].idx_v)
    kinematics = KinematicsEngine(robot)(np.zeros((1, robot.n)))
    turns = kinematics.jacobian[0, 3:, column]
    axis = kinematics.rotation[0, joint] @ pose_joint_tool[:3, :3] @ HAND_AXIS
    return column, float(np.sign(turns @ axis))


def add_wheel(body: WholeBody, wheel: Wheel) -> WholeBody:
    """The body of a robot whose last coordinate is the wheel's angle."""
    return body.with_robot(add_wheel_joint(body.robot, wheel), np.append(body.nominal, 0.0))


def tool_positions(robot: RobotModel, tool: str, q: Float[np.ndarray, "S n"]) -> Float[np.ndarray, "S 3"]:
    """World positions of a frame at separate configurations [m]."""
    joint, pose_joint_tool = locate_frame(robot, tool)
    kinematics = KinematicsEngine(robot)(q)
    return np.asarray(kinematics.rotation[:, joint] @ pose_joint_tool[:3, 3] + kinematics.position[:, joint])


def turned_angle(
    points: Float[np.ndarray, "S 3"], centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> float:
    """Angle by which a point has gone round an axis from the first sample to the last, unwrapped [rad]."""
    first, second = make_tangent_basis(np.asarray(axis))
    offset = points - centre
    angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
    return float(angle[-1] - angle[0])
