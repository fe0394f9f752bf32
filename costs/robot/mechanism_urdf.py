"""Mechanisms described by a URDF: its moving links as a tree of joints in the world, its still ones as bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np
from jaxtyping import Float

from costs.names import would_do
from costs.primitive import Primitive, make_round_shape
from costs.robot import shapes
from costs.robot.circles import WHOLE_TURN
from costs.robot.elements.inertia import LinkInertia
from costs.robot.elements.joints import Joint
from costs.robot.elements.shapes import Shape
from costs.robot.errors import RobotError
from costs.robot.mechanism import MechanismJoint
from costs.robot.mesh import read_vertices, resolve_mesh
from costs.robot.mesh.hull import find_hull_vertices
from costs.robot.urdf import Urdf, parse_urdf

STOP_ROUNDING = 1e-3  # by which a joint may pass its stops [rad, m]
MOST_JOINTS = 16
MOST_BODIES = 64
DEFAULT_ACCELERATION = {"revolute": 2.0, "prismatic": 1.0}  # [rad/s^2, m/s^2]
FASTEST = {"revolute": 2.0, "prismatic": 0.5}  # of joints whose speed has no limit [rad/s, m/s]

Meshes = Mapping[str, Float[np.ndarray, "V 3"]]
"""Vertices of meshes by the name that the URDF gives them, in units of their file."""


@dataclass(frozen=True)
class LinkPlace:
    """A URDF's link in the mechanism.

    Attributes:
        link: the mechanism's link that it moves with; None for the world.
        pose: (4, 4) its frame in that link, or in the world.
        bodies: names of its convex bodies.
    """

    link: str | None
    pose: Float[np.ndarray, "4 4"]
    bodies: tuple[str, ...]


@dataclass(frozen=True)
class UrdfMechanism:
    """A mechanism read from a URDF.

    Attributes:
        joints: parents before children, named as in the URDF.
        still: vertices of the bodies that no joint moves, in the world, by name [m].
        links: the URDF's links by name.
        parents: per joint, the joint that carries it; None for the world.
        stops: per joint, where it cannot move on: lower and upper value; infinite where it has no stop [rad, m].
        notes: what the file leaves open or states in an unusual way, and how it is read.
    """

    joints: tuple[MechanismJoint, ...]
    still: Mapping[str, Float[np.ndarray, "V 3"]]
    links: Mapping[str, LinkPlace]
    parents: Mapping[str, str | None]
    stops: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]

    def list_carriers(self, joint: str) -> tuple[str, ...]:
        """Return a joint and the joints that carry it, the world's last."""
        carriers = [joint]
        while (above := self.parents[carriers[-1]]) is not None:
            carriers.append(above)
        return tuple(carriers)


