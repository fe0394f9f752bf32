"""Convex hulls of link shapes, and outer hulls of few vertices that contain them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from costs.robot.errors import RobotError

MAX_OUTER_VERTICES = 32


def hull_vertices(points: Float[np.ndarray, "V 3"], where: str) -> Float[np.ndarray, "W 3"]:
    """Vertices of the convex hull of ``points``, in their order.

    Raises:
        RobotError: when the points lie in a plane: such a hull has no inside to be in collision with.
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        raise RobotError(f"{where}: its points lie in a plane; a body needs a volume") from None
    return np.ascontiguousarray(points[np.sort(hull.vertices)])


def outer_hull(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
    """Axis-aligned box in the principal frame."""
    centre = vertices.mean(axis=0)
    axes = np.linalg.svd(vertices - centre, full_matrices=False)[2]
    local = (vertices - centre) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return np.asarray(centre + (low + corners * (high - low)) @ axes)
