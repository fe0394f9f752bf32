"""A gantry of our own: three slides, a turning hand that points down, and two fingers; it plans in a second."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

FINGER_M, REACH_M = 0.06, 0.04  # length of a finger, and how far each opens
GRIP_N = 100.0  # effort of a finger


def _box(size: str, at: str) -> str:
    return f'<origin xyz="{at}"/><geometry><box size="{size}"/></geometry>'


def format_link(name: str, mass: float, size: str, at: str = "0 0 0") -> str:
    """Return the URDF of a link that is a box [kg, m]."""
    inertia = f'<inertia ixx="{mass * 1e-3}" iyy="{mass * 1e-3}" izz="{mass * 1e-3}" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/>{inertia}</inertial>'
        f"<collision>{_box(size, at)}</collision></link>"
    )


def format_joint(
    name: str, kind: str, parent: str, child: str, at: str, axis: str, limit: tuple[float, float, float]
) -> str:
    """Return the URDF of a joint with its least and largest value and its effort."""
    low, high, effort = limit
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="1" effort="{effort}"/></joint>'
    )


def write_gantry(folder: Path, *, follows: bool = False) -> Path:
    """Write its URDF; with ``follows`` the second finger follows the first one."""
    text = format_link("base", 5.0, "0.1 0.1 0.1", "0 0 2.2") + _format_arm(0.0)
    if follows:
        text = text.replace(
            '<joint name="grip_2" type="prismatic">', '<joint name="grip_2" type="prismatic"><mimic joint="grip_1"/>'
        )
    path = folder / "gantry.urdf"
    path.write_text(f'<robot name="gantry">{text}</robot>', encoding="utf-8")
    return path


def write_two_hands(folder: Path) -> Path:
    """Write the URDF of two such arms side by side; names of the second one begin with ``second_``."""
    second = re.sub(r'(name|link|joint)="(?!base")', r'\1="second_', _format_arm(0.5))
    text = format_link("base", 5.0, "0.1 0.1 0.1", "0 0 2.2") + _format_arm(-0.5) + second
    path = folder / "gantry.urdf"
    path.write_text(f'<robot name="gantry">{text}</robot>', encoding="utf-8")
    return path


def _format_arm(aside: float) -> str:
    """Return links and joints of an arm whose slide is beside the middle of the base [m]."""
    parts = [
        format_link("bridge", 2.0, "0.08 0.08 0.08"),
        format_link("trolley", 2.0, "0.08 0.08 0.08"),
        format_link("column", 2.0, "0.06 0.06 0.8", "0 0 -0.4"),
        format_link("hand", 1.0, "0.12 0.04 0.06", "0 0 -0.03"),
        format_link("finger_1", 0.1, f"0.014 0.02 {FINGER_M}", f"0.007 0 {-0.5 * FINGER_M}"),
        format_link("finger_2", 0.1, f"0.014 0.02 {FINGER_M}", f"-0.007 0 {-0.5 * FINGER_M}"),
        '<link name="tool"/>',
        format_joint("x", "prismatic", "base", "bridge", f"0 {aside:g} 2.1", "1 0 0", (-1.0, 1.0, 500.0)),
        format_joint("y", "prismatic", "bridge", "trolley", "0 0 -0.1", "0 1 0", (-1.0, 1.0, 500.0)),
        format_joint("z", "prismatic", "trolley", "column", "0 0 -0.08", "0 0 1", (-1.0, 0.0, 500.0)),
        format_joint("yaw", "revolute", "column", "hand", "0 0 -0.85", "0 0 1", (-3.1, 3.1, 50.0)),
        format_joint("grip_1", "prismatic", "hand", "finger_1", "0.004 0 -0.06", "1 0 0", (0.0, REACH_M, GRIP_N)),
        format_joint("grip_2", "prismatic", "hand", "finger_2", "-0.004 0 -0.06", "-1 0 0", (0.0, REACH_M, GRIP_N)),
        '<joint name="tool_joint" type="fixed"><parent link="hand"/><child link="tool"/>'
        f'<origin xyz="0 0 {-0.06 - FINGER_M + 0.02}" rpy="3.141592653589793 0 0"/></joint>',
    ]
    return "".join(parts)


TABLE = {"type": "box", "name": "table", "size": [0.8, 0.8, 0.1], "position": [0.0, 0.0, 0.35]}
BLOCK = {"type": "box", "name": "block", "size": [0.05, 0.05, 0.08], "mass_kg": 0.5, "position": [0.1, -0.2, 0.44]}


def pick_place_request(urdf: Path, *, follows: bool = False, **changes: Any) -> dict[str, Any]:
    """Return a request to move a block on a table; ``changes`` are of the section, the block or the scene.

    Args:
        urdf: of the gantry.
        changes: fields of the section; ``block`` changes those of the object, ``obstacles`` are added.
    """
    block = {**copy.deepcopy(BLOCK), **changes.pop("block", {})}
    obstacles = [copy.deepcopy(TABLE), *changes.pop("obstacles", ())]
    hand = {"link": "hand", "hook": "hand", "tool": "tool", "fingers": ["finger_1", "finger_2"]}
    section = {"object": "block", "to": {"position": [-0.1, 0.2, 0.44]}, "grip_n": 40.0, **changes}
    return {
        "robot": {"urdf": str(urdf), "hands": {"right": hand}},
        "start": {"joints": {"z": -0.1, "grip_1": 0.01, **({} if follows else {"grip_2": 0.01})}},
        "scene": {"floor": 0.0, "obstacles": obstacles, "objects": [block]},
        "task": {"pick_place": section},
    }


BAR = {"type": "box", "name": "bar", "size": [0.04, 0.36, 0.04], "mass_kg": 0.15, "position": [0.0, -0.1, 0.42]}


def hand_over_request(urdf: Path) -> dict[str, Any]:
    """Return a request to hand a bar over: one hand lifts it, the other takes it in the air and puts it down.

    Args:
        urdf: of the gantry with two hands.
    """
    hands = {
        side: {
            "link": f"{own}hand",
            "hook": f"{own}hand",
            "tool": f"{own}tool",
            "fingers": [f"{own}finger_1", f"{own}finger_2"],
        }
        for side, own in (("right", ""), ("left", "second_"))
    }
    grips = {
        f"{own}{name}": value
        for own in ("", "second_")
        for name, value in (("z", -0.1), ("grip_1", 0.01), ("grip_2", 0.01))
    }
    steps = [
        {"name": "take", "grasp": {"object": "bar", "hand": "right"}},
        {"name": "up", "move": {"frame": "bar", "by": {"translation": [0, 0, 0.15]}, "along": "line"}},
        {"name": "take over", "grasp": {"object": "bar", "hand": "left"}},
        {"name": "give", "release": {"object": "bar", "hand": "right"}},
        {"name": "down", "move": {"poses": [{"link": "bar", "position": [0.0, 0.15, 0.42]}]}},
        {"name": "let go", "release": {"object": "bar"}},
    ]
    return {
        "robot": {"urdf": str(urdf), "hands": hands},
        "start": {"joints": grips},
        "scene": {"floor": 0.0, "obstacles": [copy.deepcopy(TABLE)], "objects": [copy.deepcopy(BAR)]},
        "task": {"steps": steps},
    }