def read_mechanism(
    text: str,
    where: str,
    name: str,
    still_name: str,
    pose_world_root: Float[np.ndarray, "4 4"],
    starts: Mapping[str, float],
    meshes: Meshes,
) -> UrdfMechanism:
    """Read a mechanism from the text of a URDF.

    Links joined by fixed joints are one link of the mechanism, named ``NAME/`` and the URDF's link below the moving
    joint. A continuous joint may turn by a whole turn from its start. Masses, friction and damping are the
    file's.

    Args:
        text: the URDF.
        where: names it in messages.
        name: of the mechanism, which begins the names of its links.
        still_name: begins the names of bodies that no joint moves.
        pose_world_root: (4, 4) the root link in the world.
        starts: value of joints at the start [rad, m]; others are at 0, or at the limit that is nearest to it.
        meshes: the vertices of each mesh.

    Raises:
        RobotError: one line: the URDF is not valid (a loop, an unknown link, a joint type that is not supported), no
            joint moves, a joint has no body, a joint of ``starts`` is unknown or would start past its limits.
    """
    urdf = parse_urdf(text, where, {}, is_robot=False)
    follower = next((joint for joint in urdf.joints.values() if joint.mimic is not None), None)
    if follower is not None:
        words = f"joint '{follower.name}' mimics '{follower.mimic[0] if follower.mimic else ''}'"
        raise RobotError(f"{where}: {words}, which is not supported in a mechanism; make it a fixed joint")
    moving = [joint for joint in urdf.joints.values() if joint.kind != "fixed"]
    if not moving:
        raise RobotError(f"{where}: no joint moves; a mechanism has at least one revolute or prismatic joint")
    if len(moving) > MOST_JOINTS:
        raise RobotError(f"{where}: {len(moving)} joints move; expected at most {MOST_JOINTS}")
    for given in starts:
        if given not in {known.name for known in moving}:
            names = would_do(given, [known.name for known in moving])
            raise RobotError(f"joints.{given}: unknown joint; the mechanism moves {names}")
    poses, owners = _place_links(urdf, pose_world_root)
    bodies = _make_bodies(urdf, poses, meshes, where)
    round_shapes = _make_round_shapes(urdf, poses)
    joints: list[MechanismJoint] = []
    places: dict[str, LinkPlace] = {}
    parents: dict[str, str | None] = {}
    for joint in _sort_joints(urdf):
        owner = owners[joint.parent]
        parents[joint.name] = owner
        link = f"{name}/{joint.child}"
        own = {
            member: _name_bodies(f"{link}/{member}", bodies[member])
            for member, mover in owners.items()
            if mover == joint.name
        }
        named = {body: points for parts in own.values() for body, points in parts.items()}
        exact = {
            body: shape
            for member, parts in own.items()
            for body, shape in zip(parts, round_shapes[member], strict=True)
            if shape is not None
        }
        if not named:
            raise RobotError(f"{where}: link '{joint.child}' has no <collision>; what a joint moves needs a shape")
        origin, turned = poses[joint.child][:3, 3], poses[joint.child][:3, :3]
        lower, upper, start = _read_range(joint, starts.get(joint.name))
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        joints.append(
            MechanismJoint(
                joint.name,
                link,
                origin,
                turned @ joint.axis,
                named,
                kind=kind,  # type: ignore[arg-type]
                parent=None if owner is None else f"{name}/{urdf.joints[owner].child}",
                lower=lower - STOP_ROUNDING,
                upper=upper + STOP_ROUNDING,
                start=start,
                velocity=min(joint.velocity, FASTEST[kind]) if np.isinf(joint.velocity) else joint.velocity,
                acceleration=DEFAULT_ACCELERATION[kind] if joint.acceleration is None else joint.acceleration,
                exact=exact,
                inertia=_join_inertias(urdf, poses, own),
                friction=joint.friction,
                damping=joint.damping,
            )
        )
        for member, parts in own.items():
            pose = poses[member].copy()
            pose[:3, 3] -= origin  # the frame of the mechanism's link has the world's axes at 0
            places[member] = LinkPlace(link, pose, tuple(parts))
    still: dict[str, Float[np.ndarray, "V 3"]] = {}
    for member in [member for member, mover in owners.items() if mover is None]:
        parts = _name_bodies(f"{still_name}/{member}", bodies[member])
        still |= parts
        places[member] = LinkPlace(None, poses[member], tuple(parts))
    stops = {joint.name: (joint.lower, joint.upper) if joint.stops is None else joint.stops for joint in moving}
    return UrdfMechanism(tuple(joints), still, places, parents, stops, urdf.notes)


def _join_inertias(
    urdf: Urdf, poses: Mapping[str, Float[np.ndarray, "4 4"]], members: Iterable[str]
) -> LinkInertia | None:
    """Return the mass of links that move together, in the world with all joints at 0; None if they have none."""
    parts = [urdf.inertias[member].move(poses[member]) for member in members if member in urdf.inertias]
    return reduce(LinkInertia.join, parts) if parts else None


def _name_bodies(link: str, bodies: Sequence[Float[np.ndarray, "V 3"]]) -> dict[str, Float[np.ndarray, "V 3"]]:
    return {f"{link}.{k}" if k else link: points for k, points in enumerate(bodies)}


def read_mesh_hulls(text: str, where: str, folder: Path) -> dict[str, Float[np.ndarray, "V 3"]]:
    """Read the convex hull's vertices of every mesh that a URDF's collision shapes name, in units of their files.

    Raises:
        RobotError: one line; the URDF is not valid, or a mesh is outside the folder, missing or cannot be used.
    """
    return _read_hulls(
        parse_urdf(text, where, {}, is_robot=False),
        where,
        lambda uri, inside: read_vertices(resolve_mesh(uri, (folder,), inside)[1], inside),
    )


def _read_hulls(
    urdf: Urdf, where: str, read: Callable[[str, str], Float[np.ndarray, "V 3"]]
) -> dict[str, Float[np.ndarray, "V 3"]]:
    hulls: dict[str, Float[np.ndarray, "V 3"]] = {}
    for link, link_shapes in urdf.links.items():
        for shape in link_shapes:
            if shape.kind == "mesh" and shape.uri not in hulls:
                inside = f"{where}: link '{link}'"
                hulls[shape.uri] = find_hull_vertices(read(shape.uri, inside), inside)
    return hulls


