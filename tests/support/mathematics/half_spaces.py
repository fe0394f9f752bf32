"""Half-spaces of convex hulls."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull


def half_spaces(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "F 4"]:
    """Return faces (a, b) of the hull with ``a . x + b <= 0`` inside, ``a`` of length one."""
    # Triangulated faces repeat their plane.
    return np.asarray(np.unique(np.round(ConvexHull(vertices).equations, 9), axis=0))
