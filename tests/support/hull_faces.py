"""Faces of the hull of vertices, made apart from the hulls of ``perception``."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull


def half_spaces(vertices: np.ndarray) -> np.ndarray:
    """Return the faces (F, 4), ``a . x + b <= 0`` inside, ``a`` of length one, each plane once."""
    return np.asarray(np.unique(np.round(ConvexHull(vertices).equations, 9), axis=0))
