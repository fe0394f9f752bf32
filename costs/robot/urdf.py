"""What a URDF says, checked: links with their collision shapes, joints with their limits, one tree."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.robot.errors import RobotError, suggest
from costs.robot.xmlfile import number, numbers, parse_xml, required

MAX_LINKS = 512
MAX_DEPTH = 128
MOVABLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class Shape:
    """One <collision> element.

    Attributes:
        kind: ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``.
        size: box: full edge lengths (3,); sphere: radius; cylinder and capsule: radius, length along z (a capsule's
            without its caps); mesh: scale (3,) [m, -].
        uri: the mesh as the URDF names it ("" otherwise).
        pose_link_shape: (4, 4).
        element: the <geometry> child it came from.
    """

    kind: str
    size: Float[np.ndarray, "k"]
    uri: str
    pose_link_shape: Float[np.ndarray, "4 4"]
    element: etree._Element


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
    name = required(tree, "name", where)
    link_elements = tree.findall("link")
    if not link_elements:
        raise RobotError(f"{where}: no <link>; a robot has at least one")
    if len(link_elements) > MAX_LINKS:
        raise RobotError(f"{where}: {len(link_elements)} links; at most {MAX_LINKS} are read")
    _refuse_repeated(where, "link", [required(element, "name", where) for element in link_elements])
    _refuse_repeated(where, "joint", [required(element, "name", where) for element in tree.findall("joint")])
    joints = {}
    for element in tree.findall("joint"):
        joint = _parse_joint(element, where)
        joints[joint.name] = joint
    joints = _lock(tree, joints, dict(locked_joints), where)
    links = {}
    for element in link_elements:
        link = required(element, "name", where)
        _check_inertia(element, f"{where}: link '{link}'")
        links[link] = tuple(_parse_shape(shape, f"{where}: link '{link}'") for shape in element.findall("collision"))
    return Urdf(name, tree, _check_tree(links, joints, where), links, joints)


def pinocchio_xml(urdf: Urdf) -> str:
    """The URDF as pinocchio may see it: no meshes, and continuous joints as revolute ones.

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
        element.append(_origin_element(joint.pose_parent_joint))
        if joint.kind in MOVABLE:
            etree.SubElement(element, "axis", xyz=_join(joint.axis))
            lower, upper = np.clip([joint.lower, joint.upper], -1e6, 1e6)
            etree.SubElement(element, "limit", lower=repr(float(lower)), upper=repr(float(upper)),
                             velocity=repr(joint.velocity), effort=repr(joint.effort))  # fmt: skip
    return str(etree.tostring(robot, encoding="unicode"))


def urdf_text(urdf: Urdf) -> str:
    """The URDF as text, with joints locked as asked."""
    return str(etree.tostring(urdf.tree, encoding="unicode"))


def rpy_matrix(rpy: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation of URDF's fixed-axis roll, pitch, yaw [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                     [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                     [-sp, cp * sr, cp * cr]])  # fmt: skip


def matrix_rpy(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Fixed-axis roll, pitch, yaw [rad] of a rotation; at pitch +-90 degrees the roll is put to 0."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if abs(rotation[2, 0]) > 1.0 - 1e-12:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


def _refuse_repeated(where: str, tag: str, names: list[str]) -> None:
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise RobotError(f"{where}: {tag} name '{repeated[0]}' is used twice; names must be unique")
    for name in names:
        if name in ("universe", "root_joint"):
            raise RobotError(f"{where}: {tag} name '{name}' is reserved; rename it")


def _parse_pose(element: etree._Element, where: str) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        pose[:3, 3] = numbers(origin.get("xyz", "0 0 0"), 3, f"{where}: origin xyz")
        pose[:3, :3] = rpy_matrix(numbers(origin.get("rpy", "0 0 0"), 3, f"{where}: origin rpy"))
    return pose


def _parse_joint(element: etree._Element, where: str) -> Joint:
    name = required(element, "name", where)
    where = f"{where}: joint '{name}'"
    kind = required(element, "type", where)
    if kind not in (*MOVABLE, "fixed"):
        raise RobotError(f"{where}: type '{kind}' is not supported; use {', '.join(MOVABLE)} or fixed")
    ends = {}
    for tag in ("parent", "child"):
        child = element.find(tag)
        if child is None:
            raise RobotError(f"{where}: lacks <{tag}>; name the {tag} link")
        ends[tag] = required(child, "link", where)
    axis_element = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0])
    if axis_element is not None:
        axis = numbers(axis_element.get("xyz", "1 0 0"), 3, f"{where}: axis xyz")
    if kind != "fixed":
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise RobotError(f"{where}: axis is zero; give it a direction")
        axis = axis / length
    joint = Joint(name, ends["parent"], ends["child"], kind, _parse_pose(element, where), axis,
                  0.0, 0.0, np.inf, np.inf, None, None)  # fmt: skip
    return joint if kind == "fixed" else _with_limits(joint, element, where)


