"""Bundled Atlas v5 robot: kinematic figures from a public source; shapes and hooks are this project's.

Each hand link carries a hook, a rod on the hand axis (+y of ``l_hand``, -y of ``r_hand``) with the link name ``l_hook``
or ``r_hook``. It ends at the frame ``l_tool`` or ``r_tool``, whose z axis points outwards along the hand axis and whose
x axis is the hand's. With grippers instead (``costs.robot.atlas.gripper``) the links are ``l_palm``, ``l_finger_1`` and
``l_finger_2``, and the tool frame is between the fingers.

The soles of ``l_foot`` and ``r_foot`` are their bodies' lowest faces. In the postures ``stand``
and ``reach_ready`` both soles lie on z = 0, the pelvis is at x = y = 0, and the centre of mass is above the middle of
the feet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

from costs.contact import Contact
from costs.robot.atlas.description import DEFAULT_TOOL_DISTANCE, FOLDER, HandKind, format_urdf
from costs.robot.atlas.gripper import replace_hooks
from costs.robot.contact_patches import read_patches
from costs.robot.load import Root, build_robot
from costs.robot.model import RobotModel
from costs.robot.xmlfile import read_xml_text


def load_atlas(
    root: Root, tool_distance_m: float | None, locked_joints: Mapping[str, float], hand: HandKind = "hook"
) -> RobotModel:
    """Load the bundled Atlas, once per process for equal arguments; see ``costs.robot.load_robot``."""
    return _load(root, tool_distance_m, tuple(sorted(locked_joints.items())), hand)


@lru_cache(maxsize=8)
def _load(
    root: Root, tool_distance_m: float | None, locked_joints: tuple[tuple[str, float], ...], hand: HandKind
) -> RobotModel:
    """Load the bundled Atlas; cached, since its files do not change and each plan and replay asks for it."""
    urdf, srdf = FOLDER / "atlas.urdf", FOLDER / "atlas.srdf"
    pairs = read_xml_text(srdf)
    if hand == "gripper":
        text, pairs = format_urdf(hand=hand), replace_hooks(pairs)
    elif tool_distance_m is None or tool_distance_m == DEFAULT_TOOL_DISTANCE:
        text = read_xml_text(urdf)
    else:
        text = format_urdf(tool_distance_m)
    roots = (FOLDER.parent,)
    robot = build_robot(text, pairs, roots, root, dict(locked_joints), str(urdf), str(srdf))
    patches = {name: patch for name, patch in load_contacts().items() if robot.model.existFrame(patch.link)}
    return replace(robot, contacts=patches)  # a gripper has no hooks


def load_contacts() -> dict[str, Contact]:
    """Return the bundled Atlas's contact patches by name."""
    return read_patches(FOLDER / "contacts.yaml")
