"""Bodies that a robot's links carry (a beam in its hands), added as links of the robot.

They are written into the robot's URDF and SRDF, so that readers of these files get the same robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from lxml import etree

from costs.names import would_do
from costs.primitive import make_round_shape
from costs.robot import shapes
from costs.robot.errors import RobotError
from costs.robot.load import build_pinocchio_model, find_body_frame
from costs.robot.mesh.hull import find_hull_vertices, make_outer_hull
from costs.robot.model import LinkBody, RobotModel, RobotSource
from costs.robot.poses import format_numbers, make_origin
from costs.robot.self_pairs import find_same_joint_pairs, sort_pair
from costs.robot.srdf import format_srdf
from costs.robot.urdf import format_urdf, parse_urdf
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
    """Return the robot with further bodies fixed to its links; its joints stay as they are.

    Raises:
        RobotError: a name in use, an unknown link, or a description that cannot be extended.
    """
    if not attached:
        return robot
    tree = parse_xml(robot.source.urdf, robot.name, "robot")
    for item in attached:
        _check_names(robot, item)
        tree.append(_make_link(item))
        tree.append(_make_joint(item))
    urdf = parse_urdf(str(etree.tostring(tree, encoding="unicode")), robot.name, {})
    model = build_pinocchio_model(urdf, "floating" if robot.is_floating else "fixed", robot.name)
    bodies = list(robot.bodies)
    for item in attached:
        frame = find_body_frame(model, item.name)
        points = shapes.make_points(item.kind, item.size) @ frame.placement.rotation.T + frame.placement.translation
        vertices = find_hull_vertices(points, f"attached body '{item.name}'")
        shape = make_round_shape(item.kind, item.size)
        exact = None if shape is None else shape.move(frame.placement.homogeneous)
        outer = make_outer_hull(vertices) if exact is None else shapes.make_swept_hull(exact, vertices)
        bodies.append(LinkBody(item.name, item.name, int(frame.parentJoint), vertices, outer, exact))
    held = {sort_pair(item.name, link) for item in attached for link in (item.link, *item.touching)}
    ignored = robot.ignored_pairs | find_same_joint_pairs(bodies) | held
    # The new SRDF lists them.
    words = {"adjacent": "Adjacent", "same joint": "Adjacent", "derived": "Always"}
    srdf_reasons = {pair: robot.ignored_reasons.get(pair, "User").removeprefix("srdf").strip(" ()") for pair in ignored}
    srdf_reasons = {pair: words.get(word, word or "User") for pair, word in srdf_reasons.items()}
    srdf = format_srdf(robot.source.srdf, robot.name, srdf_reasons)
    still = {item.name for item in attached if int(find_body_frame(model, item.name).parentJoint) == 0}
    return replace(
        robot,
        model=model,
        bodies=tuple(bodies),
        ignored_pairs=ignored,
        fixed_links=robot.fixed_links | still,
        source=RobotSource(format_urdf(urdf), srdf, robot.source.files, robot.source.roots),
        ignored_reasons={pair: f"srdf ({word})" for pair, word in srdf_reasons.items()},
    )


def _check_names(robot: RobotModel, item: AttachedBody) -> None:
    links = {frame.name for frame in robot.model.frames}
    if item.name in links or item.name in {body.name for body in robot.bodies} | {"universe", "root_joint"}:
        raise RobotError(f"attached body '{item.name}': the name is in use by {robot.name}; choose another")
    for link in (item.link, *item.touching):
        if not robot.model.existFrame(link):
            raise RobotError(f"attached body '{item.name}': unknown link '{link}'; expected {would_do(link, links)}")


def _make_link(item: AttachedBody) -> etree._Element:
    """Make the body about its centre, with its mass if it has one."""
    link = etree.Element("link", name=item.name)
    if item.mass > 0.0:
        inertial = etree.SubElement(link, "inertial")
        etree.SubElement(inertial, "mass", value=repr(float(item.mass)))
        inertial.append(make_origin(np.eye(4)))
        ixx, iyy, izz = (repr(float(value)) for value in item.mass * _compute_gyration(item))
        etree.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    names: Mapping[str, Sequence[str]] = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}
    values = (
        [format_numbers(np.array(item.size))] if item.kind == "box" else [repr(float(value)) for value in item.size]
    )
    for tag in ("visual", "collision"):
        geometry = etree.SubElement(etree.SubElement(link, tag), "geometry")
        etree.SubElement(geometry, item.kind, dict(zip(names[item.kind], values, strict=True)))
    return link


def _compute_gyration(item: AttachedBody) -> Float[np.ndarray, "3"]:
    """Return the moments of inertia about the centre of an evenly filled body of 1 kg [m^2]."""
    size = np.array(item.size)
    if item.kind == "box":
        return np.asarray((np.sum(size**2) - size**2) / 12.0)
    if item.kind == "sphere":
        return np.full(3, 0.4 * size[0] ** 2)
    across = (3.0 * size[0] ** 2 + size[1] ** 2) / 12.0
    return np.array([across, across, 0.5 * size[0] ** 2])


def _make_joint(item: AttachedBody) -> etree._Element:
    joint = etree.Element("joint", name=f"{item.name}_attached", type="fixed")
    etree.SubElement(joint, "parent", link=item.link)
    etree.SubElement(joint, "child", link=item.name)
    joint.append(make_origin(item.pose_link_body))
    return joint
