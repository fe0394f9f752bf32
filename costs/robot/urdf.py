"""Content of a URDF, checked: links with their collision shapes, joints with their limits, one tree."""

from __future__ import annotations

import copy
import re
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath

import numpy as np
from lxml import etree

from costs.names import would_do
from costs.robot.elements.bases import expand_bases, put_on_plane
from costs.robot.elements.inertia import LinkInertia, parse_inertial
from costs.robot.elements.joints import (
    DEFAULT_VELOCITY,
    MOVABLE,
    Joint,
    check_locked_positions,
    check_strengths,
    find_stopped_joints,
    follow_leaders,
    lock_joints,
    parse_joint,
)
from costs.robot.elements.shapes import Shape, parse_shape
from costs.robot.errors import RobotError
from costs.robot.poses import format_numbers, make_origin
from costs.robot.xmlfile import parse_xml, read_attribute

MAX_LINKS = 512
MAX_DEPTH = 128
MERGED = 3  # notes about more joints or links than this are merged into one


@dataclass(frozen=True)
class Urdf:
    """A checked URDF.

    Attributes:
        name: the robot's name.
        tree: its XML, after locking.
        root: name of the root link.
        links: collision shapes by link name, in file order.
        joints: joints by name, in file order.
        notes: what the file leaves open or states in an unusual way, and how it is read.
        inertias: masses by link name, in the link's frame; none where a link has no mass.
    """

    name: str
    tree: etree._Element
    root: str
    links: Mapping[str, tuple[Shape, ...]]
    joints: Mapping[str, Joint]
    notes: tuple[str, ...] = ()
    inertias: Mapping[str, LinkInertia] = field(default_factory=dict)


def parse_urdf(
    text: str,
    where: str,
    locked_joints: Mapping[str, float],
    drawn_links: Sequence[str] = (),
    *,
    is_robot: bool = True,
    is_planar: bool = False,
    rolls: bool = False,
    change: Callable[[Mapping[str, etree._Element], list[str]], None] | None = None,
) -> Urdf:
    """Read and check a URDF; ``locked_joints`` become fixed at the given position [rad or m].

    The drawn shapes of ``drawn_links`` that have no collision shape become collision shapes.  A robot may have planar
    and floating joints as its base, an object or mechanism may not.  With ``is_planar`` its root link gets a planar
    base, which ``rolls`` if it cannot slide sideways.  ``change`` may change the shapes of the <link> elements, which
    it gets by name with the notes.

    Raises:
        RobotError: for anything pinocchio would crash on, load from elsewhere or misread in silence.
    """
    tree = parse_xml(text, where, "robot")
    notes: list[str] = []
    name = (tree.get("name") or "").strip()
    if not name:
        name = PurePath(where).stem or "robot"
        tree.set("name", name)
        notes.append(f"the file does not name the robot; it is called '{name}'")
    if is_robot:
        if is_planar:
            put_on_plane(tree, where, notes, rolls=rolls)
        expand_bases(tree, where, notes)
    link_elements = tree.findall("link")
    if not link_elements:
        raise RobotError(f"{where}: no <link>; a robot has at least one")
    if len(link_elements) > MAX_LINKS:
        raise RobotError(f"{where}: {len(link_elements)} links; at most {MAX_LINKS} are read")
    link_names = [read_attribute(element, "name", where) for element in link_elements]
    joint_names = [read_attribute(element, "name", where) for element in tree.findall("joint")]
    _refuse_repeated(where, "link", link_names)
    _refuse_repeated(where, "joint", joint_names)
    _take_drawn_shapes(dict(zip(link_names, link_elements, strict=True)), drawn_links, where)
    if change is not None:
        change(dict(zip(link_names, link_elements, strict=True)), notes)
    joints = {}
    for element in tree.findall("joint"):
        joint = parse_joint(element, where, notes, is_robot=is_robot)
        joints[joint.name] = joint
    joints = follow_leaders(_give_speeds(joints, notes), where, notes)
    if is_robot:
        check_locked_positions(joints, locked_joints, where)
    joints = lock_joints(tree, joints, find_stopped_joints(joints.values(), notes) | dict(locked_joints), where)
    if is_robot:
        check_strengths(joints.values(), notes)
    links, inertias = {}, {}
    for element in link_elements:
        link = read_attribute(element, "name", where)
        inertia = parse_inertial(element, f"{where}: link '{link}'", notes, is_robot=is_robot)
        if inertia is not None and inertia.mass > 0.0:
            inertias[link] = inertia
        shapes = (parse_shape(shape, f"{where}: link '{link}'", notes) for shape in element.findall("collision"))
        links[link] = tuple(shape for shape in shapes if shape is not None)
    root = _check_tree(links, joints, where)
    shown = merge_notes([note.removeprefix(f"{where}: ") for note in notes])
    return Urdf(name, tree, root, links, joints, shown, inertias)


def _take_drawn_shapes(elements: Mapping[str, etree._Element], drawn_links: Sequence[str], where: str) -> None:
    """Give each of ``drawn_links`` without <collision> those of its <visual> elements (RobotError: it has none)."""
    for link in drawn_links:
        if link not in elements:
            raise RobotError(f"{where}: drawn link '{link}' is unknown; expected {would_do(link, elements)}")
        element = elements[link]
        if element.find("collision") is not None:
            continue
        drawn = element.findall("visual")
        if not drawn:
            raise RobotError(f"{where}: drawn link '{link}' has no <visual>; give it a <collision>")
        for visual in drawn:
            shape = copy.deepcopy(visual)
            shape.tag = "collision"
            for material in shape.findall("material"):
                shape.remove(material)
            element.append(shape)


