"""What the rays say about a convex body: the seen-free space in it and around it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull
from perception.convex.piece import Evidence

_AWAY = 0.05
_N_SAMPLES = 128
# Fractions of the plastic number: they fill the unit square evenly, however many are taken.
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532])


def evidence_of(hull: Hull, free: FreeSpace) -> Evidence:
    """Free cells in the hull, and how much of its surface borders free ones."""
    inside = free.count_inside(hull.faces, hull.vertices, 0.25 * free.size)
    around = _around(hull)
    near = np.concatenate([around, *(around + sign * free.size * axis for axis in np.eye(3) for sign in (-1.0, 1.0))])
    is_open = free.contains(near).reshape(7, -1).any(axis=0)
    return Evidence(inside, inside * free.size**3 / hull.volume, float(is_open.mean()))


def _around(hull: Hull) -> Float[np.ndarray, "K 3"]:
    """Places 5 cm off the hull, spread evenly over its surface."""
    corners = hull.vertices[hull.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    steps = (np.arange(_N_SAMPLES) + 0.5) / _N_SAMPLES
    chosen = np.searchsorted(np.cumsum(area) / area.sum(), steps).clip(max=len(area) - 1)
    u, v = (np.arange(1, _N_SAMPLES + 1)[:, None] * _SPREAD % 1.0).T
    flipped = u + v > 1.0
    u, v = np.where(flipped, 1.0 - u, u), np.where(flipped, 1.0 - v, v)
    first, second, third = np.moveaxis(corners[chosen], 1, 0)
    on_surface = first + u[:, None] * (second - first) + v[:, None] * (third - first)
    return np.asarray(on_surface + _AWAY * hull.faces[chosen, :3])
