"""``basic_info.manip``: which coordinates of the robot a problem moves, in the order of its lists of joint values."""

from __future__ import annotations

import re

from costs.robot import BASE_NAMES, RobotModel
from service.errors import would_do

ACTIVE, BASE = "active", "base"
PLANAR_BASE = ("base_x", "base_y", "base_yaw")
PATH = "basic_info.manip"
MAX_PARTS = 100  # what is unknown is compared with all that is known


def manip_columns(robot: RobotModel, manip: str) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Coordinates named by ``manip``, and a line for everything wrong with it.

    Parts are joined by ``+``: a group of the SRDF (``leftarm`` means ``left_arm``, too), a joint, ``base`` (x, y and
    yaw of a free base), or ``active`` (every joint, then the six coordinates of a free base).
    """
    names: list[str] = []
    problems: list[str] = []
    parts = [piece.strip() for piece in manip.split("+")]
    if len(parts) > MAX_PARTS:
        return (), (f"{PATH}: expected at most {MAX_PARTS} groups and joints, got {len(parts)}",)
    for part in parts:
        found = _part(robot, part)
        if found is None:
            known = [*(group for group, joints in robot.groups.items() if joints), *robot.joint_names, ACTIVE]
            problems.append(f"{PATH}: {robot.name} has no group or joint {part!r}; expected {would_do(part, known)}")
        elif not found:
            problems.append(f"{PATH}: the base of {robot.name} is fixed; leave 'base' out")
        else:
            names += found
    twice = sorted({name for name in names if names.count(name) > 1})
    problems += [f"{PATH}: {name} is named twice" for name in twice]
    return tuple(robot.joint_names.index(name) for name in names), tuple(problems)


def _part(robot: RobotModel, part: str) -> tuple[str, ...] | None:
    """Joint names of one part; empty for a base that is fixed, None for a name that is not known."""
    if part in robot.joint_names:
        return (part,)
    if part == BASE and BASE not in robot.groups:
        return PLANAR_BASE if robot.is_floating else ()
    if robot.groups.get(part):
        return tuple(robot.groups[part])
    if part == ACTIVE:
        n_base = len(BASE_NAMES) if robot.is_floating else 0
        return (*robot.joint_names[n_base:], *robot.joint_names[:n_base])
    alike = [group for group, joints in robot.groups.items() if joints and _plain(group) == _plain(part)]
    return tuple(robot.groups[alike[0]]) if alike else None


def _plain(name: str) -> str:
    """``left_arm`` and ``leftarm`` are one."""
    return re.sub(r"[^a-z0-9]", "", name.lower())
