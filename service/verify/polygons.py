"""Distances of points from convex polygons in the plane."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def describe_inside(inside_m: float) -> str:
    """Return ``1.2 mm inside``, or ``1.2 mm outside`` for a negative distance."""
    return f"{1e3 * inside_m:.1f} mm inside" if inside_m >= 0.0 else f"{-1e3 * inside_m:.1f} mm outside"


def outside_polygon(polygon: Float[np.ndarray, "E 2"], points: Float[np.ndarray, "S 2"]) -> Float[np.ndarray, "S"]:
    """Return the largest signed distance of points outside the polygon's edges [m]; negative inside."""
    along = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(along, axis=1)
    keep = length > 1e-12
    normal = np.stack([along[keep, 1], -along[keep, 0]], axis=1) / length[keep, None]
    return np.asarray(((points[:, None] - polygon[keep]) * normal).sum(axis=2).max(axis=1))