def _with_limits(joint: Joint, element: etree._Element, where: str) -> Joint:
    limit = element.find("limit")
    lower, upper, velocity, effort = -np.inf, np.inf, np.inf, np.inf
    acceleration = None
    if limit is None and joint.kind != "continuous":
        raise RobotError(f"{where}: {joint.kind} but without <limit>; give lower, upper, velocity and effort")
    if limit is not None:
        if joint.kind != "continuous":
            lower = number(limit.get("lower", "0"), f"{where}: limit lower")
            upper = number(limit.get("upper", "0"), f"{where}: limit upper")
        velocity = number(required(limit, "velocity", where), f"{where}: limit velocity")
        effort = number(required(limit, "effort", where), f"{where}: limit effort")
        if limit.get("acceleration") is not None:
            acceleration = number(limit.get("acceleration", ""), f"{where}: limit acceleration")
    if lower > upper:
        raise RobotError(f"{where}: limit lower {lower:g} exceeds upper {upper:g}; swap them")
    if velocity <= 0.0 or effort < 0.0 or (acceleration is not None and acceleration <= 0.0):
        raise RobotError(f"{where}: limit velocity and acceleration must be positive, effort not negative")
    mimic_element = element.find("mimic")
    mimic = None
    if mimic_element is not None:
        mimic = (required(mimic_element, "joint", where),
                 number(mimic_element.get("multiplier", "1"), f"{where}: mimic multiplier"),
                 number(mimic_element.get("offset", "0"), f"{where}: mimic offset"))  # fmt: skip
    return replace(joint, lower=lower, upper=upper, velocity=velocity, effort=effort,
                   acceleration=acceleration, mimic=mimic)  # fmt: skip


def _lock(tree: etree._Element, joints: dict[str, Joint], locked: dict[str, float], where: str) -> dict[str, Joint]:
    """Turn locked joints (and those that mimic them) into fixed ones, in the XML too; refuse what still mimics."""
    movable = [name for name, joint in joints.items() if joint.kind in MOVABLE]
    for name, position in locked.items():
        if name not in movable:
            raise RobotError(f"{where}: locked joint '{name}' is not a movable joint; {suggest(name, movable)}")
        if not np.isfinite(position):
            raise RobotError(f"{where}: locked joint '{name}' at {position}; a finite position is needed")
    for joint in joints.values():
        if joint.mimic is None or joint.name in locked:
            continue
        leader, multiplier, offset = joint.mimic
        if leader not in locked:
            raise RobotError(
                f"{where}: joint '{joint.name}' mimics '{leader}', which is not supported; lock '{leader}' at a position"
            )
        locked[joint.name] = multiplier * locked[leader] + offset
    elements = {element.get("name"): element for element in tree.findall("joint")}
    for name, position in locked.items():
        joint = joints[name]
        motion = np.eye(4)
        if joint.kind == "prismatic":
            motion[:3, 3] = position * joint.axis
        else:
            motion[:3, :3] = _axis_rotation(joint.axis, position)
        joints[name] = replace(joint, kind="fixed", pose_parent_joint=joint.pose_parent_joint @ motion, mimic=None)
        _fix_element(elements[name], joints[name].pose_parent_joint)
    return joints


def _fix_element(element: etree._Element, pose: Float[np.ndarray, "4 4"]) -> None:
    element.set("type", "fixed")
    for child in list(element):
        if child.tag not in ("parent", "child"):
            element.remove(child)
    element.append(_origin_element(pose))


def _axis_rotation(axis: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3 3"]:
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)


def _origin_element(pose: Float[np.ndarray, "4 4"]) -> etree._Element:
    return etree.Element("origin", xyz=_join(pose[:3, 3]), rpy=_join(matrix_rpy(pose[:3, :3])))


def _join(values: Float[np.ndarray, "k"]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _parse_shape(element: etree._Element, where: str) -> Shape:
    geometry = element.find("geometry")
    if geometry is None or len(geometry) != 1:
        raise RobotError(f"{where}: <collision> needs a <geometry> with one shape in it")
    shape = geometry[0]
    kind, uri = str(shape.tag), ""
    if kind == "box":
        size = numbers(required(shape, "size", where), 3, f"{where}: box size")
    elif kind == "sphere":
        size = numbers(required(shape, "radius", where), 1, f"{where}: sphere radius")
    elif kind in ("cylinder", "capsule"):
        text = f"{required(shape, 'radius', where)} {required(shape, 'length', where)}"
        size = numbers(text, 2, f"{where}: {kind} radius and length")
    elif kind == "mesh":
        uri = required(shape, "filename", where)
        size = numbers(shape.get("scale", "1 1 1"), 3, f"{where}: mesh scale")
    else:
        raise RobotError(f"{where}: shape <{kind}> is not known; use box, sphere, cylinder, capsule or mesh")
    if kind == "mesh" and np.any(size == 0.0):
        raise RobotError(f"{where}: mesh scale {shape.get('scale')!r} flattens the mesh; no factor may be 0")
    if kind != "mesh" and np.any(size <= 0.0):
        raise RobotError(f"{where}: {kind} of size {_join(size)}; every length must be positive")
    return Shape(kind, size, uri, _parse_pose(element, where), shape)


def _check_inertia(element: etree._Element, where: str) -> None:
    inertial = element.find("inertial")
    if inertial is None:
        return
    _parse_pose(inertial, f"{where}: inertial")
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    if mass is None or inertia is None:
        raise RobotError(f"{where}: <inertial> needs <mass> and <inertia>")
    if number(required(mass, "value", where), f"{where}: mass") < 0.0:
        raise RobotError(f"{where}: mass {mass.get('value')} is negative")
    for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
        number(required(inertia, key, where), f"{where}: inertia {key}")


def _check_tree(links: Mapping[str, object], joints: Mapping[str, Joint], where: str) -> str:
    """Name of the root link of what must be one tree of bounded depth."""
    parents: dict[str, str] = {}
    children: dict[str, list[str]] = {link: [] for link in links}
    for joint in joints.values():
        for tag, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise RobotError(f"{where}: joint '{joint.name}': unknown {tag} link '{link}'; {suggest(link, links)}")
        if joint.child in parents:
            raise RobotError(f"{where}: link '{joint.child}' has two parent joints; a robot is a tree")
        parents[joint.child] = joint.parent
        children[joint.parent].append(joint.child)
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        found = ", ".join(f"'{root}'" for root in roots[:4]) or "none (the joints form a loop)"
        raise RobotError(f"{where}: one root link is needed, found {found}")
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
