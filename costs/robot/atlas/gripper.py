"""A two-finger gripper of our own, in place of the hook of each hand: a palm and two boxes that slide apart.

The fingers move along the hand's x axis, each by its own joint, which is 0 where the pads are nearest:
``LEAST_OPENING`` from the middle.  The tool frame is between the pads, 20 mm before the fingers' ends.
"""

from __future__ import annotations

import re

PALM_START, PALM_END = 0.045, 0.075  # along the hand axis, from the hand frame [m]
PALM_WIDTH, PALM_DEPTH = 0.10, 0.04  # along the hand's x and z [m]
FINGER_LENGTH, FINGER_WIDTH, FINGER_DEPTH = 0.06, 0.014, 0.02  # along the hand axis, x and z [m]
TOOL_FROM_END = 0.02  # [m]
LEAST_OPENING, LARGEST_OPENING = 0.006, 0.045  # of each pad, from the middle [m]
PALM_MASS, FINGER_MASS = 0.6, 0.15  # [kg]
GRIP_SPEED, GRIP_FORCE = 0.1, 200.0  # [m/s, N]


def format_gripper(side: str, sign: float) -> list[str]:
    """Format palm, fingers and tool frame of a hand as URDF; frames have z along the hand axis and x as the hand's.

    Args:
        side: ``l`` or ``r``.
        sign: of the hand axis along the hand's y axis.
    """
    length = PALM_END - PALM_START
    palm = (PALM_WIDTH, PALM_DEPTH, length)
    finger = (FINGER_WIDTH, FINGER_DEPTH, FINGER_LENGTH)
    middle, aside = length + 0.5 * FINGER_LENGTH, LEAST_OPENING + 0.5 * FINGER_WIDTH
    tool = length + FINGER_LENGTH - TOOL_FROM_END
    lines = [
        *_link(f"{side}_palm", palm, (0.0, 0.0, 0.5 * length), PALM_MASS),
        *_link(f"{side}_finger_1", finger, (aside, 0.0, middle), FINGER_MASS),
        *_link(f"{side}_finger_2", finger, (-aside, 0.0, middle), FINGER_MASS),
        f'  <link name="{side}_tool"/>',
        *_joint(f"{side}_palm_joint", "fixed", f"{side}_hand", f"{side}_palm", (0.0, sign * PALM_START, 0.0),
                f"{-sign * 1.5707963267948966:.17g} 0 0"),
        "  </joint>",
        *_joint(f"{side}_tool_joint", "fixed", f"{side}_palm", f"{side}_tool", (0.0, 0.0, tool)),
        "  </joint>",
    ]  # fmt: skip
    travel = LARGEST_OPENING - LEAST_OPENING
    for number, along in ((1, 1.0), (2, -1.0)):
        lines += [
            *_joint(f"{side}_grip_{number}", "prismatic", f"{side}_palm", f"{side}_finger_{number}"),
            f'    <axis xyz="{along:g} 0 0"/>',
            f'    <limit lower="0" upper="{travel:g}" velocity="{GRIP_SPEED}" effort="{GRIP_FORCE}"/>',
            "  </joint>",
        ]
    return lines


def replace_hooks(srdf: str) -> str:
    """Return the bundled SRDF with the pairs of palms and fingers instead of the hooks'."""
    kept = [line for line in srdf.splitlines() if not re.search(r'"[lr]_hook"', line)]
    pairs = []
    for side in ("l", "r"):
        hand, palm = f"{side}_hand", f"{side}_palm"
        joined = [(hand, palm), (f"{side}_lfarm", palm)]
        joined += [(part, f"{side}_finger_{number}") for part in (hand, palm) for number in (1, 2)]
        pairs += [
            f'  <disable_collisions link1="{first}" link2="{second}" reason="Adjacent"/>' for first, second in joined
        ]
    end = kept.index("</robot>")
    return "\n".join([*kept[:end], *pairs, *kept[end:], ""])


def _link(name: str, size: tuple[float, ...], at: tuple[float, ...], mass: float) -> list[str]:
    """Format a link that is a box of uniform density."""
    a, b, c = size
    inertia = (("ixx", b * b + c * c), ("iyy", a * a + c * c), ("izz", a * a + b * b))
    values = " ".join(f'{key}="{mass * square / 12.0:.12g}"' for key, square in inertia)
    origin = f'<origin xyz="{_join(at)}" rpy="0 0 0"/>'
    shape = f'{origin}<geometry><box size="{_join(size)}"/></geometry>'
    return [
        f'  <link name="{name}">',
        "    <inertial>",
        f'      <mass value="{mass:g}"/>',
        f"      {origin}",
        f'      <inertia {values} ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
        f"    <visual>{shape}</visual>",
        f"    <collision>{shape}</collision>",
        "  </link>",
    ]


def _joint(
    name: str, kind: str, parent: str, child: str, at: tuple[float, ...] = (0.0, 0.0, 0.0), rpy: str = "0 0 0"
) -> list[str]:
    """Format the beginning of a joint."""
    return [
        f'  <joint name="{name}" type="{kind}">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    <origin xyz="{_join(at)}" rpy="{rpy}"/>',
    ]


def _join(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.12g}" for value in values)