def _place_links(
    urdf: Urdf, pose_world_root: Float[np.ndarray, "4 4"]
) -> tuple[dict[str, Float[np.ndarray, "4 4"]], dict[str, str | None]]:
    """Return per link its pose in the world with all joints at 0, and the joint that it moves with."""
    poses = {urdf.root: pose_world_root}
    owners: dict[str, str | None] = {urdf.root: None}
    for joint in _sort_joints(urdf, with_fixed=True):
        poses[joint.child] = poses[joint.parent] @ joint.pose_parent_joint
        owners[joint.child] = owners[joint.parent] if joint.kind == "fixed" else joint.name
    return poses, owners


def _sort_joints(urdf: Urdf, *, with_fixed: bool = False) -> Sequence[Joint]:
    """Return the joints, parents before children."""
    children: dict[str, list[Joint]] = {}
    for joint in urdf.joints.values():
        children.setdefault(joint.parent, []).append(joint)
    found: list[Joint] = []
    todo = [urdf.root]
    while todo:
        for joint in children.get(todo.pop(0), ()):
            found.append(joint)
            todo.append(joint.child)
    return [joint for joint in found if with_fixed or joint.kind != "fixed"]


def _make_bodies(
    urdf: Urdf, poses: Mapping[str, Float[np.ndarray, "4 4"]], meshes: Meshes, where: str
) -> dict[str, list[Float[np.ndarray, "V 3"]]]:
    """Return per link the vertices of its convex bodies, in the world with all joints at 0 [m]."""
    count = sum(len(link_shapes) for link_shapes in urdf.links.values())
    if count > MOST_BODIES:
        raise RobotError(f"{where}: {count} collision shapes; expected at most {MOST_BODIES}")
    bodies: dict[str, list[Float[np.ndarray, "V 3"]]] = {}
    for link, link_shapes in urdf.links.items():
        inside = f"{where}: link '{link}'"
        placed = [(_make_points(shape, meshes, inside), poses[link] @ shape.pose_link_shape) for shape in link_shapes]
        bodies[link] = [find_hull_vertices(points @ pose[:3, :3].T + pose[:3, 3], inside) for points, pose in placed]
    return bodies


def _make_round_shapes(urdf: Urdf, poses: Mapping[str, Float[np.ndarray, "4 4"]]) -> dict[str, list[Primitive | None]]:
    """Return per link the round shapes that its convex bodies contain, in the world with all joints at 0."""
    placed: dict[str, list[Primitive | None]] = {}
    for link, link_shapes in urdf.links.items():
        made = [make_round_shape(shape.kind, shape.size) for shape in link_shapes]
        placed[link] = [
            None if exact is None else exact.move(poses[link] @ shape.pose_link_shape)
            for exact, shape in zip(made, link_shapes, strict=True)
        ]
    return placed


def _make_points(shape: Shape, meshes: Meshes, where: str) -> Float[np.ndarray, "V 3"]:
    if shape.kind != "mesh":
        return shapes.make_points(shape.kind, shape.size)
    if shape.uri not in meshes:
        raise RobotError(f"{where}: mesh '{shape.uri}' is not given; expected its points in meshes, or a file")
    return np.asarray(meshes[shape.uri] * shape.size)


def _read_range(joint: Joint, start: float | None) -> tuple[float, float, float]:
    """Return lower and upper limit, and the start [rad, m]."""
    if joint.kind == "continuous":
        at = min(max(0.0, joint.lower), joint.upper) if start is None else start
        lower, upper = max(joint.lower, at - WHOLE_TURN), min(joint.upper, at + WHOLE_TURN)
        check_limits(joint.kind, at, lower, upper, f"joints.{joint.name}.start")
        return lower, upper, at
    at = min(max(0.0, joint.lower), joint.upper) if start is None else start
    check_limits(joint.kind, at, joint.lower, joint.upper, f"joints.{joint.name}.start")
    return joint.lower, joint.upper, at


def check_limits(kind: str, value: float, lower: float, upper: float, where: str) -> None:
    """Refuse a value past the limits of a joint [rad, m].

    Raises:
        RobotError: one line with value and limits.
    """
    if not lower <= value <= upper:
        unit = "m" if kind == "prismatic" else "rad"
        raise RobotError(f"{where}: {value:g} {unit} is past the limits of the joint, {lower:g} to {upper:g} {unit}")
