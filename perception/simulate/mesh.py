"""Closed triangle meshes of simple solids, for the simulator to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    Attributes:
        vertices: (V, 3) world [m].
        triangles: (F, 3) indices of their corners.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]

    def moved(self, rotation: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Mesh:
        """Turned about the origin, then shifted."""
        return Mesh(self.vertices @ rotation.T + shift, self.triangles)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles in one mesh."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def hull(vertices: Float[np.ndarray, "V 3"]) -> Mesh:
    """The convex hull of points."""
    return Mesh(vertices, ConvexHull(vertices).simplices.astype(np.int64))


def box(lower: Sequence[float], upper: Sequence[float]) -> Mesh:
    """An axis-aligned box."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    return hull(np.asarray(lower) + corners * (np.asarray(upper) - np.asarray(lower)))


def cylinder(start: Sequence[float], end: Sequence[float], radius: float, n_sides: int = 48) -> Mesh:
    """A cylinder between two points of its axis."""
    first, last = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    axis = (last - first) / np.linalg.norm(last - first)
    u, v = _across(axis)
    angle = 2.0 * np.pi * np.arange(n_sides) / n_sides
    rim = radius * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    return hull(np.concatenate([first + rim, last + rim]))


def torus(
    centre: Sequence[float], axis: Sequence[float], radius: float, tube: float, n_round: int = 96, n_tube: int = 24
) -> Mesh:
    """A torus of centre-line radius ``radius``."""
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


def _across(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two directions at right angles to a unit axis and to each other."""
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
