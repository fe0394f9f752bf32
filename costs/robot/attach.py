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
from costs.robot.elements.inertia import LinkInertia, spread_mass
from costs.robot.errors import RobotError
from costs.robot.load import build_pinocchio_model, find_body_frame
from costs.robot.mesh import read_vertices
from costs.robot.mesh.hull import find_hull_vertices, make_outer_hull
from costs.robot.mesh.kept import find_kept_folder, keep_triangles
from costs.robot.model import LinkBody, RobotModel, RobotSource
from costs.robot.poses import format_numbers, make_origin
from costs.robot.self_pairs import find_same_joint_pairs, sort_pair
from costs.robot.srdf import format_srdf
from costs.robot.urdf import format_urdf, parse_urdf
from costs.robot.xmlfile import parse_xml


@dataclass(frozen=True)
class AttachedBody:
    """A body fixed to a link: a simple shape about its centre, or convex parts.

    Attributes:
        name: its link's name in the robot it becomes part of.
        link: the link that carries it.
        pose_link_body: (4, 4) of its frame in that link.
        kind: ``box``, ``sphere``, ``cylinder`` (along z) or ``parts``.
        size: box: full edge lengths (3,); sphere: radius; cylinder: radius, length; parts: empty [m].
        mass: spread evenly [kg].
        touching: further links that hold it, not checked against it.
        parts: (V, 3) corners of each convex part in its frame [m].
    """

    name: str
    link: str
    pose_link_body: Float[np.ndarray, "4 4"]
    kind: Literal["box", "sphere", "cylinder", "parts"]
    size: tuple[float, ...]
    mass: float = 0.0
    touching: tuple[str, ...] = ()
    parts: tuple[Float[np.ndarray, "V 3"], ...] = ()


def with_attached(robot: RobotModel, attached: Sequence[AttachedBody]) -> RobotModel:
    """Return the robot with further bodies fixed to its links; its joints stay as they are.

    Raises:
        RobotError: a name in use, an unknown link, or a description that cannot be extended.
    """
    if not attached:
        return robot
    tree = parse_xml(robot.source.urdf, robot.name, "robot")
    files = {item.name: _keep_parts(item) for item in attached}
    for item in attached:
        _check_names(robot, item)
        tree.append(_make_link(item, files[item.name]))
        tree.append(_make_joint(item))
    urdf = parse_urdf(str(etree.tostring(tree, encoding="unicode")), robot.name, {})
    model = build_pinocchio_model(urdf, "floating" if robot.is_floating else "fixed", robot.name)
    bodies = list(robot.bodies)
    for item in attached:
        frame = find_body_frame(model, item.name)
        shape = make_round_shape(item.kind, item.size)
        exact = None if shape is None else shape.move(frame.placement.homogeneous)
        for index, vertices in enumerate(_place_parts(item, files[item.name], frame.placement.homogeneous)):
            outer = make_outer_hull(vertices) if exact is None else shapes.make_swept_hull(exact, vertices)
            name = item.name if index == 0 else f"{item.name}/{index}"
            bodies.append(LinkBody(name, item.name, int(frame.parentJoint), vertices, outer, exact))
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
        source=_add_files(robot.source, format_urdf(urdf), srdf, [file for names in files.values() for file in names]),
        ignored_reasons={pair: f"srdf ({word})" for pair, word in srdf_reasons.items()},
    )


def _check_names(robot: RobotModel, item: AttachedBody) -> None:
    links = {frame.name for frame in robot.model.frames}
    if item.name in links or item.name in {body.name for body in robot.bodies} | {"universe", "root_joint"}:
        raise RobotError(f"attached body '{item.name}': the name is in use by {robot.name}; choose another")
    for link in (item.link, *item.touching):
        if not robot.model.existFrame(link):
            raise RobotError(f"attached body '{item.name}': unknown link '{link}'; expected {would_do(link, links)}")


