"""Figures of Atlas v5: kinematics, limits, masses and inertias.

Source: atlas_v5.urdf of osrf/drcsim (commit 020259c1), head from its multisense_sl_v4.urdf; Apache License 2.0
(package.xml). Only figures are taken over, no shapes. The soles are those of the robot's ``meshes_unplugged`` feet.
"""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, float, float]


class JointFigures(NamedTuple):
    """A revolute joint: origin in its parent link [m], fixed-axis roll-pitch-yaw [rad], axis; limits and friction."""

    name: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    lower: float
    upper: float
    velocity: float
    effort: float
    damping: float
    friction: float


class FixedFigures(NamedTuple):
    """A fixed joint."""

    name: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector


class LinkFigures(NamedTuple):
    """A link's mass [kg], centre of mass [m] and inertia about it (ixx ixy ixz iyy iyz izz) [kg m^2]."""

    name: str
    mass: float
    com: Vector
    inertia: tuple[float, float, float, float, float, float]


def _mirror_name(name: str) -> str:
    return f"r_{name[2:]}" if name.startswith("l_") else name


def _mirror_joint(joint: JointFigures) -> JointFigures:
    """Mirror a joint of the left side: joints about x and z turn the other way."""
    name, parent, child = map(_mirror_name, joint[:3])
    x, y, z = joint.xyz
    mirrored = joint._replace(name=name, parent=parent, child=child, xyz=(x, -y or 0.0, z))
    return mirrored if joint.axis[1] else mirrored._replace(lower=-joint.upper or 0.0, upper=-joint.lower or 0.0)


def _mirror_link(link: LinkFigures) -> LinkFigures:
    """Mirror a link of the left side."""
    (x, y, z), (ixx, ixy, ixz, iyy, iyz, izz) = link.com, link.inertia
    zero = -0.0 if link.name == "l_lleg" else 0.0  # as in the source: the text of the URDF is hashed
    inertia = (ixx, -ixy or zero, ixz, iyy, -iyz or zero, izz)
    return LinkFigures(_mirror_name(link.name), link.mass, (x, -y or 0.0, z), inertia)


# fmt: off
_CENTRE_JOINTS = (
    JointFigures("back_bkx", "mtorso", "utorso", (0.0, 0.0, 0.05), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0),
                 -0.523599, 0.523599, 12.0, 300.0, 0.1, 0.0),
    JointFigures("back_bky", "ltorso", "mtorso", (0.0, 0.0, 0.162), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 -0.219388, 0.538783, 9.0, 445.0, 0.1, 0.0),
    JointFigures("back_bkz", "pelvis", "ltorso", (-0.0125, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
                 -0.663225, 0.663225, 12.0, 106.0, 0.1, 0.0),
    JointFigures("neck_ry", "utorso", "head", (0.2546, 0.0, 0.6215), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 -0.602139, 1.14319, 6.28, 25.0, 0.1, 0.0),
)
_LEFT_JOINTS = (
    JointFigures("l_arm_elx", "l_uarm", "l_larm", (0.0, 0.119, 0.0092), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0),
                 0.0, 2.35619, 12.0, 112.0, 0.1, 0.0),
    JointFigures("l_arm_ely", "l_scap", "l_uarm", (0.0, 0.187, -0.016), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 0.0, 3.14159, 12.0, 63.0, 0.1, 0.0),
    JointFigures("l_arm_shx", "l_clav", "l_scap", (0.0, 0.11, -0.245), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0),
                 -1.5708, 1.5708, 12.0, 99.0, 0.1, 0.0),
    JointFigures("l_arm_shz", "utorso", "l_clav", (0.1406, 0.2256, 0.4776), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
                 -1.5708, 0.785398, 12.0, 87.0, 0.1, 0.0),
    JointFigures("l_arm_wrx", "l_ufarm", "l_lfarm", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0),
                 -1.7628, 1.7628, 10.0, 25.0, 0.1, 0.0),
    JointFigures("l_arm_wry", "l_larm", "l_ufarm", (0.0, 0.29955, -0.00921), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 -3.011, 3.011, 10.0, 25.0, 0.1, 0.0),
    JointFigures("l_arm_wry2", "l_lfarm", "l_hand", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 -2.9671, 2.9671, 10.0, 25.0, 0.1, 0.0),
    JointFigures("l_leg_akx", "l_talus", "l_foot", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0),
                 -0.8, 0.8, 12.0, 360.0, 0.1, 0.0),
    JointFigures("l_leg_aky", "l_lleg", "l_talus", (0.0, 0.0, -0.422), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 -1.0, 0.7, 12.0, 740.0, 0.1, 0.0),
    JointFigures("l_leg_hpx", "l_uglut", "l_lglut", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0),
                 -0.523599, 0.523599, 12.0, 530.0, 0.1, 0.0),
    JointFigures("l_leg_hpy", "l_lglut", "l_uleg", (0.05, 0.0225, -0.066), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 -1.61234, 0.65764, 12.0, 840.0, 0.1, 0.0),
    JointFigures("l_leg_hpz", "pelvis", "l_uglut", (0.0, 0.089, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
                 -0.174358, 0.786794, 12.0, 275.0, 0.1, 0.0),
    JointFigures("l_leg_kny", "l_uleg", "l_lleg", (-0.05, 0.0, -0.374), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0),
                 0.0, 2.35637, 12.0, 890.0, 0.1, 0.0),
)
_RIGHT_JOINTS = (_mirror_joint(joint) for joint in _LEFT_JOINTS)
JOINTS = tuple(sorted((*_CENTRE_JOINTS, *_LEFT_JOINTS, *_RIGHT_JOINTS), key=lambda joint: joint.name))

