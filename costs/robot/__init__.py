"""Robots: any URDF and SRDF, and the Atlas that ships with the package."""

from costs.robot.attach import AttachedBody, with_attached
from costs.robot.circles import WHOLE_TURN, list_circular, turn_near
from costs.robot.contact_patches import PATCH_DEFAULTS, PatchData, PatchKind, with_contacts
from costs.robot.elements.inertia import LinkInertia, spread_mass
from costs.robot.errors import RobotError
from costs.robot.load import Root
from costs.robot.mechanism import (
    Mechanism,
    MechanismJoint,
    Release,
    make_mechanism_model,
    read_joint_axis,
    with_mechanism,
)
from costs.robot.mechanism_urdf import (
    STOP_ROUNDING,
    LinkPlace,
    UrdfMechanism,
    check_limits,
    read_mechanism,
    read_mesh_hulls,
)
from costs.robot.mesh import Mesh as Triangles
from costs.robot.mesh import find_package_folders
from costs.robot.mesh import read_mesh as read_triangles
from costs.robot.mesh.split import LinkSplit
from costs.robot.mesh.surface import LinkSurface, read_surface
from costs.robot.mesh.visual import VisualMesh
from costs.robot.model import BASE_NAMES, PLANAR_NAMES, LinkBody, RobotHand, RobotModel, RobotSource
from costs.robot.named import bundled_contacts, bundled_robots, load_robot, read_followers, read_robot_visuals
from costs.robot.srdf import format_srdf
from costs.robot.still import StillShape, read_object_shapes

__all__ = [
    "BASE_NAMES",
    "PATCH_DEFAULTS",
    "PLANAR_NAMES",
    "STOP_ROUNDING",
    "WHOLE_TURN",
    "AttachedBody",
    "LinkBody",
    "LinkInertia",
    "LinkPlace",
    "LinkSplit",
    "LinkSurface",
    "Mechanism",
    "MechanismJoint",
    "PatchData",
    "PatchKind",
    "Release",
    "RobotError",
    "RobotHand",
    "RobotModel",
    "RobotSource",
    "Root",
    "StillShape",
    "Triangles",
    "UrdfMechanism",
    "VisualMesh",
    "bundled_contacts",
    "bundled_robots",
    "check_limits",
    "find_package_folders",
    "format_srdf",
    "list_circular",
    "load_robot",
    "make_mechanism_model",
    "read_followers",
    "read_joint_axis",
    "read_mechanism",
    "read_mesh_hulls",
    "read_object_shapes",
    "read_robot_visuals",
    "read_surface",
    "read_triangles",
    "spread_mass",
    "turn_near",
    "with_attached",
    "with_contacts",
    "with_mechanism",
]
