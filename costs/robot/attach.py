"""A robot with bodies that its links carry (a beam in its hands), as links of its own description.

They are written into the URDF and the SRDF that the robot brings along, so that whoever reads these files sees the same
robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.primitive import round_shape
from costs.robot import shapes
from costs.robot.errors import RobotError, suggest
from costs.robot.hull import hull_vertices, outer_hull
from costs.robot.load import body_frame, pinocchio_model
from costs.robot.model import LinkBody, RobotModel, RobotSource
from costs.robot.poses import joined, origin_element
from costs.robot.self_pairs import link_pair, same_joint_pairs
from costs.robot.urdf import parse_urdf, urdf_text
from costs.robot.xmlfile import parse_xml


@dataclass(frozen=True)
class AttachedBody:
    """A convex body fixed to a link.

    Attributes:
        name: its link's name in the robot it becomes part of.
        link: the link that carries it.
        pose_link_body: (4, 4) its centre in that link.
        kind: ``box``, ``sphere`` or ``cylinder`` (along z).
        size: box: full edge lengths (3,); sphere: radius; cylinder: radius, length [m].
        mass: spread evenly [kg].
        touching: further links that hold it, not checked against it.
    """

    name: str
    link: str
    pose_link_body: Float[np.ndarray, "4 4"]
    kind: Literal["box", "sphere", "cylinder"]
    size: tuple[float, ...]
    mass: float = 0.0
    touching: tuple[str, ...] = ()


def with_attached(robot: RobotModel, attached: Sequence[AttachedBody]) -> RobotModel:
    """The robot with further bodies fixed to its links; its joints stay as they are.

    Raises:
        RobotError: a name in use, an unknown link, or a description that cannot be extended.
    """
    if not attached:
        return robot
    tree = parse_xml(robot.source.urdf, robot.name, "robot")
    for one in attached:
        _check_names(robot, one)
        tree.append(_link_element(one))
        tree.append(_joint_element(one))
    urdf = parse_urdf(str(etree.tostring(tree, encoding="unicode")), robot.name, {})
    model = pinocchio_model(urdf, "floating" if robot.is_floating else "fixed", robot.name)
    bodies = list(robot.bodies)
    for one in attached:
        frame = body_frame(model, one.name)
        points = _points(one) @ frame.placement.rotation.T + frame.placement.translation
        vertices = hull_vertices(points, f"attached body '{one.name}'")
        given = round_shape(one.kind, one.size)
        exact = None if given is None else given.moved(frame.placement.homogeneous)
        outer = outer_hull(vertices) if exact is None else shapes.swept_hull(exact, vertices)
        bodies.append(LinkBody(one.name, one.name, int(frame.parentJoint), vertices, outer, exact))
    held = {link_pair(one.name, link) for one in attached for link in (one.link, *one.touching)}
    ignored = robot.ignored_pairs | same_joint_pairs(bodies) | held
    # They stand in its SRDF from now on.
    words = {"adjacent": "Adjacent", "same joint": "Adjacent", "derived": "Always"}
    said = {pair: robot.ignored_reasons.get(pair, "User").removeprefix("srdf").strip(" ()") for pair in ignored}
    said = {pair: words.get(word, word or "User") for pair, word in said.items()}
    still = {one.name for one in attached if int(body_frame(model, one.name).parentJoint) == 0}
    return replace(
        robot,
        model=model,
        bodies=tuple(bodies),
        ignored_pairs=ignored,
        fixed_links=robot.fixed_links | still,
        source=RobotSource(urdf_text(urdf), _srdf_text(robot, said), robot.source.files),
        ignored_reasons={pair: f"srdf ({word})" for pair, word in said.items()},
    )


def _check_names(robot: RobotModel, one: AttachedBody) -> None:
    links = {frame.name for frame in robot.model.frames}
    if one.name in links or one.name in {body.name for body in robot.bodies} | {"universe", "root_joint"}:
        raise RobotError(f"attached body '{one.name}': the name is in use by {robot.name}; choose another")
    for link in (one.link, *one.touching):
        if not robot.model.existFrame(link):
            raise RobotError(f"attached body '{one.name}': unknown link '{link}'; {suggest(link, links)}")


def _points(one: AttachedBody) -> Float[np.ndarray, "V 3"]:
    match one.kind:
        case "box":
            return shapes.box(np.array(one.size))
        case "sphere":
            return shapes.sphere(one.size[0])
        case "cylinder":
            return shapes.cylinder(*one.size)


def _link_element(one: AttachedBody) -> etree._Element:
    """The body about its centre, with its mass if it has one."""
    link = etree.Element("link", name=one.name)
    if one.mass > 0.0:
        inertial = etree.SubElement(link, "inertial")
        etree.SubElement(inertial, "mass", value=repr(float(one.mass)))
        inertial.append(origin_element(np.eye(4)))
        ixx, iyy, izz = (repr(float(value)) for value in one.mass * _gyration(one))
        etree.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    names: Mapping[str, Sequence[str]] = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}
    values = [joined(np.array(one.size))] if one.kind == "box" else [repr(float(value)) for value in one.size]
    for tag in ("visual", "collision"):
        geometry = etree.SubElement(etree.SubElement(link, tag), "geometry")
        etree.SubElement(geometry, one.kind, dict(zip(names[one.kind], values, strict=True)))
    return link


def _gyration(one: AttachedBody) -> Float[np.ndarray, "3"]:
    """Moments of inertia about the centre of an evenly filled body of 1 kg [m^2]."""
    size = np.array(one.size)
    if one.kind == "box":
        return np.asarray((np.sum(size**2) - size**2) / 12.0)
    if one.kind == "sphere":
        return np.full(3, 0.4 * size[0] ** 2)
    across = (3.0 * size[0] ** 2 + size[1] ** 2) / 12.0
    return np.array([across, across, 0.5 * size[0] ** 2])


def _joint_element(one: AttachedBody) -> etree._Element:
    joint = etree.Element("joint", name=f"{one.name}_attached", type="fixed")
    etree.SubElement(joint, "parent", link=one.link)
    etree.SubElement(joint, "child", link=one.name)
    joint.append(origin_element(one.pose_link_body))
    return joint


def _srdf_text(robot: RobotModel, said: Mapping[tuple[str, str], str]) -> str:
    """The robot's SRDF (or a new one) that lists every pair which is not checked, with a reason each."""
    source = robot.source.srdf or f'<robot name="{robot.name}"/>'
    tree = parse_xml(source, robot.name, "robot")
    for element in tree.findall("disable_collisions"):
        tree.remove(element)
    for (first, second), reason in sorted(said.items()):
        etree.SubElement(tree, "disable_collisions", link1=first, link2=second, reason=reason)
    return str(etree.tostring(tree, encoding="unicode"))
