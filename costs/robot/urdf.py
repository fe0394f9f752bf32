"""Content of a URDF, checked: links with their collision shapes, joints with their limits, one tree."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from lxml import etree

from costs.names import would_do
from costs.robot.errors import RobotError
from costs.robot.poses import format_numbers, make_origin, parse_origin
from costs.robot.urdf_elements import MOVABLE, Joint, Shape, lock_joints, parse_joint, parse_shape
from costs.robot.xmlfile import parse_number, parse_xml, read_attribute

MAX_LINKS = 512
MAX_DEPTH = 128
INERTIA_ROUNDING = 1e-2  # of files that write few digits: principal moments this far below zero, of the largest


@dataclass(frozen=True)
class Urdf:
    """A checked URDF.

    Attributes:
        name: the robot's name.
        tree: its XML, after locking.
        root: name of the root link.
        links: collision shapes by link name, in file order.
        joints: joints by name, in file order.
    """

    name: str
    tree: etree._Element
    root: str
    links: Mapping[str, tuple[Shape, ...]]
    joints: Mapping[str, Joint]


def parse_urdf(text: str, where: str, locked_joints: Mapping[str, float]) -> Urdf:
    """Read and check a URDF; ``locked_joints`` become fixed at the given position [rad or m].

    Raises:
        RobotError: for anything pinocchio would crash on, load from elsewhere or misread in silence.
    """
    tree = parse_xml(text, where, "robot")
    name = read_attribute(tree, "name", where)
    link_elements = tree.findall("link")
    if not link_elements:
        raise RobotError(f"{where}: no <link>; a robot has at least one")
    if len(link_elements) > MAX_LINKS:
        raise RobotError(f"{where}: {len(link_elements)} links; at most {MAX_LINKS} are read")
    link_names = [read_attribute(element, "name", where) for element in link_elements]
    joint_names = [read_attribute(element, "name", where) for element in tree.findall("joint")]
    _refuse_repeated(where, "link", link_names)
    _refuse_repeated(where, "joint", joint_names)
    _refuse_shared(where, link_names, joint_names)
    joints = {}
    for element in tree.findall("joint"):
        joint = parse_joint(element, where)
        joints[joint.name] = joint
    joints = lock_joints(tree, joints, dict(locked_joints), where)
    links = {}
    for element in link_elements:
        link = read_attribute(element, "name", where)
        _check_inertia(element, f"{where}: link '{link}'")
        links[link] = tuple(parse_shape(shape, f"{where}: link '{link}'") for shape in element.findall("collision"))
    return Urdf(name, tree, _check_tree(links, joints, where), links, joints)


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
            etree.SubElement(element, "limit", lower=repr(float(lower)), upper=repr(float(upper)),
                             velocity=repr(joint.velocity), effort=repr(joint.effort))  # fmt: skip
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


def _refuse_shared(where: str, links: list[str], joints: list[str]) -> None:
    """Refuse joints that are named as links are: pinocchio could not tell their frames apart."""
    shared = sorted(set(links) & set(joints))
    if shared:
        raise RobotError(f"{where}: '{shared[0]}' is the name of a link and of a joint; rename the joint")


def _check_inertia(element: etree._Element, where: str) -> None:
    inertial = element.find("inertial")
    if inertial is None:
        return
    parse_origin(inertial, f"{where}: inertial")
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    if mass is None or inertia is None:
        raise RobotError(f"{where}: <inertial> needs <mass> and <inertia>")
    if parse_number(read_attribute(mass, "value", where), f"{where}: mass") < 0.0:
        raise RobotError(f"{where}: mass {mass.get('value')} is negative")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = {key: parse_number(read_attribute(inertia, key, where), f"{where}: inertia {key}") for key in keys}
    for key in ("ixx", "iyy", "izz"):
        if values[key] < 0.0:
            raise RobotError(f"{where}: inertia {key} is {values[key]:g}; a moment of inertia is never negative")
    ixx, ixy, ixz, iyy, iyz, izz = values.values()
    least, *_, most = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    if least < -INERTIA_ROUNDING * most:
        raise RobotError(
            f"{where}: inertia has the principal moments {least:.3g} to {most:.3g}; none may be negative: "
            "ixy, ixz or iyz is too large"
        )


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
