"""Convex vertex sets that contain the shapes a URDF knows, round ones with a bounded excess."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from costs.primitive import Primitive

EXCESS_M, EXCESS_SHARE = 2e-3, 0.01
MOST_SWEPT = 240
"""Vertices of a hull that is swept: each has all those of the other pose as neighbours, and coal keeps 255 of them."""

_LEAST_SIDES = 16
# Subdivisions of an icosahedron's edges, and whether the triangles' centres are taken too, by number of vertices.
_SUBDIVISIONS = ((1, True), (2, False), (3, False), (2, True), (4, False), (3, True))
_LEAST_CAPSULE_SHARE = 0.098


def allowed_excess(radius: float) -> float:
    """Return the largest distance of a vertex outside a round shape [m]: 2 mm, or 1 % of the radius if larger."""
    return max(EXCESS_M, EXCESS_SHARE * radius)


def make_points(kind: str, size: Float[np.ndarray, "k"] | tuple[float, ...]) -> Float[np.ndarray, "V 3"]:
    """Make points whose hull contains a shape in its own frame [m].

    Args:
        kind: ``box``, ``sphere``, ``cylinder`` or ``capsule``.
        size: edge lengths of a box; else the radius and, if the shape has one, the length [m].
    """
    if kind == "box":
        return box(np.asarray(size))
    radius = float(size[0])
    if kind == "sphere":
        return sphere(radius)
    return cylinder(radius, float(size[1])) if kind == "cylinder" else capsule(radius, float(size[1]))


def box(size: Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 3"]:
    """Make the corners of a box with full edge lengths ``size`` [m]."""
    signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    return np.asarray(0.5 * signs * size)


def cylinder(radius: float, length: float) -> Float[np.ndarray, "V 3"]:
    """Make a prism around a cylinder along z: exact in length, within ``allowed_excess``; 32 to 46 vertices."""
    sides = max(_LEAST_SIDES, int(np.ceil(np.pi / np.arccos(1.0 / (1.0 + allowed_excess(radius) / radius)))))
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = radius / np.cos(np.pi / sides) * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-0.5 * length, 0.5 * length)])


def sphere(radius: float, most: int = 272) -> Float[np.ndarray, "V 3"]:
    """Make a polytope around a sphere, within ``allowed_excess`` of it: 32 vertices (up to 23 mm) to 272 (from 0.2 m).

    Args:
        radius: [m].
        most: vertices (at least 32) of a polytope that may exceed the sphere by more.
    """
    return np.asarray(radius * _around_unit_sphere(allowed_excess(radius) / radius, most))


def capsule(radius: float, length: float, most: int = 296) -> Float[np.ndarray, "V 3"]:
    """Make a polytope around a capsule along z, within ``allowed_excess`` of it; ``length`` is without the caps.

    A sphere's polytope, swept along the axis: 32 vertices (up to 20 mm) to 296 (from 0.2 m); ``most`` as for a sphere.
    """
    share = allowed_excess(radius) / radius
    if share >= _LEAST_CAPSULE_SHARE:
        return _small_capsule(radius, length)
    shift = np.array([0.0, 0.0, 0.5 * length])
    polytope, is_top, is_bottom = _swept_unit_sphere(share, most)
    return np.asarray(np.vstack([radius * polytope[is_top] + shift, radius * polytope[is_bottom] - shift]))


def make_swept_hull(exact: Primitive, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
    """Make the polytope around a link's round shape for the optimiser's sweeps, in the frame of its joint.

    These are ``vertices`` (those within ``allowed_excess``) unless there are too many of them: around the vertices of
    spheres and capsules of more than 110 mm, it exceeds the shape by at most 3.7 % of the radius.
    """
    if len(vertices) <= MOST_SWEPT or exact.kind == "cylinder":
        return vertices
    radius = exact.radius + allowed_excess(exact.radius)
    is_sphere = exact.kind == "sphere"
    points = sphere(radius, MOST_SWEPT) if is_sphere else capsule(radius, exact.length, MOST_SWEPT)
    return np.asarray(points @ exact.pose[:3, :3].T + exact.pose[:3, 3])


def _small_capsule(radius: float, length: float) -> Float[np.ndarray, "32 3"]:
    """Make a polytope of 32 vertices around a capsule, at most 9.8 % of the radius outside it.

    Each cap is a ring of 9 vertices, one of 6 and a tip; the rings' radii and heights come from a numerical search for
    the smallest excess.
    """
    rings = []
    for count, ring_radius, height in ((9, 1.06331, 0.26930), (6, 0.74442, 0.80559), (1, 0.0, 1.09567)):
        angle = 2.0 * np.pi * np.arange(count) / count
        ring = [ring_radius * np.cos(angle), ring_radius * np.sin(angle), np.full(count, height)]
        rings.append(np.column_stack(ring))
    cap = np.vstack(rings)
    mirrored = cap * np.array([1.0, 1.0, -1.0])
    factor = radius / _inradius(np.vstack([cap, mirrored]))
    shift = np.array([0.0, 0.0, 0.5 * length])
    return np.asarray(np.vstack([factor * cap + shift, factor * mirrored - shift]))


def _around_unit_sphere(share: float, most: int) -> Float[np.ndarray, "V 3"]:
    """Make the first polytope at most ``share`` outside a unit sphere, else the last with few enough vertices."""
    polytopes = (_geodesic(*subdivision) for subdivision in _SUBDIVISIONS)
    fitting = [points for points in polytopes if len(points) <= most]
    return next((points for points in fitting if np.linalg.norm(points, axis=1).max() <= 1.0 + share), fitting[-1])


@lru_cache
def _geodesic(edges: int, with_centres: bool) -> Float[np.ndarray, "V 3"]:
    """Make an icosahedron with divided edges and all points on one sphere, scaled to contain a unit sphere."""
    from scipy.spatial import ConvexHull  # slow to import

    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = _cyclic([(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    weights = np.array([(i, j, edges - i - j) for i in range(edges + 1) for j in range(edges + 1 - i)]) / edges
    points = np.concatenate([weights @ corners[triangle] for triangle in ConvexHull(corners).simplices])
    points = points[np.unique(np.round(points, 9), axis=0, return_index=True)[1]]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    if with_centres:
        points = np.vstack([points, ConvexHull(points).equations[:, :3]])
    return np.asarray(points / _inradius(points))


@lru_cache
def _swept_unit_sphere(share: float, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make a unit sphere's polytope; also return which vertices are corners at either end when it is swept along z."""
    from scipy.spatial import ConvexHull  # slow to import

    up = np.array([0.0, 0.0, 1.0])
    polytope = _around_unit_sphere(share, most)
    while True:
        is_corner = np.zeros(2 * len(polytope), dtype=bool)
        is_corner[ConvexHull(np.vstack([polytope + up, polytope - up])).vertices] = True
        if is_corner.sum() <= most:
            return polytope, is_corner[: len(polytope)], is_corner[len(polytope) :]
        polytope = _around_unit_sphere(share, len(polytope) - 1)


def _cyclic(points: list[tuple[float, float, float]]) -> Float[np.ndarray, "V 3"]:
    array = np.array(points)
    return np.vstack([array, array[:, [1, 2, 0]], array[:, [2, 0, 1]]])


def _inradius(points: Float[np.ndarray, "V 3"]) -> float:
    """Return the largest radius of a sphere about the origin inside the hull of ``points``."""
    from scipy.spatial import ConvexHull  # slow to import

    return float(-ConvexHull(points).equations[:, 3].max())
