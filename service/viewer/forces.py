"""Static regions of a result and the contact forces that hold the robot, for the viewer page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

_OUTSIDE_M = 1e-6
"""Distance outside a polygon up to which a point counts as on its edge."""


def list_contact_points(phase: Mapping[str, Any]) -> Float[np.ndarray, "C 3"]:
    """Return the corners of all soles of a phase in the order of its contacts, in the world [m]."""
    soles = [
        np.asarray(contact.get("sole") or [], dtype=float).reshape(-1, 3) for contact in phase.get("contacts") or []
    ]
    return np.concatenate([np.empty((0, 3)), *soles])


def find_holding_forces(region: Mapping[str, Any], com: Float[np.ndarray, "F k"]) -> Float[np.ndarray, "F C 3"]:
    """Return contact forces that hold the robot under the last wrench of a region [N].

    They are the combination of the vertices' witnesses that makes the centre of mass of the vertices; balances of
    forces and friction cones are convex, so it holds the robot there (``costs.static_region``). Other forces may hold
    it as well. NaN where the centre of mass is outside or unknown.

    Args:
        region: an entry of ``phases[].regions`` with ``polygon`` (V, 2) and ``witnesses`` (V, W, C, 3).
        com: (F, 2) or (F, 3) places of the centre of mass [m].
    """
    witnesses = np.asarray(region["witnesses"], dtype=float)[:, -1]
    weights = find_weights(np.asarray(region["polygon"], dtype=float), np.asarray(com, dtype=float)[:, :2])
    return np.asarray(np.einsum("fv,vck->fck", weights, witnesses))


def find_weights(polygon: Float[np.ndarray, "V 2"], points: Float[np.ndarray, "F 2"]) -> Float[np.ndarray, "F V"]:
    """Return weights of a convex polygon's vertices whose mean each point is; NaN for a point outside.

    Mean value coordinates: Floater, Mean value coordinates, CAGD 2003, eq. 1; on an edge, its two ends only.
    """
    return np.array([_weigh_vertices(polygon, point) for point in points]).reshape(len(points), len(polygon))


def _weigh_vertices(polygon: Float[np.ndarray, "V 2"], point: Float[np.ndarray, "2"]) -> Float[np.ndarray, "V"]:
    n = len(polygon)
    after = np.roll(polygon, -1, axis=0)
    sides = after - polygon
    lengths = np.linalg.norm(sides, axis=1)
    if np.sum(polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0]) < 0.0:
        return _weigh_vertices(polygon[::-1], point)[::-1]
    kept = lengths > 0.0
    away = point - polygon
    inside = (sides[:, 0] * away[:, 1] - sides[:, 1] * away[:, 0])[kept] / lengths[kept]
    if not np.all(inside >= -_OUTSIDE_M):
        return np.full(n, np.nan)
    nearest = int(np.flatnonzero(kept)[inside.argmin()])
    if inside.min() <= _OUTSIDE_M:
        share = float(np.clip(away[nearest] @ sides[nearest] / lengths[nearest] ** 2, 0.0, 1.0))
        weights = np.zeros(n)
        weights[[nearest, (nearest + 1) % n]] = 1.0 - share, share
        return weights
    distance = np.linalg.norm(away, axis=1)
    seen = np.roll(away, -1, axis=0)
    turn = np.arctan2(away[:, 0] * seen[:, 1] - away[:, 1] * seen[:, 0], np.sum(away * seen, axis=1))
    tangent = np.tan(0.5 * turn)
    weights = (tangent + np.roll(tangent, 1)) / distance
    return np.asarray(weights / weights.sum())
