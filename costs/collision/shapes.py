"""coal convexes: static hulls with their true topology, and point sets that are rewritten at every query."""

from __future__ import annotations

import threading
from functools import lru_cache
from weakref import WeakKeyDictionary

import coal
import numpy as np
from jaxtyping import Float, Int

from costs.robot.model import LinkBody

MIN_POINTS = 4
MOST_NEIGHBOURS = 255  # of a point that coal can keep
EXHAUSTIVE_LIMIT = 32  # up to here coal scans all points of a convex, above it climbs along the triangles' edges


def make_convex(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Make the hull of fixed vertices, read-only: large equal vertex sets share one."""
    if MIN_POINTS <= len(vertices) <= EXHAUSTIVE_LIMIT:
        return coal.Convex(_to_points(vertices), _make_rewritable_topology(len(vertices)))
    return _make_hull(np.ascontiguousarray(vertices, dtype=float).tobytes())


@lru_cache(maxsize=512)
def _make_hull(points: bytes) -> coal.Convex:
    """Make the hull of (V, 3) vertices given as bytes; cached, since every checker of a plan needs the same ones."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    vertices = np.unique(np.frombuffer(points).reshape(-1, 3), axis=0)
    if len(vertices) < MIN_POINTS:  # coal corrupts memory when a triangle names a vertex twice
        vertices = vertices[np.arange(MIN_POINTS) % len(vertices)]
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        # A flat set, a line or a point has no triangulation: every point is a neighbour of every other.
        return _convex(vertices, _make_complete_graph(len(vertices)))
    used = hull.vertices
    index = np.full(len(vertices), -1)
    index[used] = np.arange(len(used))
    return _convex(vertices[used], index[hull.simplices])


def make_outer_convex(body: LinkBody) -> coal.Convex:
    """Make the hull of a body's outer vertices, once while the body lives."""
    known = _OUTER.get(body)
    if known is None:
        known = _OUTER[body] = make_convex(body.outer)
    return known


_OUTER: WeakKeyDictionary[LinkBody, coal.Convex] = WeakKeyDictionary()


def make_rewritable_convex(n_points: int) -> tuple[coal.Convex, Float[np.ndarray, "V 3"]]:
    """Make a convex and its points, which may be overwritten with any point set of that size.

    Every point is a neighbour of every other, so no stale topology can mislead coal's climb to the support point.
    Each thread has one per size, made once; callers write the points before each query.
    """
    convexes: dict[int, tuple[coal.Convex, np.ndarray]] = _WORK_SPACE.__dict__.setdefault("convexes", {})
    if n_points not in convexes:
        convex = coal.Convex(_to_points(np.zeros((n_points, 3))), _make_rewritable_topology(n_points))
        convexes[n_points] = convex, convex.points()
    return convexes[n_points]


def make_swept_convex(vertices: Float[np.ndarray, "V 3"]) -> tuple[coal.Convex, Float[np.ndarray, "W 3"]]:
    """Make a convex and its 2 V points, which are overwritten with these vertices at two poses, one after the other.

    Where 2 V points cannot all be neighbours, a point's neighbours are those on its own hull, which keeps its topology,
    and all points of the other hull: where none of them is farther in a direction, no point is.
    """
    count = len(vertices)
    if 2 * count <= MOST_NEIGHBOURS + 1:
        return make_rewritable_convex(2 * count)
    convexes: dict[bytes, tuple[coal.Convex, np.ndarray]] = _WORK_SPACE.__dict__.setdefault("swept", {})
    key = np.ascontiguousarray(vertices, dtype=float).tobytes()
    if key not in convexes:
        convex = coal.Convex(_to_points(np.zeros((2 * count, 3))), _make_swept_topology(key))
        convexes[key] = convex, convex.points()
    return convexes[key]


@lru_cache(maxsize=32)
def _make_swept_topology(points: bytes) -> coal.StdVec_Triangle:
    """Make triangles of two copies of a hull with every point a neighbour of all points of the other copy."""
    from scipy.spatial import ConvexHull  # slow to import

    vertices = np.frombuffer(points).reshape(-1, 3)
    count, hull = len(vertices), ConvexHull(vertices)
    neighbour = np.empty(count, dtype=int)
    neighbour[hull.simplices] = np.roll(hull.simplices, 1, axis=1)
    point, other = np.divmod(np.arange(count * count), count)
    across = np.stack([point, neighbour[point], other + count], axis=1)
    return _to_triangles(np.concatenate([hull.simplices, hull.simplices + count, across]))


_WORK_SPACE = threading.local()


@lru_cache(maxsize=128)
def _make_rewritable_topology(n_points: int) -> coal.StdVec_Triangle:
    return _to_triangles(_make_complete_graph(n_points) if n_points > EXHAUSTIVE_LIMIT else np.array([[0, 1, 2]]))


def _make_complete_graph(n_points: int) -> Int[np.ndarray, "K 3"]:
    """Make triangles in which all points are neighbours: i, j and minus their sum leave few pairs out."""
    i, j = np.triu_indices(n_points, 1)
    third = -(i + j) % n_points
    apart = (third != i) & (third != j)
    third = np.where(apart, third, np.where(np.minimum(i, j) != 0, 0, np.where(np.maximum(i, j) != 1, 1, 2)))
    triangles = np.unique(np.sort(np.stack([i, j, third], axis=1), axis=1), axis=0)
    return np.asarray(triangles)


def _convex(points: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "K 3"]) -> coal.Convex:
    return coal.Convex(_to_points(points), _to_triangles(triangles))


def _to_points(points: Float[np.ndarray, "V 3"]) -> coal.StdVec_Vec3s:
    out = coal.StdVec_Vec3s()
    out.extend(list(points))
    return out


def _to_triangles(triangles: Int[np.ndarray, "K 3"]) -> coal.StdVec_Triangle:
    out = coal.StdVec_Triangle()
    out.extend([coal.Triangle(a, b, c) for a, b, c in triangles.tolist()])
    return out
