"""Surfaces of links: the triangles of their collision shapes, as the robot's files have them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from jaxtyping import Bool, Float, Int
from lxml import etree
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from costs.robot.elements.shapes import Shape, parse_shape
from costs.robot.errors import RobotError
from costs.robot.load import find_body_frame
from costs.robot.mesh.locate import resolve_mesh
from costs.robot.mesh.read import read_mesh
from costs.robot.model import LinkBody, RobotModel
from costs.robot.xmlfile import parse_xml

MOST_TRIANGLES = 40_000
"""Triangles of a link beyond which its surface is not read."""

_FINE_M = 0.03  # longest edge of triangles about the border of a ball
_RUN = 8  # triangles that follow each other are neighbours
_INSIDE = 0.25  # winding number from which a point counts as inside; of a closed surface it is 0 or 1


@dataclass(frozen=True, eq=False)
class LinkSurface:
    """Triangles of a link, in the frame of the joint that carries it.

    Attributes:
        joint: pinocchio joint.
        vertices: (V, 3) corners [m].
        triangles: (F, 3) indices of corners; those that follow each other are near each other.
        has_mesh: whether a mesh is among its shapes; otherwise it is no more than the hulls.
    """

    joint: int
    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]
    has_mesh: bool

    @cached_property
    def digest(self) -> str:
        """Hash of joint and triangles."""
        return sha256(b"%d " % self.joint + self.vertices.tobytes() + self.triangles.tobytes()).hexdigest()

    @cached_property
    def samples(self) -> Float[np.ndarray, "C 3"]:
        """One corner of each connected part."""
        a, b, c = self.triangles.T
        edges = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, c])), shape=2 * (len(self.vertices),))
        label = connected_components(edges, directed=False)[1]
        used = np.unique(self.triangles)
        return np.asarray(self.vertices[used[np.unique(label[used], return_index=True)[1]]])

    def beyond(self, centre: Float[np.ndarray, "3"], radius: float) -> LinkSurface:
        """Return the part of the surface that is not within a ball, and up to ``_FINE_M`` more of it.

        Triangles are split about the border of the ball.
        """
        vertices, todo, kept = self.vertices, self.triangles, [np.zeros((0, 3), dtype=np.int64)]
        while len(todo):
            corners = vertices[todo]
            away = np.linalg.norm(corners - centre, axis=2).max(axis=1) > radius
            todo, corners = todo[away], corners[away]
            edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
            is_fine = edges.max(axis=1) <= _FINE_M
            kept.append(todo[is_fine])
            todo, longest = todo[~is_fine], edges.argmax(axis=1)[~is_fine]
            a, b, c = (np.take_along_axis(todo, ((longest + k) % 3)[:, None], axis=1)[:, 0] for k in range(3))
            middle = len(vertices) + np.arange(len(todo))
            vertices = np.concatenate([vertices, 0.5 * (vertices[a] + vertices[b])])
            todo = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        faces = np.concatenate(kept)
        order = _group(vertices[faces].mean(axis=1)) if len(faces) else faces[:, 0]
        used, number = np.unique(faces[order], return_inverse=True)
        triangles = np.ascontiguousarray(np.asarray(number).reshape(-1, 3), dtype=np.int64)
        return LinkSurface(self.joint, np.ascontiguousarray(vertices[used]), triangles, self.has_mesh)

    def holds(self, points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, "P"]:
        """Return which points are inside, by the solid angle of all triangles (van Oosterom and Strackee, 1983)."""
        corners = self.vertices[self.triangles][None] - points[:, None, None]
        a, b, c = np.moveaxis(corners, 2, 0)
        la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
        spat = np.einsum("pfk,pfk->pf", a, np.cross(b, c))
        dots = (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        turns = np.arctan2(spat, la * lb * lc + dots).sum(axis=1) / (2.0 * np.pi)
        return np.asarray(np.abs(turns) > _INSIDE)


def read_surface(robot: RobotModel, link: str) -> LinkSurface | None:
    """Return the surface of a link; None where a mesh cannot be read or has very many triangles.

    A shape that is no mesh counts as its hull.
    """
    bodies = [body for body in robot.bodies if body.link == link]
    shapes: list[Shape | None] = list(_read_shapes(robot, link))
    if len(shapes) != len(bodies):
        shapes = [None] * len(bodies)
    try:
        parts = [_read_part(robot, link, body, shape) for body, shape in zip(bodies, shapes, strict=True)]
    except (RobotError, OSError):
        return None
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
    if not len(faces) or len(faces) > MOST_TRIANGLES:
        return None
    vertices, number = np.unique(vertices, axis=0, return_inverse=True)  # an STL has each corner several times
    faces = np.asarray(number).ravel()[faces[_group(vertices[np.asarray(number).ravel()[faces]].mean(axis=1))]]
    has_mesh = any(shape is not None and shape.kind == "mesh" for shape in shapes)
    return LinkSurface(bodies[0].joint, vertices, np.ascontiguousarray(faces, dtype=np.int64), has_mesh)


def _read_shapes(robot: RobotModel, link: str) -> Iterator[Shape]:
    """Yield the collision shapes of a link as its URDF has them; none for a link that it does not have."""
    if not robot.source.urdf:
        return
    tree: etree._Element = parse_xml(robot.source.urdf, robot.name, "robot")
    for element in tree.iterfind("link"):
        if element.get("name") == link:
            read = (parse_shape(collision, link, []) for collision in element.findall("collision"))
            yield from (shape for shape in read if shape is not None)


def _read_part(
    robot: RobotModel, link: str, body: LinkBody, shape: Shape | None
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    if shape is None or shape.kind != "mesh":
        from scipy.spatial import ConvexHull  # slow to import

        return body.vertices, ConvexHull(body.vertices).simplices.astype(int)
    mesh = read_mesh(resolve_mesh(shape.uri, robot.source.roots, link)[1], link)
    pose = find_body_frame(robot.model, link).placement.homogeneous @ shape.pose_link_shape
    return (mesh.vertices * shape.size) @ pose[:3, :3].T + pose[:3, 3], mesh.faces


def _group(centres: Float[np.ndarray, "F 3"]) -> Int[np.ndarray, "F"]:
    """Return an order in which points that follow each other are near each other: halves of their longest extent."""
    runs: list[Sequence[int]] = []
    todo = [np.arange(len(centres))]
    while todo:
        own = todo.pop()
        if len(own) <= _RUN:
            runs.append(own.tolist())
            continue
        axis = int(np.ptp(centres[own], axis=0).argmax())
        own = own[np.argsort(centres[own, axis], kind="stable")]
        middle = _RUN * max(1, len(own) // (2 * _RUN))
        todo += [own[middle:], own[:middle]]
    return np.array([k for run in runs for k in run], dtype=int)
