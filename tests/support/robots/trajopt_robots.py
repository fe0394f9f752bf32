"""Robots of the problem files that TrajOpt ships: a box, a ball, and a robot with two arms like the PR2's.

Names, joints and limits are those that the files mean; shapes are boxes and cylinders.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

HEAD = (
    '<robot name="{name}" xmlns:xacro="http://ros.org/wiki/xacro" xmlns:tesseract="http://tesseract" '
    'tesseract:make_convex="true">'
)
SLIDE = '<limit effort="0" lower="-20" upper="20" velocity="2"/>'


def write_slider(folder: Path, name: str, shape: str, others: tuple[tuple[float, float, float], ...]) -> Path:
    """URDF of a shape that slides in x and y, with fixed ones of the same shape at ``others``; and its SRDF."""
    collision = f"<collision><geometry>{shape}</geometry></collision>"
    fixed = "".join(
        f'<link name="test_link{k}">{collision}</link><joint name="test_joint{k}" type="fixed">'
        f'<origin xyz="{x} {y} {z}"/><parent link="base_link"/><child link="test_link{k}"/></joint>'
        for k, (x, y, z) in enumerate(others)
    )
    text = (
        f'{HEAD.format(name=name)}<link name="base_link"/><link name="link_x"/><link name="link_y">{collision}</link>'
        f'<joint name="x_joint" type="prismatic"><parent link="base_link"/><child link="link_x"/><axis xyz="1 0 0"/>'
        f'{SLIDE}</joint><joint name="y_joint" type="prismatic"><parent link="link_x"/><child link="link_y"/>'
        f'<axis xyz="0 1 0"/>{SLIDE}</joint>{fixed}</robot>'
    )
    path = folder / f"{name}.urdf"
    path.write_text(text)
    between = "".join(
        f'<disable_collisions link1="test_link{a}" link2="test_link{b}" reason="Never"/>'
        for a in range(len(others))
        for b in range(a)
    )
    path.with_suffix(".srdf").write_text(
        f'<robot name="{name}"><group name="manipulator"><joint name="x_joint"/><joint name="y_joint"/></group>'
        f"{between}</robot>"
    )
    return path


def write_two_arms(folder: Path) -> Path:
    """URDF of a pedestal with two arms of seven joints, and its SRDF with the groups of both."""
    parts = ['<link name="base_footprint"/><link name="torso"><collision><origin xyz="-0.25 0 -0.25"/><geometry>'
             '<box size="0.2 0.3 0.9"/></geometry></collision></link><joint name="torso_joint" type="fixed">'
             '<origin xyz="-0.05 0 0.79"/><parent link="base_footprint"/><child link="torso"/></joint>']  # fmt: skip
    groups, near = [], []
    for side, across, pan, roll in (
        ("r", -0.188, (-2.28, 0.71), (-3.9, 0.8)),
        ("l", 0.188, (-0.71, 2.28), (-0.8, 3.9)),
    ):
        links = (  # name, axis, origin of its joint, limits, torque, mass, beginning, length and width along x
            ("shoulder_pan", "0 0 1", f"0 {across} 0", pan, 60, 3.0, (-0.05, 0.15, 0.1)),
            ("shoulder_lift", "0 1 0", "0.1 0 0", (-0.52, 1.39), 80, 2.0, (-0.05, 0.1, 0.12)),
            ("upper_arm_roll", "1 0 0", "0 0 0", roll, 40, 2.0, (0.06, 0.26, 0.09)),
            ("elbow_flex", "0 1 0", "0.4 0 0", (-2.32, 0.0), 60, 1.0, (-0.04, 0.08, 0.1)),
            ("forearm_roll", "1 0 0", "0 0 0", None, 30, 1.0, (0.12, 0.11, 0.08)),
            ("wrist_flex", "0 1 0", "0.321 0 0", (-2.18, 0.0), 20, 0.5, (-0.03, 0.06, 0.08)),
            ("wrist_roll", "1 0 0", "0 0 0", None, 20, 0.5, (0.07, 0.11, 0.06)),
        )
        parent, joints = "torso", []
        for name, axis, origin, limits, effort, mass, (begin, length, width) in links:
            link, joint = f"{side}_{name}_link", f"{side}_{name}_joint"
            middle = begin + 0.5 * length
            body = (
                f'<collision><origin xyz="{middle} 0 0"/><geometry><box size="{length} {width} {width}"/></geometry>'
                "</collision>"
            )
            kind = "continuous" if limits is None else "revolute"
            bounds = "" if limits is None else f'lower="{limits[0]}" upper="{limits[1]}"'
            parts.append(
                f'<link name="{link}"><inertial><origin xyz="{middle} 0 0"/><mass value="{mass}"/><inertia ixx="0.01" '
                f'iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{body}</link><joint name="{joint}" '
                f'type="{kind}"><origin xyz="{origin}"/><parent link="{parent}"/><child link="{link}"/>'
                f'<axis xyz="{axis}"/><limit {bounds} effort="{effort}" velocity="2"/></joint>'
            )
            parent = link
            joints.append(f'<joint name="{joint}"/>')
        parts.append(
            f'<link name="{side}_gripper_tool_frame"/><joint name="{side}_tool_joint" type="fixed">'
            f'<origin xyz="0.18 0 0"/><parent link="{parent}"/><child link="{side}_gripper_tool_frame"/></joint>'
        )
        chain = ["torso", *(f"{side}_{name}_link" for name, *_ in links)]
        near += [f'<disable_collisions link1="{a}" link2="{b}" reason="Adjacent"/>' for a, b in pairwise(chain)]
        groups.append(f'<group name="{"right" if side == "r" else "left"}_arm">{"".join(joints)}</group>')
    path = folder / "two_arms.urdf"
    path.write_text(f"{HEAD.format(name='two_arms')}{''.join(parts)}</robot>")
    path.with_suffix(".srdf").write_text(f'<robot name="two_arms">{"".join(groups + near)}</robot>')
    return path
