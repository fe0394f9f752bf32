"""coal convexes of vertex sets, made once for each set: GJK and EPA answer rightly on all of them."""

from __future__ import annotations

from functools import lru_cache

import coal
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

# coal scans all points of a Convex up to this number and climbs along neighbours above it.
_SCANNED = 32
# A flat set is thinned out to this many extreme points: all of them are neighbours of each other.
_FLAT = 128
# Vertex sets kept: a robot's bodies and the pieces of some scenes.
_KEPT = 2048


def convex_of(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """A Convex of these points, to be read only: equal points give the same one."""
    return _made(np.ascontiguousarray(vertices, dtype=float).tobytes())


@lru_cache(maxsize=_KEPT)
def _made(points: bytes) -> coal.Convex:
    vertices = np.frombuffer(points).reshape(-1, 3)
    if len(vertices) <= _SCANNED:
        return _scanned(vertices)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        # A flat set has no hull in space; its extreme points in many directions stand for it.
        return _complete(_extreme_points(vertices, _FLAT))
    renumber = np.zeros(len(vertices), dtype=int)
    renumber[hull.vertices] = np.arange(len(hull.vertices))
    return _convex(vertices[hull.vertices], renumber[hull.simplices])


def _extreme_points(vertices: Float[np.ndarray, "V 3"], count: int) -> Float[np.ndarray, "W 3"]:
    """At most ``count`` vertices, the farthest in directions spread over the sphere (Fibonacci lattice)."""
    if len(vertices) <= count:
        return vertices
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z**2)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.asarray(vertices[np.unique((vertices @ directions.T).argmax(axis=0))])


def _scanned(points: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Few points, whose neighbours nobody asks for."""
    # coal corrupts memory when a triangle names a vertex twice: points and segments repeat their last point.
    points = np.concatenate([points, np.repeat(points[-1:], max(0, 4 - len(points)), axis=0)])
    return _convex(points, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))


def _complete(points: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Every point a neighbour of every other when there are too many to be scanned."""
    if len(points) <= _SCANNED:
        return _scanned(points)
    i, j = np.triu_indices(len(points), 1)
    keep = i > 0
    return _convex(points, np.stack([np.zeros(int(keep.sum()), dtype=int), i[keep], j[keep]], axis=1))


def _convex(points: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> coal.Convex:
    corners = coal.StdVec_Vec3s()
    corners.extend(list(points))
    faces = coal.StdVec_Triangle()
    faces.extend([coal.Triangle(a, b, c) for a, b, c in triangles.tolist()])
    return coal.Convex(corners, faces)
