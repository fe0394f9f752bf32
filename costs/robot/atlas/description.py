"""The bundled Atlas as URDF text, made from our figures and shapes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from costs.robot.atlas.body_shapes import foot, link_shapes
from costs.robot.atlas.figures import FIXED_JOINTS, JOINTS, LINKS, MASSLESS_LINKS, SOLES
from costs.robot.atlas.gripper import format_gripper
from costs.robot.errors import RobotError

HandKind = Literal["hook", "gripper"]

FOLDER = Path(__file__).parent
DEFAULT_TOOL_DISTANCE = 0.12
MIN_TOOL_DISTANCE, MAX_TOOL_DISTANCE = 0.07, 0.60
HOOK_RADIUS = 0.009
# Where the hook's rod begins on the hand axis, inside the hand's palm.
HOOK_START = 0.045
# Where the rod leaves the hand, and the place of its middle before its end.
STUB_DISTANCE, PEG_FROM_END = 0.055, 0.03


def format_urdf(tool_distance_m: float = DEFAULT_TOOL_DISTANCE, hand: HandKind = "hook") -> str:
    """Format the URDF, with hooks that end at ``tool_distance_m`` from the hand frames, or with grippers.

    Raises:
        RobotError: when the distance would put the tool inside the hand or out of any proportion.
    """
    if not MIN_TOOL_DISTANCE <= tool_distance_m <= MAX_TOOL_DISTANCE:
        raise RobotError(
            f"tool_distance_m {tool_distance_m} is out of range; between {MIN_TOOL_DISTANCE} and {MAX_TOOL_DISTANCE} m"
        )
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Written by costs.robot.atlas.generate. Kinematics, limits, masses, inertias: osrf/drcsim, atlas_v5.urdf",
        "     and multisense_sl_v4.urdf, Apache License 2.0. Shapes and hooks are this project's own. -->",
        '<robot name="atlas">',
    ]
    shapes = mesh_points()
    for link in LINKS:
        lines += [f'  <link name="{link.name}">', "    <inertial>", f"      <mass value={quote([link.mass])}/>",
                  f'      <origin xyz={quote(link.com)} rpy="0 0 0"/>']  # fmt: skip
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        values = " ".join(f"{key}={quote([value])}" for key, value in zip(keys, link.inertia, strict=True))
        lines += [f"      <inertia {values}/>", "    </inertial>"]
        lines += [line for name in shapes if name.rpartition("_")[0] == link.name for line in _mesh_lines(name)]
        lines.append("  </link>")
    lines += [f'  <link name="{name}"/>' for name in MASSLESS_LINKS]
    for joint in JOINTS:
        lines += [f'  <joint name="{joint.name}" type="revolute">', *_ends(joint.parent, joint.child),
                  _origin(joint.xyz, joint.rpy), f"    <axis xyz={quote(joint.axis)}/>",
                  f"    <limit lower={quote([joint.lower])} upper={quote([joint.upper])}"
                  f" velocity={quote([joint.velocity])} effort={quote([joint.effort])}/>",
                  f"    <dynamics damping={quote([joint.damping])} friction={quote([joint.friction])}/>",
                  "  </joint>"]  # fmt: skip
    for fixed in FIXED_JOINTS:
        lines += _fixed(fixed.name, fixed.parent, fixed.child, fixed.xyz, fixed.rpy)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        lines += _hook_lines(side, sign, tool_distance_m) if hand == "hook" else format_gripper(side, sign)
    return "\n".join([*lines, "</robot>", ""])


def mesh_points() -> Mapping[str, Float[np.ndarray, "V 3"]]:
    """Return vertices by mesh name, ``link_0``, ``link_1``, ..., rounded to a hundredth of a millimetre."""
    from scipy.spatial import ConvexHull  # slow to import

    shapes = {link: tuple(bodies) for link, bodies in link_shapes().items()}
    shapes.update({link: (foot(np.array(sole)),) for link, sole in SOLES.items()})
    return {f"{link}_{index}": np.round(points[np.sort(ConvexHull(points).vertices)], 5) + 0.0
            for link, bodies in sorted(shapes.items()) for index, points in enumerate(bodies)}  # fmt: skip


def quote(values: tuple[float, ...] | list[float]) -> str:
    """Format numbers as an XML attribute value, quotes included."""
    from xml.sax.saxutils import quoteattr  # loads HTTP, too

    return quoteattr(" ".join(f"{float(value):.15g}" for value in values))


def _mesh_lines(name: str) -> list[str]:
    geometry = f'<geometry><mesh filename="package://atlas/meshes/{name}.obj"/></geometry>'
    return [f"    <visual>{geometry}</visual>", f"    <collision>{geometry}</collision>"]


def _hook_lines(side: str, sign: float, tool_distance: float) -> list[str]:
    """Format hook link and tool frame: z along the hand axis, away from the elbow; x as the hand's."""
    turned = (-sign * 0.5 * np.pi, 0.0, 0.0)
    length = tool_distance - HOOK_START
    rod = (f'<origin xyz={quote([0.0, 0.0, 0.5 * length])} rpy="0 0 0"/>'
           f'<geometry><cylinder radius="{HOOK_RADIUS}" length={quote([length])}/></geometry>')  # fmt: skip
    return [
        f'  <link name="{side}_hook">',
        f"    <visual>{rod}</visual>",
        f"    <collision>{rod}</collision>",
        "  </link>",
        f'  <link name="{side}_tool"/>',
        f'  <link name="{side}_peg"/>',
        f'  <link name="{side}_stub"/>',
        *_fixed(f"{side}_hook_joint", f"{side}_hand", f"{side}_hook", (0.0, sign * HOOK_START, 0.0), turned),
        *_fixed(f"{side}_tool_joint", f"{side}_hook", f"{side}_tool", (0.0, 0.0, length), (0.0, 0.0, 0.0)),
        *_fixed(f"{side}_peg_joint", f"{side}_tool", f"{side}_peg", (0.0, 0.0, -PEG_FROM_END), (0.0, 0.0, 0.0)),
        *_fixed(
            f"{side}_stub_joint",
            f"{side}_hook",
            f"{side}_stub",
            (0.0, 0.0, STUB_DISTANCE - HOOK_START),
            (0.0, 0.0, 0.0),
        ),
    ]


def _fixed(name: str, parent: str, child: str, xyz: tuple[float, ...], rpy: tuple[float, ...]) -> list[str]:
    return [f'  <joint name="{name}" type="fixed">', *_ends(parent, child), _origin(xyz, rpy), "  </joint>"]


def _ends(parent: str, child: str) -> list[str]:
    return [f'    <parent link="{parent}"/>', f'    <child link="{child}"/>']


def _origin(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    return f"    <origin xyz={quote(xyz)} rpy={quote(rpy)}/>"
