"""Convex solids for coal, and their signed distances: bodies in the frame of their joint, pieces in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from weakref import WeakKeyDictionary

import coal
import numpy as np
from jaxtyping import Float, Int

from costs.robot import LinkBody
from costs.scene import ConvexPiece
from costs.stopping import poll

# coal scans all points of a Convex up to this number and follows neighbours above it.
_SCANNED = 32
# A flat set is thinned out to this many extreme points: all of them are neighbours of each other.
_FLAT = 128
# Where two faces touch within rounding coal fails and returns the lowest double: it is called again with the
# mover nudged by far less than any tolerance [m].
_ABSURD = 1e6
_NUDGES = (None, *(1e-8 * np.array([[0.61, -0.48, 0.63], [-0.43, 0.71, -0.56], [0.37, 0.52, -0.77]])))
_POLLED = 64  # distances between two polls: some milliseconds at most
# Vertex sets kept: a robot's bodies and the pieces of some scenes.
_KEPT = 2048


def make_coal_convex(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Return a Convex of these points, read-only: equal points give the same object."""
    return _make_convex(np.ascontiguousarray(vertices, dtype=float).tobytes())


@lru_cache(maxsize=_KEPT)
def _make_convex(points: bytes) -> coal.Convex:
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    vertices = np.frombuffer(points).reshape(-1, 3)
    if len(vertices) <= _SCANNED:
        return _scanned_convex(vertices)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        # A flat set has no hull in space; its extreme points in many directions approximate it.
        return _complete_convex(_extreme_points(vertices, _FLAT))
    renumber = np.zeros(len(vertices), dtype=int)
    renumber[hull.vertices] = np.arange(len(hull.vertices))
    return _convex(vertices[hull.vertices], renumber[hull.simplices])


def _extreme_points(vertices: Float[np.ndarray, "V 3"], count: int) -> Float[np.ndarray, "W 3"]:
    """Return at most ``count`` vertices, the farthest in directions spread over the sphere (Fibonacci lattice)."""
    if len(vertices) <= count:
        return vertices
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z**2)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.asarray(vertices[np.unique((vertices @ directions.T).argmax(axis=0))])