# The spinning lidar of the head ("hokuyo_joint") is continuous on the robot; its angle is none of a plan's business.
FIXED_JOINTS = (
    FixedFigures("r_situational_awareness_camera_joint", "utorso", "r_situational_awareness_camera_link",
                 (0.216409, -0.121799, 0.406759), (1.57079633, 0.0, -1.30899694)),
    FixedFigures("r_situational_awareness_camera_optical_frame_joint",
                 "r_situational_awareness_camera_link", "r_situational_awareness_camera_optical_frame",
                 (0.0, 0.0, 0.0), (-1.5708, 0.0, -1.5708)),
    FixedFigures("l_situational_awareness_camera_joint", "utorso", "l_situational_awareness_camera_link",
                 (0.216409, 0.121799, 0.406759), (-1.57079633, 0.0, 1.30899694)),
    FixedFigures("l_situational_awareness_camera_optical_frame_joint",
                 "l_situational_awareness_camera_link", "l_situational_awareness_camera_optical_frame",
                 (0.0, 0.0, 0.0), (-1.5708, 0.0, -1.5708)),
    FixedFigures("rear_situational_awareness_camera_joint", "utorso", "rear_situational_awareness_camera_link",
                 (-0.0026, 0.0264, 0.6649), (0.0, 0.0, 3.14159)),
    FixedFigures("rear_situational_awareness_camera_optical_frame_joint",
                 "rear_situational_awareness_camera_link", "rear_situational_awareness_camera_optical_frame",
                 (0.0, 0.0, 0.0), (-1.5708, 0.0, -1.5708)),
    FixedFigures("hokuyo_joint", "head", "hokuyo_link",
                 (-0.0446, 0.0, 0.088), (0.0, 0.0, 0.0)),
)

