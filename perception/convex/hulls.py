"""Convex hulls with a limited number of vertices, also of flat point sets."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError

from costs.stopping import poll
from perception.cleaning.clean import row_keys

MAX_VERTICES = 64
SKIN = 0.005
_FACES = 8
_NOTHING = np.arange(0)
# Corners of an octahedron: the smallest symmetric body that gives flat points a volume.
_OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True)
class Hull:
    """A convex hull and the points it was made of.

    Attributes:
        triangles: (F, 3) vertex indices of its faces.
        faces: (F, 4) half-spaces ``a . x + b <= 0``, one for each triangle.
        members: (K,) indices of the points it was made of.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]
    faces: Float[np.ndarray, "F 4"]
    volume: float
    members: Int[np.ndarray, "K"]

    @property
    def lower(self) -> Float[np.ndarray, "3"]:
        """Lower corner of the bounding box [m]."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def upper(self) -> Float[np.ndarray, "3"]:
        """Upper corner of the bounding box [m]."""
        return np.asarray(self.vertices.max(axis=0))

    @property
    def simplified(self) -> Hull:
        """Return the hull with repeated face planes removed and without triangles."""
        rounded = np.round(self.faces, 9)
        faces = rounded[np.unique(row_keys(rounded), return_index=True)[1]]
        return replace(self, faces=faces, triangles=self.triangles[:0])

    def is_within(self, points: Float[np.ndarray, "N 3"], margin: float) -> Bool[np.ndarray, "N"]:
        """Return which points lie inside all faces or at most ``margin`` [m] outside them."""
        poll()
        left = np.arange(len(points))
        # The first few faces exclude most points.
        for first in range(0, len(self.faces), _FACES):
            some = self.faces[first : first + _FACES]
            left = left[(some[:, :3] @ points[left].T <= margin - some[:, 3:]).all(axis=0)]
        inside = np.zeros(len(points), dtype=bool)
        inside[left] = True
        return inside


def make_hull(points: Float[np.ndarray, "N 3"], members: Int[np.ndarray, "K"] = _NOTHING) -> Hull:
    """Return the convex hull of the points; flat point sets are thickened by 5 mm first."""
    poll()
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        points = thicken(points, SKIN)
        hull = ConvexHull(points)
    number = np.zeros(len(points), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return Hull(points[hull.vertices], number[hull.simplices], hull.equations, float(hull.volume), members)


def thicken(points: Float[np.ndarray, "N 3"], skin: float) -> Float[np.ndarray, "M 3"]:
    """Return six copies of each point, moved by ``skin`` [m] along each axis both ways; their hull has that margin."""
    return np.asarray((points[:, None, :] + skin * _OCTAHEDRON).reshape(-1, 3))


def limit_vertices(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
    """Return at most 64 vertices whose hull contains the hull of the given ones.

    Keeps the extreme vertices in evenly spread directions and scales them about their centre until they contain all.
    """
    poll()
    vertices = vertices[ConvexHull(vertices).vertices]
    if len(vertices) <= MAX_VERTICES:
        return vertices
    k = np.arange(MAX_VERTICES)
    z = 1.0 - 2.0 * (k + 0.5) / MAX_VERTICES
    angle = np.pi * (3.0 - np.sqrt(5.0)) * k
    spread = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    # Directions are scaled with the hull's shape, or a long thin hull would have all its vertices at its ends.
    centred = vertices - vertices.mean(axis=0)
    _, scale, axes = np.linalg.svd(centred, full_matrices=False)
    directions = (spread / np.maximum(scale, 1e-3 * scale[0])) @ axes
    kept = vertices[np.unique(np.argmax(vertices @ directions.T, axis=0))]
    hull = ConvexHull(kept)
    centre = kept.mean(axis=0)
    depth = -(hull.equations[:, :3] @ centre + hull.equations[:, 3])
    reach = (vertices - centre) @ hull.equations[:, :3].T
    factor = max(1.0, float((reach / depth).max()))
    return np.asarray(centre + factor * (kept - centre))