def _scanned_convex(points: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Return a Convex of few points; coal does not use their neighbours."""
    # coal corrupts memory when a triangle names a vertex twice: points and segments repeat their last point.
    points = np.concatenate([points, np.repeat(points[-1:], max(0, 4 - len(points)), axis=0)])
    return _convex(points, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))


def _complete_convex(points: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Return a Convex in which every point is a neighbour of every other."""
    if len(points) <= _SCANNED:
        return _scanned_convex(points)
    i, j = np.triu_indices(len(points), 1)
    keep = i > 0
    return _convex(points, np.stack([np.zeros(int(keep.sum()), dtype=int), i[keep], j[keep]], axis=1))


def _convex(points: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> coal.Convex:
    corners = coal.StdVec_Vec3s()
    corners.extend(list(points))
    faces = coal.StdVec_Triangle()
    faces.extend([coal.Triangle(a, b, c) for a, b, c in triangles.tolist()])
    return coal.Convex(corners, faces)


@dataclass(frozen=True, eq=False)
class CoalSolid:
    """Convex body of the robot (in the frame of its joint) or piece of the scene (joint 0, world frame).

    Attributes:
        name: body or piece.
        link: link of a body; empty for a piece.
        joint: pinocchio joint that carries it.
        vertices: (V, 3) its hull [m].
    """

    name: str
    link: str
    joint: int
    vertices: Float[np.ndarray, "V 3"]

    @cached_property
    def sphere(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Centre of the bounding box and the distance of the farthest vertex from it."""
        centre = 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))
        return centre, float(np.linalg.norm(self.vertices - centre, axis=1).max())

    @cached_property
    def normals(self) -> Float[np.ndarray, "F 3"]:
        """Outward unit normals of the hull's faces, in the frame of the joint; none for a flat hull."""
        from scipy.spatial import ConvexHull, QhullError  # slow to import

        try:
            return np.unique(np.round(ConvexHull(self.vertices).equations[:, :3], 12), axis=0)
        except QhullError:
            return np.zeros((0, 3))

    @cached_property
    def convex(self) -> coal.Convex:
        """Convex of coal."""
        return make_coal_convex(self.vertices)

    def distances(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P"]:
        """Return the distances of points in the solid's frame from it, 0 inside [m]."""
        dot, here = coal.Sphere(1e-9), coal.Transform3s()
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        distances = []
        for point in points:
            result.clear()
            pose = coal.Transform3s(np.eye(3), point)
            distances.append(coal.distance(dot, pose, self.convex, here, request, result))
        return np.asarray(np.maximum(np.array(distances), 0.0))

    @staticmethod
    def of_body(body: LinkBody) -> CoalSolid:
        """Return the solid of a body, cached while the body exists."""
        known = _BODIES.get(body)
        if known is None:
            known = _BODIES[body] = CoalSolid(body.name, body.link, body.joint, body.vertices)
        return known

    @staticmethod
    def of_piece(piece: ConvexPiece) -> CoalSolid:
        """Return the solid of a piece."""
        return CoalSolid(piece.name, "", 0, piece.vertices)


_BODIES: WeakKeyDictionary[LinkBody, CoalSolid] = WeakKeyDictionary()


def supports(
    solids: Sequence[CoalSolid], which: Int[np.ndarray, "K"], directions: Float[np.ndarray, "K 3"]
) -> Float[np.ndarray, "K"]:
    """Return the support of each chosen solid along its direction, in its own frame: ``max_v direction . v``."""
    order = np.argsort(which, kind="stable")
    sorted_directions, chosen = directions[order], which[order]
    ends = [*(np.flatnonzero(chosen[1:] != chosen[:-1]) + 1).tolist(), len(chosen)]
    reached, out, first = np.empty(len(which)), np.empty(len(which)), 0
    for last in ends if len(which) else ():
        vertices = solids[chosen[first]].vertices
        (sorted_directions[first:last] @ vertices.T).max(axis=1, out=reached[first:last])
        first = last
    out[order] = reached
    return out


def _request() -> coal.DistanceRequest:
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    return request


@dataclass(eq=False)
class DistanceQuery:
    """Signed distances from coal, with the memory it reuses."""

    _request: coal.DistanceRequest = field(default_factory=_request)
    _result: coal.DistanceResult = field(default_factory=coal.DistanceResult)
    _identity: coal.Transform3s = field(default_factory=coal.Transform3s)

    def closest(
        self,
        movers: Sequence[coal.Convex],
        rotation: Float[np.ndarray, "R 3 3"],
        translation: Float[np.ndarray, "R 3"],
        holders: Sequence[coal.Convex],
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Return signed distances [m] of movers, placed in their holders' frames, and unit directions to the holders.

        A direction is not finite where the two touch within rounding.
        """
        distance, direction = np.empty(len(movers)), np.empty((len(movers), 3))
        result, request, identity = self._result, self._request, self._identity
        for row, (mover, turned, moved, holder) in enumerate(zip(movers, rotation, translation, holders, strict=True)):
            if row % _POLLED == 0:
                poll()
            for nudge in _NUDGES:
                result.clear()
                pose = coal.Transform3s(turned, moved if nudge is None else moved + nudge)
                found = coal.distance(mover, pose, holder, identity, request, result)
                if found > -_ABSURD:
                    break
            distance[row], direction[row] = found, result.normal
        length = np.sqrt((direction * direction).sum(axis=1))
        length[~((length > 0.5) & (length < 2.0))] = np.nan
        return distance, direction / length[:, None]

    def measure(
        self,
        first: coal.Convex,
        second: coal.Convex,
        rotation: Float[np.ndarray, "3 3"] | None = None,
        translation: Float[np.ndarray, "3"] | None = None,
    ) -> float:
        """Return the signed distance of two bodies in one frame, the first turned and moved there [m]."""
        turned = np.eye(3) if rotation is None else rotation
        moved = np.zeros(3) if translation is None else translation
        return float(self.closest([first], turned[None], moved[None], [second])[0][0])

    def nearest_point(
        self,
        mover: coal.Convex,
        rotation: Float[np.ndarray, "3 3"],
        translation: Float[np.ndarray, "3"],
        holder: coal.Convex,
    ) -> Float[np.ndarray, "3"]:
        """Return the holder's point nearest to the mover, or deepest in it, in the holder's frame [m]."""
        self._result.clear()
        placed = coal.Transform3s(rotation, translation)
        coal.distance(mover, placed, holder, self._identity, self._request, self._result)
        return np.array(self._result.getNearestPoint2())
