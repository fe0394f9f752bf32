"""Triangles and feature edges of convex vertex sets, flat and thin ones included."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

FLAT = 1e-6
"""Extent below which a vertex set counts as flat in a direction [m]."""


@dataclass(frozen=True)
class ConvexMesh:
    """The surface of a hull.

    Attributes:
        vertices: (V, 3) its corners [m].
        triangles: (F, 3) indices, counter-clockwise from outside; a flat set has both sides.
        edges: (E, 2) indices of the edges where faces of different planes meet.
        bends: (E,) angle between those two faces [rad]; pi at the rim of a flat set.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]
    edges: Int[np.ndarray, "E 2"]
    bends: Float[np.ndarray, "E"]


def make_convex_mesh(vertices: Float[np.ndarray, "V 3"]) -> ConvexMesh:
    """Return the hull of ``vertices`` as a mesh: a flat set as a two-sided polygon, a line or point without triangles.

    Raises:
        ValueError: no vertex, not three columns, or a value that is not finite.
    """
    points = np.asarray(vertices, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise ValueError(f"a hull needs finite vertices of shape (V, 3), got {points.shape}")
    return _make_mesh(points.tobytes())


@lru_cache(maxsize=512)
def _make_mesh(vertices: bytes) -> ConvexMesh:
    """Return the hull of (V, 3) finite vertices given as bytes; cached, since two files draw each body."""
    points = np.frombuffer(vertices).reshape(-1, 3)
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=True)[2]
    extents = np.ptp(centred @ axes.T, axis=0)
    rank = int(np.sum(extents > FLAT))
    if rank == 3:
        try:
            return _mesh_solid(points)
        except QhullError:
            rank = 2  # Qhull's own flatness test is relative; treat what it refuses as flat
    if rank == 2:
        return _mesh_polygon(points, centred @ axes[:2].T)
    along = centred @ axes[0]
    ends = points[[int(along.argmin()), int(along.argmax())]]
    return ConvexMesh(ends, np.empty((0, 3), dtype=int), np.array([[0, 1]]), np.array([np.pi]))


def _mesh_solid(points: Float[np.ndarray, "V 3"]) -> ConvexMesh:
    hull = ConvexHull(points)
    triangles: Int[np.ndarray, "F 3"] = np.array(hull.simplices, dtype=int)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Qhull does not order the corners of a facet; its outward normal says which ones to swap.
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    used, compact = np.unique(triangles, return_inverse=True)
    triangles = compact.reshape(triangles.shape)
    edges, bends = _find_feature_edges(triangles, hull.equations[:, :3])
    return ConvexMesh(points[used], triangles, edges, bends)


def _find_feature_edges(
    triangles: Int[np.ndarray, "F 3"], normals: Float[np.ndarray, "F 3"]
) -> tuple[Int[np.ndarray, "E 2"], Float[np.ndarray, "E"]]:
    """Return the edges whose two triangles do not share a plane, and the angles between those [rad]."""
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(triangles)), 3)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    first, second = order[0::2], order[1::2]  # each edge of a closed surface belongs to exactly two triangles
    cosine = np.einsum("ij,ij->i", normals[owner[first]], normals[owner[second]])
    is_edge = cosine < 1.0 - 1e-6
    return sides[first][is_edge], np.arccos(np.clip(cosine[is_edge], -1.0, 1.0))


def _mesh_polygon(points: Float[np.ndarray, "V 3"], flat: Float[np.ndarray, "V 2"]) -> ConvexMesh:
    ring = np.asarray(ConvexHull(flat).vertices)
    n = len(ring)
    fan = np.array([[0, i, i + 1] for i in range(1, n - 1)])
    edges = np.array([[i, (i + 1) % n] for i in range(n)])
    return ConvexMesh(points[ring], np.concatenate([fan, fan[:, ::-1]]), edges, np.full(n, np.pi))
