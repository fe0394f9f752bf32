"""Objects described by a URDF: their collision shapes with every joint at zero, in the root link's frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from costs.robot.elements.joints import MOVABLE
from costs.robot.errors import RobotError
from costs.robot.mesh import resolve_mesh
from costs.robot.shapes import make_points
from costs.robot.urdf import Urdf, parse_urdf
from costs.robot.xmlfile import parse_xml, read_xml_text

MAX_SHAPES = 256


@dataclass(frozen=True)
class StillShape:
    """One collision shape of an object.

    Attributes:
        where: its name in messages.
        points: (V, 3) whose hull contains a box, sphere, cylinder or capsule, in its own frame [m]; None for a mesh.
        mesh: its file; None for the others.
        scale: (3,) metres per unit of that file.
        pose_object_shape: (4, 4).
    """

    where: str
    points: Float[np.ndarray, "V 3"] | None
    mesh: Path | None
    scale: Float[np.ndarray, "3"]
    pose_object_shape: Float[np.ndarray, "4 4"]


def read_object_shapes(urdf: Path) -> tuple[StillShape, ...]:
    """Read the collision shapes of an object from its URDF, with every joint at zero.

    Meshes are read from inside the URDF's folder only.  A joint that mimics another follows it.

    Raises:
        RobotError: one line; the URDF is not valid, a joint cannot be at zero, or there are no shapes or too many.
    """
    where, text = urdf.name, read_xml_text(urdf)
    read = parse_urdf(text, where, dict.fromkeys(_find_free_joints(text, where), 0.0), is_robot=False)
    for joint in read.joints.values():
        if not joint.lower <= 0.0 <= joint.upper:
            raise RobotError(
                f"{where}: joint '{joint.name}' moves from {joint.lower:g} to {joint.upper:g} and is never at 0; "
                "describe the object with its joints fixed where they are"
            )
    poses = _compute_link_poses(read)
    link_shapes = [(link, shape) for link, shapes in read.links.items() for shape in shapes]
    if not link_shapes:
        raise RobotError(f"{where}: no link has a <collision>; an object needs one")
    if len(link_shapes) > MAX_SHAPES:
        raise RobotError(f"{where}: {len(link_shapes)} collision shapes; at most {MAX_SHAPES} are read")
    shapes = []
    for link, shape in link_shapes:
        inside, pose = f"{where}: link '{link}'", poses[link] @ shape.pose_link_shape
        if shape.kind == "mesh":
            _, path = resolve_mesh(shape.uri, (urdf.parent,), inside)
            shapes.append(StillShape(inside, None, path, shape.size, pose))
        else:
            shapes.append(StillShape(inside, make_points(shape.kind, shape.size), None, np.ones(3), pose))
    return tuple(shapes)


def _find_free_joints(text: str, where: str) -> list[str]:
    """Return the names of the joints that move by themselves; ``parse_urdf`` checks them."""
    joints = parse_xml(text, where, "robot").findall("joint")
    free = [joint.get("name") for joint in joints if joint.get("type") in MOVABLE and joint.find("mimic") is None]
    return [name for name in free if name]


def _compute_link_poses(urdf: Urdf) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Return the pose of each link in the root link's frame; all joints are fixed."""
    children: dict[str, list[str]] = {}
    for joint in urdf.joints.values():
        children.setdefault(joint.parent, []).append(joint.name)
    poses, todo = {urdf.root: np.eye(4)}, [urdf.root]
    while todo:
        link = todo.pop()
        for name in children.get(link, ()):
            joint = urdf.joints[name]
            poses[joint.child] = poses[link] @ joint.pose_parent_joint
            todo.append(joint.child)
    return poses