_LEFT_LINKS = (
    LinkFigures("l_clav", 3.45, (0.0, 0.048, -0.084),
                (0.011, 0.0, 0.0, 0.009, -0.004, 0.004)),
    LinkFigures("l_foot", 2.05, (0.027, 0.0, -0.067),
                (0.002, 0.0, 0.0, 0.007, 0.0, 0.008)),
    LinkFigures("l_hand", 0.53, (0.0, 0.06, 0.0),
                (0.00265, 0.0, 0.0, 0.00446, 0.0, 0.00446)),
    LinkFigures("l_larm", 2.509, (0.0, 0.0, 0.0),
                (0.00265, 0.0, 0.0, 0.00446, 0.0, 0.00446)),
    LinkFigures("l_lfarm", 2.65, (0.0, -0.07, 0.0),
                (0.007, 0.0, 0.0, 0.004, 0.0, 0.007)),
    LinkFigures("l_lglut", 0.866, (0.0133341, 0.0170484, -0.0312052),
                (0.000691326, -2.24344e-05, 2.50508e-06, 0.00126856, 0.000137862, 0.00106487)),
    LinkFigures("l_lleg", 5.479, (0.001, 0.0, -0.187),
                (0.077, 0.0, -0.003, 0.076, 0.0, 0.01)),
    LinkFigures("l_scap", 3.012, (0.0, 0.0, 0.0),
                (0.00319, 0.0, 0.0, 0.00583, 0.0, 0.00583)),
    LinkFigures("l_talus", 0.125, (0.0, 0.0, 0.0),
                (1.01674e-05, 0.0, 0.0, 8.42775e-06, 0.0, 1.30101e-05)),
    LinkFigures("l_uarm", 3.388, (0.0, -0.065, 0.0),
                (0.00656, 0.0, 0.0, 0.00358, 0.0, 0.00656)),
    LinkFigures("l_ufarm", 2.12, (0.0, -0.2, 0.0),
                (0.006, 0.0, 0.0, 0.003, 0.0, 0.006)),
    LinkFigures("l_uglut", 0.648, (0.00529262, -0.00344732, 0.00313046),
                (0.00074276, -3.79607e-08, -2.79549e-05, 0.000688179, -3.2735e-08, 0.00041242)),
    LinkFigures("l_uleg", 9.209, (0.0, 0.0, -0.21),
                (0.09, 0.0, 0.0, 0.09, 0.0, 0.02)),
)
LINKS = (
    *_LEFT_LINKS,
    LinkFigures("ltorso", 2.409, (-0.0112984, -3.15366e-06, 0.0746835),
                (0.0039092, -5.04491e-08, -0.000342157, 0.00341694, 4.87119e-07, 0.00174492)),
    LinkFigures("mtorso", 0.69, (-0.00816266, -0.0131245, 0.0305974),
                (0.000454181, -6.10764e-05, 3.94009e-05, 0.000483282, 5.27463e-05, 0.000444215)),
    LinkFigures("pelvis", 17.882, (0.0111, 0.0, 0.0271),
                (0.1244, 0.0008, -0.0007, 0.0958, -0.0005, 0.1167)),
    *(_mirror_link(link) for link in _LEFT_LINKS),
    LinkFigures("utorso", 63.73, (-0.0581, 0.0, 0.3056),
                (1.466, 0.00362, 0.336, 1.51, 0.001, 1.3)),
    LinkFigures("r_situational_awareness_camera_link", 0.1, (0.0, 0.0, 0.0),
                (1e-05, 0.0, 0.0, 1e-05, 0.0, 1e-05)),
    LinkFigures("l_situational_awareness_camera_link", 0.1, (0.0, 0.0, 0.0),
                (1e-05, 0.0, 0.0, 1e-05, 0.0, 1e-05)),
    LinkFigures("rear_situational_awareness_camera_link", 0.1, (0.0, 0.0, 0.0),
                (1e-05, 0.0, 0.0, 1e-05, 0.0, 1e-05)),
    LinkFigures("head", 1.41984, (-0.075493, 3.3383e-05, 0.02774),
                (0.0039688, -1.5797e-06, -0.00089293, 0.0041178, -6.8415e-07, 0.0035243)),
    LinkFigures("hokuyo_link", 0.057654, (0.032428, 0.0004084, -0.0041835),
                (3.7174e-05, 4.9927e-08, 1.1015e-05, 4.2412e-05, -9.8165e-09, 4.167e-05)),
)

MASSLESS_LINKS = (
    "r_situational_awareness_camera_optical_frame",
    "l_situational_awareness_camera_optical_frame",
    "rear_situational_awareness_camera_optical_frame",
)

# Corners of the sole in the foot link's frame [m].
SOLES = {
    "l_foot": ((0.17279, 0.06609, -0.07645),
               (0.17279, -0.0626, -0.07645),
               (-0.0877, 0.06609, -0.07645),
               (-0.0877, -0.0626, -0.07645)),
    "r_foot": ((0.17279, 0.0626, -0.07645),
               (0.17279, -0.06609, -0.07645),
               (-0.0877, 0.0626, -0.07645),
               (-0.0877, -0.06609, -0.07645)),
}
# fmt: on