def _keep_parts(item: AttachedBody) -> list[str]:
    """Return names of mesh files with the hulls of the body's parts.

    Raises:
        RobotError: a part is flat, or the folder of kept files cannot be written.
    """
    from scipy.spatial import ConvexHull  # slow to import

    where = f"attached body '{item.name}'"
    corners = [find_hull_vertices(np.asarray(part), where) for part in item.parts]
    return [keep_triangles(points[ConvexHull(points).simplices]) for points in corners]


def _place_parts(
    item: AttachedBody, files: Sequence[str], pose: Float[np.ndarray, "4 4"]
) -> list[Float[np.ndarray, "V 3"]]:
    """Return the corners of the body's convex parts at a pose, as a reader of the robot's files finds them."""
    where = f"attached body '{item.name}'"
    if not files:
        points = shapes.make_points(item.kind, item.size)
        return [find_hull_vertices(points @ pose[:3, :3].T + pose[:3, 3], where)]
    read = [find_hull_vertices(read_vertices(find_kept_folder() / file, where), where) for file in files]
    return [points @ pose[:3, :3].T + pose[:3, 3] for points in read]


def _add_files(source: RobotSource, urdf: str, srdf: str, files: Sequence[str]) -> RobotSource:
    """Return the robot's texts with further kept mesh files beside its own."""
    if not files:
        return RobotSource(urdf, srdf, source.files, source.roots)
    folder = find_kept_folder()
    kept = {file: folder / file for file in files}
    return RobotSource(urdf, srdf, {**source.files, **kept}, (*source.roots, folder))


def _make_link(item: AttachedBody, files: Sequence[str]) -> etree._Element:
    """Make the body in its frame, with its mass if it has one."""
    link = etree.Element("link", name=item.name)
    if item.mass > 0.0:
        inertia = _spread_mass(item)
        inertial = etree.SubElement(link, "inertial")
        etree.SubElement(inertial, "mass", value=repr(float(item.mass)))
        inertial.append(make_origin(_at(inertia.centre)))
        moments = {f"i{'xyz'[k]}{'xyz'[j]}": repr(float(inertia.moments[k, j])) for k in range(3) for j in range(k, 3)}
        etree.SubElement(inertial, "inertia", moments)
    names: Mapping[str, Sequence[str]] = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}
    values = (
        [format_numbers(np.array(item.size))] if item.kind == "box" else [repr(float(value)) for value in item.size]
    )
    for tag in ("visual", "collision"):
        for file in files:
            etree.SubElement(etree.SubElement(etree.SubElement(link, tag), "geometry"), "mesh", filename=file)
        if not files:
            geometry = etree.SubElement(etree.SubElement(link, tag), "geometry")
            etree.SubElement(geometry, item.kind, dict(zip(names[item.kind], values, strict=True)))
    return link


def _at(place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose at a place, without a turn."""
    pose = np.eye(4)
    pose[:3, 3] = place
    return pose


def _spread_mass(item: AttachedBody) -> LinkInertia:
    """Return the inertia of an evenly filled body in its frame."""
    if item.parts:
        return spread_mass(item.parts, item.mass)
    size = np.array(item.size)
    if item.kind == "box":
        moments = (np.sum(size**2) - size**2) / 12.0
    elif item.kind == "sphere":
        moments = np.full(3, 0.4 * size[0] ** 2)
    else:
        across = (3.0 * size[0] ** 2 + size[1] ** 2) / 12.0
        moments = np.array([across, across, 0.5 * size[0] ** 2])
    return LinkInertia(item.mass, np.zeros(3), item.mass * np.diag(moments))


def _make_joint(item: AttachedBody) -> etree._Element:
    joint = etree.Element("joint", name=f"{item.name}_attached", type="fixed")
    etree.SubElement(joint, "parent", link=item.link)
    etree.SubElement(joint, "child", link=item.name)
    joint.append(make_origin(item.pose_link_body))
    return joint
