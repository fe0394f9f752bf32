"""Robots whose descriptions keep something from being checked, as URDF and SRDF text, for tests of the verdict."""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import combinations, pairwise

MASS = (
    '<inertial><origin xyz="{x} 0 0"/><mass value="2"/>'
    '<inertia ixx="0.002" ixy="0" ixz="0" iyy="0.016" iyz="0" izz="0.016"/></inertial>'
)
LINK_LENGTH = 0.3
ARM_LINKS = ("base", "upper", "forearm", "hand")


def _box(tag: str, size: str, origin: str = "0 0 0") -> str:
    return f'<{tag}><origin xyz="{origin}"/><geometry><box size="{size}"/></geometry></{tag}>'


def _joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str, limits: str, effort: float = 300) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/><limit {limits} velocity="2" effort="{effort}"/></joint>'
    )


def _fixed(name: str, parent: str, child: str, xyz: str) -> str:
    return (
        f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/></joint>'
    )


def arm(
    shaped: Collection[str] = ARM_LINKS,
    *,
    drawn: Collection[str] = ARM_LINKS,
    heavy: Collection[str] = ARM_LINKS,
    limit: float = 3.0,
) -> str:
    """An arm of three links 0.3 m long that turn in a horizontal plane on a base of 0.2 m.

    Args:
        shaped: links with a collision shape.
        drawn: links with a visual shape, of the same size.
        heavy: links with a mass of 2 kg.
        limit: of its joints either way [rad].
    """
    links = []
    for name in ARM_LINKS:
        size, middle = ("0.2 0.2 0.2", 0.0) if name == "base" else (f"{LINK_LENGTH} 0.08 0.08", 0.5 * LINK_LENGTH)
        tags = [tag for tag, names in (("visual", drawn), ("collision", shaped)) if name in names]
        inside = "".join(_box(tag, size, f"{middle} 0 0") for tag in tags)
        links.append(f'<link name="{name}">{MASS.format(x=middle) if name in heavy else ""}{inside}</link>')
    joints = [
        _joint(f"j{k}", "revolute", parent, child, f"{0.14 if k == 0 else LINK_LENGTH + 0.02} 0 0", "0 0 1",
               f'lower="{-limit}" upper="{limit}"')
        for k, (parent, child) in enumerate(pairwise(ARM_LINKS))
    ]  # fmt: skip
    return f'<robot name="arm">{"".join(links + joints)}</robot>'


def rail_arm_with_wall() -> str:
    """A carriage on a rail (x) with a lift (z) and a bar across, and a wall that the URDF fixes to the world at x = 1.

    The bar passes over the wall, whose top is at z = 1.2, only when it is lifted by more than 0.35 m from z = 1.
    """
    return (
        '<robot name="rail_arm"><link name="world"/>'
        f'<link name="wall">{_box("collision", "0.05 2 1.2")}</link>'
        f'<link name="carriage"/><link name="bar">{_box("collision", "0.3 0.1 0.1")}</link>'
        + _fixed("wall_mount", "world", "wall", "1 0 0.6")
        + _joint("rail", "prismatic", "world", "carriage", "0 0 1", "1 0 0", 'lower="0" upper="2"')
        + _joint("lift", "prismatic", "carriage", "bar", "0 0 0", "0 0 1", 'lower="-0.1" upper="0.8"')
        + "</robot>"
    )


def rail_arm_on_wall() -> str:
    """The same, but rail and wall are two shapes of one link, on which the carriage is mounted."""
    urdf = rail_arm_with_wall().replace('<link name="wall">', '<link name="wall_before">')
    shapes = _box("collision", "0.05 2 1.2", "1 0 0.6") + _box("collision", "2 0.04 0.04", "1 1.2 1")
    urdf = re.sub(r'<link name="wall_before">.*?</link>', "", urdf)
    urdf = re.sub(r'<joint name="wall_mount".*?</joint>', "", urdf)
    return urdf.replace('<link name="world"/>', f'<link name="world">{shapes}</link>')


def boxbot() -> str:
    """Two boxes of 1 m: one fixed to the world at the origin, one that slides in x and y, without torque limits.

    After the robot of that name in Tesseract's test support, which leaves its only pair out.
    """
    slide = 'lower="-20" upper="20"'
    box = _box("visual", "1 1 1") + _box("collision", "1 1 1")
    return (
        '<robot name="boxbot"><link name="base_link"/><link name="boxbot_linkX"/><link name="boxbot_linkY"/>'
        f'<link name="boxbot_link">{box}</link><link name="test_base_link"/><link name="test_box_link">{box}</link>'
        + _joint("boxbot_x_joint", "prismatic", "base_link", "boxbot_linkX", "0 0 0", "1 0 0", slide, effort=0)
        + _joint("boxbot_y_joint", "prismatic", "boxbot_linkX", "boxbot_linkY", "0 0 0", "0 1 0", slide, effort=0)
        + _fixed("boxbot_joint", "boxbot_linkY", "boxbot_link", "0 0 0")
        + _fixed("test_box_joint", "test_base_link", "test_box_link", "0 0 0")
        + _fixed("attach_box_joint", "base_link", "test_base_link", "0 0 0")
        + "</robot>"
    )


def srdf_without_pairs(links: Collection[str], reason: str = "Never") -> str:
    """An SRDF that leaves out every pair of these links."""
    pairs = "".join(
        f'<disable_collisions link1="{a}" link2="{b}" reason="{reason}"/>' for a, b in combinations(sorted(links), 2)
    )
    return f'<robot name="arm">{pairs}</robot>'


def without_torque_limits(urdf: str) -> str:
    """The robot with ``effort="0"`` at all joints."""
    return re.sub(r'effort="[^"]*"', 'effort="0"', urdf)


def with_inertia(urdf: str, value: float, key: str = "ixx") -> str:
    """The robot with this moment of inertia at all links."""
    return re.sub(rf'{key}="[^"]*"', f'{key}="{value}"', urdf)


def without_masses(urdf: str) -> str:
    """The robot without a single mass."""
    return re.sub(r"<inertial>.*?</inertial>", "", urdf, flags=re.DOTALL)


def without_collision_shapes(urdf: str, *links: str) -> str:
    """The robot without the collision shapes of these links (of all, if none is named)."""

    def stripped(match: re.Match[str]) -> str:
        if links and match.group(1) not in links:
            return match.group(0)
        return re.sub(r"<collision\b.*?</collision>", "", match.group(0), flags=re.DOTALL)

    return re.sub(r'<link name="([^"]*)"\s*>.*?</link>', stripped, urdf, flags=re.DOTALL)
