"""A URDF's joints: their limits, friction and damping, and joints locked at a position."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.names import would_do
from costs.robot.elements.shapes import LONG_M
from costs.robot.errors import RobotError
from costs.robot.poses import axis_rotation, make_origin, parse_origin
from costs.robot.xmlfile import MADE_HERE, parse_limit, parse_number, parse_numbers, read_attribute

LOCK_TOLERANCE = 1e-3  # of a locked position beyond the limits [rad, m]
MOVABLE = ("revolute", "continuous", "prismatic")
MOST_LIMIT = 1e4  # limits of position beyond it on both sides count as none [rad, m]
MANY_RAD = 30.0  # positions beyond it may be in another unit
DEFAULT_VELOCITY = 1.0
"""Velocity limit of the joints of a file that gives none to any of them [rad/s, m/s]."""


@dataclass(frozen=True)
class Joint:
    """One <joint> element.

    Attributes:
        name, parent, child: its name and the links it connects.
        kind: URDF type: ``revolute``, ``continuous``, ``prismatic`` or ``fixed``.
        pose_parent_joint: (4, 4) at zero.
        axis: (3,) unit vector in the joint's frame.
        lower, upper: position limits [rad or m]; +-inf for continuous joints.
        velocity, effort: [rad/s or m/s, Nm or N].
        acceleration: [rad/s^2 or m/s^2], None when the URDF does not say.
        mimic: (joint, multiplier, offset) it follows, or None.
        friction: dry friction [Nm or N].
        damping: [Nm s/rad or N s/m].
        stops: lower and upper limit where a controller keeps it from going as far; None where nothing narrows them.
    """

    name: str
    parent: str
    child: str
    kind: str
    pose_parent_joint: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, "3"]
    lower: float
    upper: float
    velocity: float
    effort: float
    acceleration: float | None
    mimic: tuple[str, float, float] | None
    friction: float = 0.0
    damping: float = 0.0
    stops: tuple[float, float] | None = None


def parse_joint(element: etree._Element, where: str, notes: list[str], *, is_robot: bool = True) -> Joint:
    """Read and check one <joint>; add a note for what the file leaves open.

    The joints of a mechanism have no motors, so that limits of effort and speed need not be stated.
    """
    name = read_attribute(element, "name", where)
    where = f"{where}: joint '{name}'"
    kind = read_attribute(element, "type", where)
    if kind not in (*MOVABLE, "fixed"):
        raise RobotError(f"{where}: type '{kind}' is not supported; use {', '.join(MOVABLE)} or fixed")
    ends = {}
    for tag in ("parent", "child"):
        child = element.find(tag)
        if child is None:
            raise RobotError(f"{where}: lacks <{tag}>; name the {tag} link")
        ends[tag] = read_attribute(child, "link", where)
    axis_element = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0])
    if axis_element is not None:
        axis = parse_numbers(axis_element.get("xyz", "1 0 0"), 3, f"{where}: axis xyz")
    if kind != "fixed":
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise RobotError(f"{where}: axis is zero; give it a direction")
        axis = axis / length
    joint = Joint(name, ends["parent"], ends["child"], kind, parse_origin(element, where, notes), axis,
                  0.0, 0.0, np.inf, np.inf, None, None)  # fmt: skip
    if kind == "fixed":
        return joint
    unstated: list[str] = []
    joint = _with_limits(joint, element, where, notes, unstated)
    notes += unstated if is_robot else []
    return _with_dynamics(_with_soft_limits(joint, element, where, notes), element, where)


def follow_leaders(joints: dict[str, Joint], where: str, notes: list[str]) -> dict[str, Joint]:
    """Let each mimicking joint follow one that moves by itself, where it mimics another mimicking joint.

    A joint that mimics one that is unknown moves by itself, with a note.

    Raises:
        RobotError: a joint mimics itself.
    """
    followed = {}
    for name in list(joints):
        joint = joints[name]
        multiplier, offset, leader, passed = 1.0, 0.0, joint, [name]
        while leader.mimic is not None:
            above, ratio, shift = leader.mimic
            if above not in joints:
                notes.append(
                    f"joint '{leader.name}' mimics '{above}', which the file does not have: it moves by itself"
                )
                joints[leader.name] = leader = replace(leader, mimic=None)
                break
            if above in passed:
                raise RobotError(f"{where}: joint '{name}' mimics itself ({' > '.join([*passed, above])})")
            multiplier, offset = multiplier * ratio, offset + multiplier * shift
            leader = joints[above]
            passed.append(above)
        is_own = leader.name == name
        followed[name] = leader if is_own else replace(joint, mimic=(leader.name, multiplier, offset))
    return followed


def find_stopped_joints(joints: Iterable[Joint], notes: list[str]) -> dict[str, float]:
    """Return positions of joints that cannot move: velocity limit 0, or following a joint that is fixed.

    A follower's own velocity limit does not count: the joint that it follows moves it.
    """
    known = {joint.name: joint for joint in joints}
    stopped = {}
    for joint in known.values():
        if joint.kind not in MOVABLE:
            continue
        if joint.mimic is not None:
            leader, multiplier, offset = joint.mimic
            if multiplier == 0.0 or known[leader].kind not in MOVABLE:
                notes.append(f"joint '{joint.name}' follows '{leader}', which does not move it: fixed at {offset:g}")
                stopped[joint.name] = offset
        elif joint.velocity == 0.0:
            stopped[joint.name] = float(np.clip(0.0, joint.lower, joint.upper))
            notes.append(f"joint '{joint.name}' has a velocity limit of 0: fixed at {stopped[joint.name]:g}")
    return stopped


def check_strengths(joints: Iterable[Joint], notes: list[str]) -> None:
    """Add a note about each joint whose motor is weaker than its friction."""
    for joint in joints:
        if joint.kind in MOVABLE and joint.mimic is None and joint.friction > joint.effort > 0.0:
            unit = "N" if joint.kind == "prismatic" else "N m"
            notes.append(
                f"joint '{joint.name}': its friction of {joint.friction:g} {unit} is above its effort limit of "
                f"{joint.effort:g} {unit}, so that its motor could not move it; motions of it are not covered"
            )


def check_locked_positions(joints: Mapping[str, Joint], locked: Mapping[str, float], where: str) -> None:
    """Refuse positions of locked joints beyond their limits (RobotError)."""
    for name, position in locked.items():
        joint = joints.get(name)
        if joint is None or joint.kind not in MOVABLE or not np.isfinite(position):
            continue
        if joint.lower - LOCK_TOLERANCE <= position <= joint.upper + LOCK_TOLERANCE:
            continue
        turned = math.radians(position)
        is_in_degrees = joint.kind != "prismatic" and joint.lower <= turned <= joint.upper
        hint = f"; joints are in radians, are these degrees? Use {turned:.6g}" if is_in_degrees else ""
        raise RobotError(
            f"{where}: locked joint '{name}' at {position:g} is outside its limits; expected {joint.lower:g} to "
            f"{joint.upper:g}{hint}"
        )


def lock_joints(
    tree: etree._Element, joints: dict[str, Joint], locked: dict[str, float], where: str
) -> dict[str, Joint]:
    """Turn locked joints (and those that mimic them) into fixed ones, in the XML too.

    Raises:
        RobotError: a joint to lock is unknown or does not move, or its position is not finite.
    """
    movable = [name for name, joint in joints.items() if joint.kind in MOVABLE]
    for name, position in locked.items():
        if name not in movable:
            raise RobotError(
                f"{where}: locked joint '{name}' is not a movable joint; expected {would_do(name, movable) or 'none'}"
            )
        if not np.isfinite(position):
            raise RobotError(f"{where}: locked joint '{name}' at {position}; a finite position is needed")
    for joint in joints.values():
        if joint.mimic is None or joint.name in locked:
            continue
        leader, multiplier, offset = joint.mimic
        if leader in locked:
            locked[joint.name] = multiplier * locked[leader] + offset
    elements = {element.get("name"): element for element in tree.findall("joint")}
    for name, position in locked.items():
        joint = joints[name]
        motion = np.eye(4)
        if joint.kind == "prismatic":
            motion[:3, 3] = position * joint.axis
        else:
            motion[:3, :3] = axis_rotation(joint.axis, position)
        joints[name] = replace(joint, kind="fixed", pose_parent_joint=joint.pose_parent_joint @ motion, mimic=None)
        _fix_element(elements[name], joints[name].pose_parent_joint)
    return joints


def _with_limits(joint: Joint, element: etree._Element, where: str, notes: list[str], unstated: list[str]) -> Joint:
    limit = element.find("limit")
    lower, upper, velocity, effort = -np.inf, np.inf, np.inf, np.inf
    acceleration = None
    if limit is None and joint.kind != "continuous":
        raise RobotError(f"{where}: {joint.kind} but without <limit>; give lower, upper, velocity and effort")
    if limit is not None:
        # A follower without a range of its own goes as far as the joint that it follows.
        is_open = element.find("mimic") is not None and limit.get("lower") is None and limit.get("upper") is None
        if joint.kind != "continuous" and not is_open:
            lower, upper = _read_range(joint, limit, where, notes)
        velocity = _read_limit(limit, "velocity", where, unstated)
        effort = _read_limit(limit, "effort", where, unstated)
        if limit.get("acceleration") is not None:
            acceleration = parse_number(limit.get("acceleration", ""), f"{where}: limit acceleration")
    if lower > upper:
        raise RobotError(f"{where}: limit lower {lower:g} exceeds upper {upper:g}; swap them")
    if velocity < 0.0 or effort < 0.0 or (acceleration is not None and acceleration <= 0.0):
        raise RobotError(f"{where}: limit velocity and effort must not be negative, acceleration positive")
    mimic_element = element.find("mimic")
    mimic = None
    if mimic_element is not None:
        mimic = (read_attribute(mimic_element, "joint", where),
                 parse_number(mimic_element.get("multiplier", "1"), f"{where}: mimic multiplier"),
                 parse_number(mimic_element.get("offset", "0"), f"{where}: mimic offset"))  # fmt: skip
    return replace(joint, lower=lower, upper=upper, velocity=velocity, effort=effort,
                   acceleration=acceleration, mimic=mimic)  # fmt: skip


def _with_soft_limits(joint: Joint, element: etree._Element, where: str, notes: list[str]) -> Joint:
    """Return a joint that keeps the soft limits of its <safety_controller>; both at 0 count as not stated."""
    controller = element.find("safety_controller")
    if controller is None:
        return joint
    low, high = (
        parse_limit(controller.get(key, "0"), f"{where}: safety_controller {key}")
        for key in ("soft_lower_limit", "soft_upper_limit")
    )
    lower, upper = max(joint.lower, low), min(joint.upper, high)
    if low == high == 0.0 or (lower, upper) == (joint.lower, joint.upper):
        return joint
    if lower >= upper:
        notes.append(f"{where}: its soft limits of {low:g} to {high:g} leave it no range and do not count")
        return joint
    notes.append(f"{where}: the soft limits of its <safety_controller> count as its limits")
    return replace(joint, lower=lower, upper=upper, stops=(joint.lower, joint.upper))


def _with_dynamics(joint: Joint, element: etree._Element, where: str) -> Joint:
    """Return a joint with the friction and damping of its <dynamics>."""
    dynamics = element.find("dynamics")
    if dynamics is None:
        return joint
    friction, damping = (
        parse_number(dynamics.get(key) or "0", f"{where}: dynamics {key}") for key in ("friction", "damping")
    )
    if friction < 0.0 or damping < 0.0:
        raise RobotError(f"{where}: dynamics friction {friction:g} and damping {damping:g} must not be negative")
    return replace(joint, friction=friction, damping=damping)


def _read_range(joint: Joint, limit: etree._Element, where: str, notes: list[str]) -> tuple[float, float]:
    """Return lower and upper limit of a joint's position; add a note about limits that hardly can be meant."""
    lower, upper = (parse_limit(limit.get(key, "0"), f"{where}: limit {key}") for key in ("lower", "upper"))
    if lower <= -MOST_LIMIT and upper >= MOST_LIMIT:
        return -np.inf, np.inf
    if joint.mimic is None and lower == upper and limit.get(MADE_HERE) is None:
        notes.append(f"{where}: its limits are {lower:g} and {upper:g}, so that it does not move; state its range")
    unit, most, other = ("m", LONG_M, "millimetres") if joint.kind == "prismatic" else ("rad", MANY_RAD, "degrees")
    if limit.get(MADE_HERE) is None and max(abs(lower), abs(upper)) > most and max(-lower, upper) < np.inf:
        notes.append(f"{where}: limits of {lower:g} to {upper:g} {unit} are read as they are; are these {other}?")
    return lower, upper


def _read_limit(limit: etree._Element, key: str, where: str, notes: list[str]) -> float:
    """Return a limit of speed or force; infinity where the file does not state it, with a note unless it is ours."""
    text = limit.get(key)
    if text is None:
        if limit.get(MADE_HERE) is None:
            notes.append(f"{where}: no {key} limit is given; it counts as unlimited")
        return float(np.inf)
    return parse_number(text, f"{where}: limit {key}")


def _fix_element(element: etree._Element, pose: Float[np.ndarray, "4 4"]) -> None:
    element.set("type", "fixed")
    for child in list(element):
        if child.tag not in ("parent", "child"):
            element.remove(child)
    element.append(make_origin(pose))
