"""Convex hulls of link shapes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from costs.robot.errors import RobotError


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
