"""The wheel that is turned, and the hands that turn it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, frame_of
from costs.robot import RobotModel, with_revolute
from costs.rotation import tangent_basis
from service.names import VALVE_JOINT, VALVE_LINK
from service.whole_body import WholeBody

WHEEL_SPEED = 1.0  # [rad/s]
WHEEL_ACCELERATION = 2.0  # [rad/s^2]
HAND_AXIS = np.array([0.0, 0.0, 1.0])  # in the tool frame


@dataclass(frozen=True)
class Wheel:
    """The wheel to turn.

    Attributes:
        centre: (3,) of the rim's centre-line circle, in the world [m].
        axis: (3,) unit, towards the robot.
        radius: of the centre line [m].
        tube_radius: half the rim's thickness [m].
        start_direction: (3,) unit, perpendicular to the axis, where the angle about it is zero.
        gaps: angles at which there is no spoke, best first [rad].
        bodies: vertices in the world by body name.
        rim: names of the bodies that are the rim, which may be touched.
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    tube_radius: float
    start_direction: Float[np.ndarray, "3"]
    gaps: tuple[float, ...]
    bodies: Mapping[str, Float[np.ndarray, "V 3"]]
    rim: tuple[str, ...]

    def rim_point(self, angle: float) -> Float[np.ndarray, "3"]:
        """Point of the centre line at an angle, in the world [m]."""
        third = np.cross(self.axis, self.start_direction)
        return np.asarray(self.centre + self.radius * (np.cos(angle) * self.start_direction + np.sin(angle) * third))


@dataclass(frozen=True)
class Hand:
    """A hand with its hook.

    Attributes:
        side: ``left`` or ``right``.
        tool: frame at the hook's end, z along the hand axis outwards.
        hook: link that may touch the rim.
    """

    side: str
    tool: str
    hook: str

    def wrist(self, robot: RobotModel) -> tuple[int, float]:
        """The coordinate that turns the hand about its axis, and its sense about the tool's z axis."""
        joint, pose_joint_tool = frame_of(robot, self.tool)
        column = int(robot.model.joints[joint].idx_v)
        kinematics = KinematicsEngine(robot)(np.zeros((1, robot.n)))
        turns = kinematics.jacobian[0, 3:, column]
        axis = kinematics.rotation[0, joint] @ pose_joint_tool[:3, :3] @ HAND_AXIS
        return column, float(np.sign(turns @ axis))


HANDS = {"left": Hand("left", "l_tool", "l_hook"), "right": Hand("right", "r_tool", "r_hook")}


def with_wheel(body: WholeBody, wheel: Wheel) -> WholeBody:
    """The body of a robot whose last coordinate is the wheel's angle."""
    robot = with_revolute(
        body.robot,
        name=VALVE_JOINT,
        origin=wheel.centre,
        axis=wheel.axis,
        bodies=wheel.bodies,
        link=VALVE_LINK,
        lower=-2.5 * np.pi,
        upper=2.5 * np.pi,
        velocity=WHEEL_SPEED,
        acceleration=WHEEL_ACCELERATION,
    )
    return body.with_robot(robot, np.append(body.nominal, 0.0))


def tool_positions(robot: RobotModel, tool: str, q: Float[np.ndarray, "S n"]) -> Float[np.ndarray, "S 3"]:
    """World positions of a frame at separate configurations [m]."""
    joint, pose_joint_tool = frame_of(robot, tool)
    kinematics = KinematicsEngine(robot)(q)
    return np.asarray(kinematics.rotation[:, joint] @ pose_joint_tool[:3, 3] + kinematics.position[:, joint])


def turned_angle(
    points: Float[np.ndarray, "S 3"], centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> float:
    """Angle by which a point has gone round an axis from the first sample to the last, unwrapped [rad]."""
    first, second = tangent_basis(np.asarray(axis))
    offset = points - centre
    angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
    return float(angle[-1] - angle[0])
