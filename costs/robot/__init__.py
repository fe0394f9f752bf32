"""Robots: any URDF and SRDF, and the Atlas that ships with the package."""

from costs.robot.attach import AttachedBody, with_attached
from costs.robot.contact_patches import PATCH_DEFAULTS, PatchData, PatchKind, with_contacts
from costs.robot.errors import RobotError
from costs.robot.load import Root
from costs.robot.mechanism import Mechanism, MechanismJoint, Release, read_joint_axis, with_mechanism
from costs.robot.model import BASE_NAMES, LinkBody, RobotModel, RobotSource
from costs.robot.named import bundled_contacts, bundled_robots, load_robot
from costs.robot.still import StillShape, read_object_shapes

__all__ = [
    "BASE_NAMES",
    "PATCH_DEFAULTS",
    "AttachedBody",
    "LinkBody",
    "Mechanism",
    "MechanismJoint",
    "PatchData",
    "PatchKind",
    "Release",
    "RobotError",
    "RobotModel",
    "RobotSource",
    "Root",
    "StillShape",
    "bundled_contacts",
    "bundled_robots",
    "load_robot",
    "read_joint_axis",
    "read_object_shapes",
    "with_attached",
    "with_contacts",
    "with_mechanism",
]
