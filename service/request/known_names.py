"""Names of robots, postures, joints and links in a request's plain data, checked without loading the robot."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, TypeGuard

from service.errors import MAX_PROBLEMS, would_do

MAX_NAME = 200  # characters
SAME_ROBOT = frozenset({"name", "root", "contacts", "hands", "servo"})  # keys of ``robot`` that add no link or joint


@dataclass(frozen=True)
class RobotNames:
    """Names that requests may use with a robot.

    Attributes:
        name: name of the robot.
        joints: names of its joints, without those of a floating base.
        postures: names of its postures.
        links: names of its links and frames.
    """

    name: str
    joints: tuple[str, ...]
    postures: tuple[str, ...]
    links: frozenset[str]


def find_robot_name(data: Mapping[str, Any]) -> str | None:
    """Return the name of the robot in a request's plain data; None without a usable one."""
    name = _section(data, "robot").get("name")
    return name if _is_name(name) else None


def find_name_problems(data: Mapping[str, Any], robots: Collection[str], known: Mapping[str, RobotNames]) -> list[str]:
    """Return one line for each of the first ``MAX_PROBLEMS`` unknown names, in the words of the planner.

    Args:
        data: plain data of a request, which may be wrong in other ways.
        robots: names of all robots.
        known: names of robots that are known; the names of another robot are not checked.
    """
    robot, name = _section(data, "robot"), find_robot_name(data)
    if name is None or robot.get("urdf") is not None or "trajopt" in _section(data, "task"):
        return []
    if name not in robots:
        return [f"robot.name: unknown robot {name!r}; expected {would_do(name, robots)}"]
    names = known.get(name)
    if names is None:
        return []
    problems = [_find_postures(data, names)]
    if set(robot) <= SAME_ROBOT:
        problems.append(_find_joints(data, names))
        if not data.get("attached"):  # carried bodies are links
            problems.append(_find_links(data, names))
    return list(islice(chain.from_iterable(problems), MAX_PROBLEMS))


def _find_postures(data: Mapping[str, Any], names: RobotNames) -> Iterator[str]:
    for section in ("start", "goal"):
        posture = _section(data, section).get("posture")
        if _is_name(posture) and posture not in names.postures:
            expected = would_do(posture, names.postures) or f"no postures; give {section}.joints"
            yield f"unknown posture {posture!r} in {section}.posture; {names.name} has {expected}"


def _find_joints(data: Mapping[str, Any], names: RobotNames) -> Iterator[str]:
    start, goal = _section(data, "start"), _section(data, "goal")
    given = {
        "start.joints": start.get("joints"),
        "start.joint_names": start.get("joint_names"),
        "goal.joints": goal.get("joints"),
    }
    for field, joints in given.items():
        for joint in joints if isinstance(joints, Mapping | list | tuple) else ():
            if _is_name(joint) and joint not in names.joints:
                yield f"unknown joint {joint!r} in {field}; {names.name} has {would_do(joint, names.joints)}"


def _find_links(data: Mapping[str, Any], names: RobotNames) -> Iterator[str]:
    goal, kept = _section(data, "goal"), data.get("keep")
    parts = [("goal", goal)]
    for several in ("any_of", "via"):
        parts += [(f"goal.{several}[{k}]", part) for k, part in enumerate(_entries(goal.get(several)))]
    given = [
        (f"{field}.poses[{index}].{key}", pose, key)
        for field, part in parts
        for index, pose in enumerate(_entries(part.get("poses")))
        for key in ("link", "relative_to")
    ]
    for index, keep in enumerate(_entries(kept)):
        given += [(f"keep[{index}].{key}", keep, key) for key in ("link", "relative_to")]
    feet = _section(data, "options").get("feet")
    given += [("options.feet", {"link": foot}, "link") for foot in (feet if isinstance(feet, list | tuple) else ())]
    for field, entry, key in given:
        link = entry.get(key)
        if _is_name(link) and link not in names.links:
            yield f"unknown link {link!r} in {field}; {names.name} has {would_do(link, sorted(names.links))}"


def _is_name(value: object) -> TypeGuard[str]:
    """Whether a value can be a name; the validator refuses others."""
    return isinstance(value, str) and len(value) <= MAX_NAME


def _section(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = data.get(name)
    return section if isinstance(section, Mapping) else {}


def _entries(value: object) -> list[Mapping[str, Any]]:
    return [entry if isinstance(entry, Mapping) else {} for entry in value] if isinstance(value, list | tuple) else []
