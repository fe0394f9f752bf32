"""Triangle meshes of simple solids; winding is arbitrary."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from perception.solids.mesh import Mesh as Mesh  # re-exported


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join all triangles into one mesh."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def hull(vertices: Float[np.ndarray, "V 3"]) -> Mesh:
    """Make the convex hull of points."""
    return Mesh(vertices, ConvexHull(vertices).simplices.astype(np.int64))


def box(lower: Sequence[float], upper: Sequence[float]) -> Mesh:
    """Make an axis-aligned box."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    return hull(np.asarray(lower) + corners * (np.asarray(upper) - np.asarray(lower)))


def cylinder(start: Sequence[float], end: Sequence[float], radius: float, n_sides: int = 48) -> Mesh:
    """Make a cylinder between two points of its axis."""
    first, last = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    axis = (last - first) / np.linalg.norm(last - first)
    u, v = _across(axis)
    angle = 2.0 * np.pi * np.arange(n_sides) / n_sides
    rim = radius * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    return hull(np.concatenate([first + rim, last + rim]))


def torus(
    centre: Sequence[float], axis: Sequence[float], radius: float, tube: float, n_round: int = 96, n_tube: int = 24
) -> Mesh:
    """Make a torus of centre-line radius ``radius``."""
    direction = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    u, v = _across(direction)
    around = 2.0 * np.pi * np.arange(n_round) / n_round
    across = 2.0 * np.pi * np.arange(n_tube) / n_tube
    outward = np.cos(around)[:, None] * u + np.sin(around)[:, None] * v
    distance = radius + tube * np.cos(across)
    vertices = outward[:, None] * distance[None, :, None] + (tube * np.sin(across))[None, :, None] * direction
    i, j = np.meshgrid(np.arange(n_round), np.arange(n_tube), indexing="ij")
    a, b = i * n_tube + j, (i + 1) % n_round * n_tube + j
    c, d = (i + 1) % n_round * n_tube + (j + 1) % n_tube, i * n_tube + (j + 1) % n_tube
    triangles = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]).reshape(-1, 3)
    return Mesh(np.asarray(centre) + vertices.reshape(-1, 3), triangles)


def capsule(start: Sequence[float], end: Sequence[float], radius: float) -> Mesh:
    """Make a bar with hemispherical ends centred on the two points."""
    turn = np.pi * np.arange(16) / 8
    rise = np.pi * np.arange(-4, 5) / 8
    angle, height = (grid.ravel() for grid in np.meshgrid(turn, rise))
    ball = np.column_stack([np.cos(angle) * np.cos(height), np.sin(angle) * np.cos(height), np.sin(height)])
    ball = np.unique(np.round(radius * ball, 9), axis=0)
    return hull(np.concatenate([np.asarray(start) + ball, np.asarray(end) + ball]))


def bent_bar(path: Sequence[Sequence[float]], radius: float) -> Mesh:
    """Make a round bar along a polyline."""
    return join_meshes([capsule(a, b, radius) for a, b in pairwise(path)])


def lathe(
    profile: Sequence[tuple[float, float]],
    base: Sequence[float] = (0.0, 0.0, 0.0),
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    n_round: int = 48,
) -> Mesh:
    """Make a surface of revolution through (radius, height) pairs.

    Args:
        profile: radius and height above ``base``; the same first and last pair gives a closed ring.
        base: point on the axis with height zero [m].
    """
    direction = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    u, v = _across(direction)
    angle = 2.0 * np.pi * np.arange(n_round) / n_round
    outward = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    radius, height = np.asarray(profile, dtype=float).T
    vertices = outward[:, None] * radius[None, :, None] + height[None, :, None] * direction
    i, j = np.meshgrid(np.arange(n_round), np.arange(len(profile) - 1), indexing="ij")
    a, b = i * len(profile) + j, (i + 1) % n_round * len(profile) + j
    triangles = np.concatenate([np.stack([a, b, b + 1], axis=-1), np.stack([a, b + 1, a + 1], axis=-1)])
    return Mesh(np.asarray(base, dtype=float) + vertices.reshape(-1, 3), triangles.reshape(-1, 3))


def pipe(start: Sequence[float], end: Sequence[float], radius: float, wall: float) -> Mesh:
    """Make a hollow cylinder, open at both ends.

    Args:
        radius: outer radius [m].
        wall: wall thickness [m].
    """
    axis = np.asarray(end, dtype=float) - np.asarray(start, dtype=float)
    length, inner = float(np.linalg.norm(axis)), radius - wall
    section = [(radius, 0.0), (radius, length), (inner, length), (inner, 0.0), (radius, 0.0)]
    return lathe(section, start, axis.tolist())


def _across(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return two unit vectors perpendicular to a unit axis and to each other."""
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
