"""Signed separation of two convex vertex sets: coal proposes a direction, the vertices themselves give the bound.

For every unit vector ``n`` from set A to set B, ``min_B n.y - max_A n.x`` is a lower bound of their signed distance
(penetration counts negative).  GJK/EPA finds the best ``n``; evaluating it on all vertices makes the bound independent
of how well it did.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import coal
import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

# coal scans all points of a Convex up to this number and climbs along neighbours above it.
_SCANNED = 32
# With the neighbour graph complete the climb is right; coal refuses more than about 250 neighbours.
_COMPLETE = 128


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex body of the robot (in the frame of its joint) or a piece of the scene (joint 0, world frame).

    Attributes:
        name: body or piece.
        link: link of a body; empty for a piece.
        joint: pinocchio joint that carries it.
        vertices: (V, 3) its hull [m].
        proxy: (W, 3) at most 64 points that stand for it when a direction is sought; any choice is safe.
    """

    name: str
    link: str
    joint: int
    vertices: Float[np.ndarray, "V 3"]
    proxy: Float[np.ndarray, "W 3"]

    @cached_property
    def sphere(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Centre of the bounding box and the distance of the farthest vertex from it."""
        centre = 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))
        return centre, float(np.linalg.norm(self.vertices - centre, axis=1).max())

    @cached_property
    def convex(self) -> coal.Convex:
        """The whole solid for coal."""
        return make_convex(self.vertices)


@dataclass(frozen=True)
class Closest:
    """Signed distance [m], unit direction from the first set to the second, and a point on each."""

    distance: float
    direction: Float[np.ndarray, "3"]
    first: Float[np.ndarray, "3"]
    second: Float[np.ndarray, "3"]


@dataclass(eq=False)
class Narrow:
    """coal's distance with the memory it reuses; one per verification."""

    _pool: dict[int, tuple[coal.Convex, np.ndarray]] = field(default_factory=dict)
    _request: coal.DistanceRequest = field(default_factory=lambda: _request())
    _result: coal.DistanceResult = field(default_factory=coal.DistanceResult)
    _identity: coal.Transform3s = field(default_factory=coal.Transform3s)

    def direction(self, moving: Float[np.ndarray, "W 3"], holder: Solid) -> Float[np.ndarray, "3"]:
        """A good separating direction from the hull of ``moving`` (holder's frame) to the holder."""
        return self._distance(self._pooled(moving), self._identity, holder.convex).direction

    def closest(
        self, mover: Solid, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"], holder: Solid
    ) -> Closest:
        """Signed distance of the mover, placed in the holder's frame, from the holder."""
        return self._distance(mover.convex, coal.Transform3s(rotation, translation), holder.convex)

    def _distance(self, first: coal.Convex, placed: coal.Transform3s, second: coal.Convex) -> Closest:
        self._result.clear()
        distance = coal.distance(first, placed, second, self._identity, self._request, self._result)
        direction = np.array(self._result.normal)
        a, b = np.array(self._result.getNearestPoint1()), np.array(self._result.getNearestPoint2())
        length = float(np.linalg.norm(direction))
        if not 0.5 < length < 2.0:  # coal leaves no normal when the sets touch within rounding
            direction, length = np.array([0.0, 0.0, 1.0]), 1.0
        return Closest(float(distance), direction / length, a, b)

    def _pooled(self, points: Float[np.ndarray, "W 3"]) -> coal.Convex:
        """A Convex of that many points with a complete neighbour graph, holding these points."""
        if len(points) not in self._pool:
            convex = _complete_convex(np.zeros((len(points), 3)))
            self._pool[len(points)] = (convex, convex.points())
        convex, view = self._pool[len(points)]
        view[: len(points)] = points
        view[len(points) :] = points[-1]
        return convex


def _request() -> coal.DistanceRequest:
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    return request


def separation(
    direction: Float[np.ndarray, "3"], moving: Float[np.ndarray, "N 3"], holder: Float[np.ndarray, "M 3"]
) -> float:
    """Lower bound of the signed distance of two vertex sets along a unit direction from the first to the second."""
    return float((holder @ direction).min() - (moving @ direction).max())


def make_convex(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """A coal Convex that answers rightly: few points, or a complete neighbour graph, or the hull's true facets."""
    if len(vertices) <= _COMPLETE:
        return _complete_convex(vertices)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        # A flat set has no hull in space; its extreme points in many directions stand for it.
        return _complete_convex(extreme_points(vertices, _COMPLETE))
    renumber = np.zeros(len(vertices), dtype=int)
    renumber[hull.vertices] = np.arange(len(hull.vertices))
    return _convex(vertices[hull.vertices], renumber[hull.simplices])


def extreme_points(vertices: Float[np.ndarray, "V 3"], count: int) -> Float[np.ndarray, "W 3"]:
    """At most ``count`` vertices, the farthest in directions spread over the sphere (Fibonacci lattice)."""
    if len(vertices) <= count:
        return vertices
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z**2)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.asarray(vertices[np.unique((vertices @ directions.T).argmax(axis=0))])


def _complete_convex(points: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Every point a neighbour of every other when there are too many to be scanned."""
    # coal corrupts memory when a triangle names a vertex twice: points, segments and triangles repeat their last point.
    points = np.concatenate([points, np.repeat(points[-1:], max(0, 4 - len(points)), axis=0)])
    n = len(points)
    if n <= _SCANNED:
        return _convex(points, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
    i, j = np.triu_indices(n, 1)
    keep = i > 0
    triangles = np.stack([np.zeros(int(keep.sum()), dtype=int), i[keep], j[keep]], axis=1)
    return _convex(points, triangles)


def _convex(points: Float[np.ndarray, "V 3"], triangles: np.ndarray) -> coal.Convex:
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(point)
    faces = coal.StdVec_Triangle()
    for a, b, c in triangles.tolist():
        faces.append(coal.Triangle(a, b, c))
    return coal.Convex(corners, faces)
