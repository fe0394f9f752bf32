"""coal convexes: static hulls with their true topology, and point sets that are rewritten at every query."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import coal
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

MIN_POINTS = 4
EXHAUSTIVE_LIMIT = 32  # up to here coal scans all points of a convex, above it climbs along the triangles' edges


def static_convex(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """The hull of fixed vertices."""
    vertices = np.unique(np.asarray(vertices, dtype=float), axis=0)
    if len(vertices) < MIN_POINTS:  # coal corrupts memory when a triangle names a vertex twice
        vertices = vertices[np.arange(MIN_POINTS) % len(vertices)]
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):  # flat or a line or a point: no triangulation, every point knows every other
        return _convex(vertices, _complete_graph(len(vertices)))
    used = hull.vertices
    index = np.full(len(vertices), -1)
    index[used] = np.arange(len(used))
    return _convex(vertices[used], index[hull.simplices])


def rewritable_convex(n_points: int) -> coal.Convex:
    """A convex whose ``points()`` may be overwritten with any point set of that size.

    Every point is a neighbour of every other, so no stale topology can mislead coal's climb to the support point.
    """
    return coal.Convex(_points(np.zeros((n_points, 3))), _rewritable_topology(n_points))


@lru_cache(maxsize=64)
def _rewritable_topology(n_points: int) -> coal.StdVec_Triangle:
    return _triangles(_complete_graph(n_points) if n_points > EXHAUSTIVE_LIMIT else np.array([[0, 1, 2]]))


def _complete_graph(n_points: int) -> Int[np.ndarray, "K 3"]:
    return np.array([(i, j, (j + 1) % n_points if (j + 1) % n_points != i else (j + 2) % n_points)
                     for i, j in combinations(range(n_points), 2)])  # fmt: skip


def _convex(points: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "K 3"]) -> coal.Convex:
    return coal.Convex(_points(points), _triangles(triangles))


def _points(points: Float[np.ndarray, "V 3"]) -> coal.StdVec_Vec3s:
    out = coal.StdVec_Vec3s()
    out.extend(list(points))
    return out


def _triangles(triangles: Int[np.ndarray, "K 3"]) -> coal.StdVec_Triangle:
    out = coal.StdVec_Triangle()
    out.extend([coal.Triangle(a, b, c) for a, b, c in triangles.tolist()])
    return out
