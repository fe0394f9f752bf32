"""Robots: any URDF and SRDF, and the Atlas that ships with the package."""

from costs.robot.attach import AttachedBody, with_attached
from costs.robot.errors import RobotError
from costs.robot.load import Root
from costs.robot.mechanism import Mechanism, MechanismJoint, Release, read_joint_axis, with_mechanism
from costs.robot.model import BASE_NAMES, LinkBody, RobotModel, RobotSource
from costs.robot.named import bundled_robots, load_robot
from costs.robot.still import StillShape, read_object_shapes

__all__ = [
    "BASE_NAMES",
    "AttachedBody",
    "LinkBody",
    "Mechanism",
    "MechanismJoint",
    "Release",
    "RobotError",
    "RobotModel",
    "RobotSource",
    "Root",
    "StillShape",
    "bundled_robots",
    "load_robot",
    "read_joint_axis",
    "read_object_shapes",
    "with_attached",
    "with_mechanism",
]