def _give_speeds(joints: dict[str, Joint], notes: list[str]) -> dict[str, Joint]:
    """Give all joints a velocity limit where the file states 0 for each of them, which means nothing was stated."""
    moving = [joint for joint in joints.values() if joint.kind in MOVABLE and joint.mimic is None]
    if not moving or any(joint.velocity != 0.0 for joint in moving):
        return joints
    names = ", ".join([joint.name for joint in moving[:MERGED]] + ["..."] * (len(moving) > MERGED))
    notes.append(
        f"all velocity limits are 0 ({names}), which counts as not stated: {DEFAULT_VELOCITY:g} rad/s or m/s are used"
    )
    return {
        name: replace(joint, velocity=DEFAULT_VELOCITY) if joint.kind in MOVABLE else joint
        for name, joint in joints.items()
    }


def merge_notes(notes: Sequence[str]) -> tuple[str, ...]:
    """Merge notes that say the same about several joints or links."""
    same: dict[tuple[str, str], list[str]] = {}
    merged: dict[str, None] = {}
    for note in notes:
        found = re.fullmatch(r"(joint|link) '([^']*)':? (.*)", note)
        if found:
            same.setdefault((found[1], found[3]), []).append(found[2])
    for note in notes:
        found = re.fullmatch(r"(joint|link) '([^']*)':? (.*)", note)
        names = same[found[1], found[3]] if found else []
        if found is None or len(names) <= MERGED:
            merged[note] = None
        else:
            shown = ", ".join(names[:MERGED])
            merged[f"{found[1]}s {shown} and {len(names) - MERGED} more: {found[3]}"] = None
    return tuple(merged)


def make_pinocchio_xml(urdf: Urdf) -> str:
    """Format the URDF for pinocchio: no meshes, and continuous joints as revolute ones.

    A continuous joint would have nq == 2 (cosine and sine); as a revolute joint its angle is a plain number. Its
    unbounded limits are kept by the caller.
    """
    robot = etree.Element("robot", name=urdf.name)
    for element in urdf.tree.findall("link"):
        link = etree.SubElement(robot, "link", name=element.get("name") or "")
        inertial = element.find("inertial")
        if inertial is not None:
            link.append(etree.fromstring(etree.tostring(inertial)))
    for joint in urdf.joints.values():
        kind = "revolute" if joint.kind == "continuous" else joint.kind
        element = etree.SubElement(robot, "joint", name=joint.name, type=kind)
        etree.SubElement(element, "parent", link=joint.parent)
        etree.SubElement(element, "child", link=joint.child)
        element.append(make_origin(joint.pose_parent_joint))
        if joint.kind in MOVABLE:
            etree.SubElement(element, "axis", xyz=format_numbers(joint.axis))
            lower, upper = np.clip([joint.lower, joint.upper], -1e6, 1e6)
            velocity, effort = np.minimum([joint.velocity, joint.effort], 1e6)  # the caller knows the limits
            etree.SubElement(element, "limit", lower=repr(float(lower)), upper=repr(float(upper)),
                             velocity=repr(float(velocity)), effort=repr(float(effort)))  # fmt: skip
    return str(etree.tostring(robot, encoding="unicode"))


def format_urdf(urdf: Urdf) -> str:
    """Format the URDF as text, with the locked joints fixed."""
    return str(etree.tostring(urdf.tree, encoding="unicode"))


def _refuse_repeated(where: str, tag: str, names: list[str]) -> None:
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise RobotError(f"{where}: {tag} name '{repeated[0]}' is used twice; names must be unique")
    for name in names:
        if name in ("universe", "root_joint"):
            raise RobotError(f"{where}: {tag} name '{name}' is reserved; rename it")


def _check_tree(links: Mapping[str, object], joints: Mapping[str, Joint], where: str) -> str:
    """Name of the root link of what must be one tree of bounded depth."""
    parents: dict[str, str] = {}
    children: dict[str, list[str]] = {link: [] for link in links}
    for joint in joints.values():
        for tag, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise RobotError(
                    f"{where}: joint '{joint.name}': unknown {tag} link '{link}'; expected {would_do(link, links)}"
                )
        if joint.child in parents:
            raise RobotError(f"{where}: link '{joint.child}' has two parent joints; a robot is a tree")
        parents[joint.child] = joint.parent
        children[joint.parent].append(joint.child)
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        names = ", ".join(f"'{root}'" for root in roots[:4]) or "none (the joints form a loop)"
        raise RobotError(f"{where}: one root link is needed, found {names}")
    depth = {roots[0]: 0}
    queue = deque(roots)
    while queue:
        link = queue.popleft()
        for child in children[link]:
            depth[child] = depth[link] + 1
            if depth[child] > MAX_DEPTH:
                raise RobotError(
                    f"{where}: link '{child}' is deeper than {MAX_DEPTH} joints; chains that long are refused"
                )
            queue.append(child)
    if len(depth) != len(links):
        lost = next(link for link in links if link not in depth)
        raise RobotError(f"{where}: link '{lost}' is part of a loop; a robot is a tree")
    return roots[0]
