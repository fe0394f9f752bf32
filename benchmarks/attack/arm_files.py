"""Files of a small arm on a pedestal: boxes, a cylinder and a mesh, all numbers correct."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

JOINTS = ("yaw", "shoulder", "elbow", "wrist", "roll")
START = {"yaw": -0.9, "shoulder": 0.5, "elbow": 0.9, "wrist": 0.3, "roll": 0.0}
GOAL = {"yaw": 0.9, "shoulder": 0.5, "elbow": 0.9, "wrist": 0.3, "roll": 0.8}
# Between start and goal, so that the straight line collides: the arm has to lift over it.
POST = {"name": "post", "type": "box", "size": [0.08, 0.08, 0.9], "position": [0.62, 0.0, 0.45]}
SHELF = {"name": "shelf", "type": "box", "size": [0.3, 0.5, 0.03], "position": [-0.6, 0.0, 0.7]}

_ARM = """<robot name="arm">
  <link name="base">
    <inertial><mass value="20"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><origin xyz="0 0 0.15"/><geometry><box size="0.24 0.24 0.3"/></geometry></visual>
    <collision><origin xyz="0 0 0.15"/><geometry><box size="0.24 0.24 0.3"/></geometry></collision>
  </link>
  <link name="turret">
    <inertial><mass value="3"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>
    <visual><geometry><cylinder radius="0.08" length="0.1"/></geometry></visual>
    <collision><geometry><cylinder radius="0.08" length="0.1"/></geometry></collision>
  </link>
  <link name="upper_arm">
    <inertial><origin xyz="0 0 0.2"/><mass value="3"/>
      <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.01"/></inertial>
    <visual><origin xyz="0 0 0.21"/><geometry><box size="0.09 0.09 0.34"/></geometry></visual>
    <collision><origin xyz="0 0 0.21"/><geometry><box size="0.09 0.09 0.34"/></geometry></collision>
  </link>
  <link name="forearm">
    <inertial><origin xyz="0 0 0.15"/><mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.005"/></inertial>
    <visual><origin xyz="0 0 0.16"/><geometry><box size="0.07 0.07 0.28"/></geometry></visual>
    <collision><origin xyz="0 0 0.16"/><geometry><box size="0.07 0.07 0.28"/></geometry></collision>
  </link>
  <link name="wrist_link">
    <inertial><mass value="0.5"/><inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial>
    <visual><geometry><sphere radius="0.04"/></geometry></visual>
    <collision><geometry><sphere radius="0.04"/></geometry></collision>
  </link>
  <link name="hand">
    <inertial><origin xyz="0 0 0.05"/><mass value="0.5"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial>
    <visual><geometry><mesh filename="hand.obj"/></geometry></visual>
    <collision><geometry><mesh filename="hand.obj"/></geometry></collision>
  </link>
  <joint name="yaw" type="revolute"><parent link="base"/><child link="turret"/><origin xyz="0 0 0.36"/>
    <axis xyz="0 0 1"/><limit lower="-2.8" upper="2.8" velocity="2" effort="150"/></joint>
  <joint name="shoulder" type="revolute"><parent link="turret"/><child link="upper_arm"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 1 0"/><limit lower="-1.6" upper="1.6" velocity="2" effort="150"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper_arm"/><child link="forearm"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/><limit lower="-2.4" upper="2.4" velocity="2" effort="100"/></joint>
  <joint name="wrist" type="revolute"><parent link="forearm"/><child link="wrist_link"/><origin xyz="0 0 0.34"/>
    <axis xyz="0 1 0"/><limit lower="-1.8" upper="1.8" velocity="3" effort="40"/></joint>
  <joint name="roll" type="revolute"><parent link="wrist_link"/><child link="hand"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="20"/></joint>
</robot>
"""
NEIGHBOURS = (
    ("base", "turret"),
    ("turret", "upper_arm"),
    ("upper_arm", "forearm"),
    ("forearm", "wrist_link"),
    ("wrist_link", "hand"),
    ("forearm", "hand"),
)


def box_obj(size: tuple[float, float, float], lift: float = 0.0) -> str:
    """Return a closed box as OBJ text, its bottom at the given height [m]."""
    x, y, z = size
    corners = [(a * x / 2, b * y / 2, lift + c * z) for a in (-1, 1) for b in (-1, 1) for c in (0, 1)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    return "\n".join(
        [*(f"v {a} {b} {c}" for a, b, c in corners), *(f"f {a} {b} {c}\nf {a} {c} {d}" for a, b, c, d in faces)]
    )


def honest_urdf() -> str:
    """Return the correct URDF of the arm."""
    return _ARM


def srdf(pairs: Iterable[tuple[str, str]] = NEIGHBOURS) -> str:
    """Return an SRDF that disables pairs of links."""
    rows = "".join(f'<disable_collisions link1="{a}" link2="{b}" reason="Never"/>' for a, b in pairs)
    return f'<robot name="arm">{rows}</robot>'


def write_arm(
    folder: Path,
    lie: Callable[[ET.Element], object] | None = None,
    disabled: Iterable[tuple[str, str]] | None = NEIGHBOURS,
) -> dict[str, Any]:
    """Write URDF, mesh and SRDF; return the ``robot`` section of a request.

    Args:
        folder: an existing one.
        lie: changes the parsed URDF.
        disabled: pairs of the SRDF; None for no SRDF.
    """
    root = ET.fromstring(_ARM)
    if lie is not None:
        lie(root)
    urdf = folder / "arm.urdf"
    urdf.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
    (folder / "hand.obj").write_text(box_obj((0.1, 0.05, 0.12)), encoding="utf-8")
    if disabled is None:
        return {"urdf": str(urdf)}
    (folder / "arm.srdf").write_text(srdf(disabled), encoding="utf-8")
    return {"urdf": str(urdf), "srdf": str(folder / "arm.srdf")}


def arm_request(robot: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a request for a reach of the arm past a post."""
    request = {
        "robot": robot,
        "start": {"joints": START},
        "scene": {"obstacles": [POST, SHELF]},
        "goal": {"joints": GOAL},
        "options": {"time_limit_s": 20.0},
    }
    return {**request, **more}
