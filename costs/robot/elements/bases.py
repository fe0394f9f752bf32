"""Joints of mobile and flying bases, rewritten: ``planar`` as three joints, ``floating`` left out.

A robot that a request puts on a plane gets a planar joint of its own below its root link.
"""

from __future__ import annotations

import numpy as np
from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.model import PLANAR_NAMES
from costs.robot.poses import format_numbers
from costs.robot.xmlfile import MADE_HERE, parse_numbers, read_attribute

PLANAR_RANGE_M = 10.0
PLANAR_VELOCITY = 1.0  # of a joint without limits [m/s, rad/s]
PLANAR_ACCELERATION = 1.0  # [m/s^2, rad/s^2]
PLANE_LINK = "base_plane"
ROLLS = "rolls"  # attribute of the turning joint of a base that cannot slide sideways


def expand_bases(tree: etree._Element, where: str, notes: list[str]) -> None:
    """Rewrite the planar and floating joints of a URDF's tree, in place; add a note for each.

    A planar joint ``base`` becomes the sliding joints ``base_x`` and ``base_y`` and the turning joint ``base_yaw``. A
    floating joint between a bare root link and the robot is removed with that link: how the base moves is what the
    request's ``robot.root`` says.

    Raises:
        RobotError: a floating joint elsewhere.
    """
    for joint in tree.findall("joint"):
        kind = joint.get("type")
        if kind == "planar":
            _split_planar(tree, joint, where, notes)
        elif kind == "floating":
            _drop_floating(tree, joint, where, notes)


def put_on_plane(tree: etree._Element, where: str, notes: list[str], *, rolls: bool = False) -> None:
    """Let the robot's root link slide and turn on the world's ground plane, by joints of its own, in place.

    The joints are ``base_x``, ``base_y`` and ``base_yaw``; of a base that ``rolls`` on wheels the last one says so.  A
    tree without a single root is left as it is.

    Raises:
        RobotError: the URDF itself has a planar joint at its root.
    """
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    roots = [name for link in tree.findall("link") if (name := link.get("name")) and name not in children]
    if len(roots) != 1:
        return
    for joint in tree.findall("joint"):
        parent = joint.find("parent")
        if joint.get("type") == "planar" and parent is not None and parent.get("link") == roots[0]:
            raise RobotError(
                f"{where}: joint '{joint.get('name')}' is a planar base already; leave robot.root out, or make it fixed"
            )
    etree.SubElement(tree, "link", name=PLANE_LINK)
    made = etree.SubElement(tree, "joint", name="base", type="planar")
    etree.SubElement(made, "parent", link=PLANE_LINK)
    etree.SubElement(made, "child", link=roots[0])
    etree.SubElement(made, "axis", xyz="0 0 1")
    _split_planar(tree, made, where, [])
    if rolls:
        next(joint for joint in tree.findall("joint") if joint.get("name") == PLANAR_NAMES[2]).set(ROLLS, "true")
    kind, names = "differential" if rolls else "planar", ", ".join(PLANAR_NAMES)
    notes.append(
        f"robot.root {kind}: {names} move the base on the plane z = 0, within {PLANAR_RANGE_M:g} m, "
        f"at most {PLANAR_VELOCITY:g} m/s and rad/s, {PLANAR_ACCELERATION:g} m/s^2 and rad/s^2"
    )


def _split_planar(tree: etree._Element, joint: etree._Element, where: str, notes: list[str]) -> None:
    name = read_attribute(joint, "name", where)
    inside = f"{where}: joint '{name}'"
    axis = joint.find("axis")
    normal = parse_numbers((axis.get("xyz") if axis is not None else None) or "1 0 0", 3, f"{inside}: axis xyz")
    if np.linalg.norm(normal) < 1e-6:
        raise RobotError(f"{inside}: axis is zero; give it a direction")
    normal = normal / np.linalg.norm(normal)
    # With a vertical normal these are x and y.
    along_x = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    along_x = along_x - (along_x @ normal) * normal
    along_x /= np.linalg.norm(along_x)
    limit = joint.find("limit")
    stated = {} if limit is None else dict(limit.attrib)
    speeds = {
        "velocity": stated.get("velocity") or repr(PLANAR_VELOCITY),
        "acceleration": stated.get("acceleration") or repr(PLANAR_ACCELERATION),
    }
    middle = [f"{name}_x_link", f"{name}_y_link"]
    parent, child = joint.find("parent"), joint.find("child")
    if parent is None or child is None:
        raise RobotError(f"{inside}: lacks <parent> or <child>; name both links")
    chain = [parent.get("link", ""), *middle, child.get("link", "")]
    place = tree.index(joint)
    origin = joint.find("origin")
    tree.remove(joint)
    for k, (part, kind, direction) in enumerate(
        (("x", "prismatic", along_x), ("y", "prismatic", np.cross(normal, along_x)), ("yaw", "continuous", normal))
    ):
        made = etree.Element("joint", name=f"{name}_{part}", type=kind)
        etree.SubElement(made, "parent", link=chain[k])
        etree.SubElement(made, "child", link=chain[k + 1])
        if k == 0 and origin is not None:
            made.append(origin)
        etree.SubElement(made, "axis", xyz=format_numbers(direction))
        reach = {} if kind == "continuous" else {"lower": repr(-PLANAR_RANGE_M), "upper": repr(PLANAR_RANGE_M)}
        etree.SubElement(made, "limit", {**reach, **speeds, MADE_HERE: "true"})
        tree.insert(place + k, made)
    for link in middle:
        etree.SubElement(tree, "link", name=link)
    notes.append(
        f"the planar joint '{name}' is read as {name}_x, {name}_y (within {PLANAR_RANGE_M:g} m) and {name}_yaw"
    )


def _drop_floating(tree: etree._Element, joint: etree._Element, where: str, notes: list[str]) -> None:
    name = read_attribute(joint, "name", where)
    parent = joint.find("parent")
    above = "" if parent is None else parent.get("link", "")
    neighbours = [
        end
        for other in tree.findall("joint")
        if other is not joint
        for end in (other.find("parent"), other.find("child"))
        if end is not None and end.get("link") == above
    ]
    link = next((element for element in tree.findall("link") if element.get("name") == above), None)
    if link is None or neighbours or link.find("collision") is not None:
        raise RobotError(
            f"{where}: joint '{name}': a floating joint is read only between a bare root link and the robot; "
            "fix the joint, or make what it carries a URDF of its own"
        )
    tree.remove(joint)
    tree.remove(link)
    notes.append(f"the floating joint '{name}' is left out: `robot.root: floating` makes the base free")
