"""Signed distance of two convex vertex sets, by another road than GJK and EPA."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

TOUCHING = 1e-9


def signed_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of the hulls of (V, 3) and (W, 3) points; minus the least separating translation when they overlap.

    The distance is the norm of the least point of the Minkowski difference.  It is found by non-negative least
    squares: over the cone of ``(D' w, sum w)`` the point nearest to (0, 1) lies above the least point of the hull.
    The depth is the distance from the origin to the nearest facet of the difference.
    """
    difference = (a[:, None, :] - b[None, :, :]).reshape(-1, 3)
    system = np.vstack([difference.T, np.ones(len(difference))])
    weights, _ = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))
    distance = float(np.linalg.norm(difference.T @ weights) / weights.sum())
    if distance > TOUCHING:
        return distance
    return -float(np.min(-ConvexHull(difference).equations[:, 3]))


def box(centre, size) -> np.ndarray:
    """(8, 3) corners of an axis-aligned box."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return np.asarray(centre) + corners * np.asarray(size)
