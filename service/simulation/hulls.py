"""Convex hulls for the physics: faces moved inwards, level tops, and boxes among hulls."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

_FLAT_M = 1e-7


def shrink_hull(vertices: Float[np.ndarray, "V 3"], depth: float) -> Float[np.ndarray, "W 3"]:
    """Return a hull whose faces are moved inwards by a depth [m]; by less where nothing would be left."""
    if depth <= 0.0:
        return vertices
    try:
        faces = ConvexHull(vertices).equations
    except QhullError:  # flat
        return vertices
    middle, radius = _find_middle(faces)
    if radius <= _FLAT_M:
        return vertices
    moved = faces.copy()
    moved[:, 3] += min(depth, 0.9 * radius)
    corners = HalfspaceIntersection(moved, middle).intersections
    return np.unique(np.round(corners, 9), axis=0)


def find_level_top(vertices: Float[np.ndarray, "V 3"]) -> float | None:
    """Return the height of a hull's level upper face [m]; None where its upper side leans or has an edge on top."""
    top = float(vertices[:, 2].max())
    upper = vertices[vertices[:, 2] > top - 1e-6]
    spread = np.ptp(vertices[:, :2], axis=0)
    return top if len(upper) >= 3 and bool(np.all(np.ptp(upper[:, :2], axis=0) > 0.9 * spread)) else None


def _find_middle(faces: Float[np.ndarray, "F 4"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Return centre and radius of the largest ball inside half-spaces ``n . x + d <= 0``."""
    table = np.column_stack([faces[:, :3], np.ones(len(faces))])
    found = linprog([0.0, 0.0, 0.0, -1.0], table, -faces[:, 3], bounds=[(None, None)] * 3 + [(0.0, None)])
    if found.x is None:
        return np.zeros(3), 0.0
    return found.x[:3], float(found.x[3])
