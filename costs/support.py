"""Support polygons: the convex hull of the planted soles on the ground, as edges with outward normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class SupportPolygon:
    """A convex polygon in the horizontal plane.

    Attributes:
        vertices: (E, 2) counter-clockwise [m].
        normals: (E, 2) outward unit normals of the edges.
        offsets: (E,) a point ``p`` is inside where ``normals @ p <= offsets`` [m].
    """

    vertices: Float[np.ndarray, "E 2"]
    normals: Float[np.ndarray, "E 2"]
    offsets: Float[np.ndarray, "E"]

    @staticmethod
    def of_points(points: Float[np.ndarray, "N 2"]) -> SupportPolygon:
        """Return the hull of contact points.

        Raises:
            ValueError: fewer than three points, or all on a line.
        """
        from scipy.spatial import ConvexHull  # slow to import

        points = np.asarray(points, dtype=float)
        if len(points) < 3 or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 2:
            raise ValueError("a support polygon needs three contact points that are not on a line")
        vertices = points[ConvexHull(points).vertices]
        edges = np.roll(vertices, -1, axis=0) - vertices
        normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
        return SupportPolygon(vertices, normals, np.einsum("ek,ek->e", normals, vertices))

    @staticmethod
    def of_soles(soles: Sequence[Float[np.ndarray, "C 3"]]) -> SupportPolygon:
        """Return the hull of sole corners in the world."""
        return SupportPolygon.of_points(np.concatenate([sole[:, :2] for sole in soles]))

    @property
    def depth(self) -> float:
        """Distance of the middle of the vertices from the nearest edge [m]."""
        return float(self.margin(self.vertices.mean(axis=0))[0])

    def margin(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """Return each point's distance from the nearest edge line, negative outside [m]."""
        return np.asarray((self.offsets - np.atleast_2d(points) @ self.normals.T).min(axis=1))
