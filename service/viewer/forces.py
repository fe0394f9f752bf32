"""Static regions of a result and the contact forces that hold the robot, for the viewer page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from service.verify import WORLD
from service.viewer.placements import LinkPlacements

_OUTSIDE_M = 1e-6
"""Distance outside a polygon up to which a point counts as on its edge."""

_WRENCH_TOLERANCE = 1.0
"""Difference of a wrench from a combination of others that still counts as equal [N, Nm]."""

_SUM_WEIGHT = 1e4
"""Weight of the condition that weights add to one, in the units of wrenches."""


def list_contact_points(phase: Mapping[str, Any]) -> Float[np.ndarray, "C 3"]:
    """Return the corners of all soles of a phase in the order of its contacts, in the world [m]."""
    soles = [
        np.asarray(contact.get("sole") or [], dtype=float).reshape(-1, 3) for contact in phase.get("contacts") or []
    ]
    return np.concatenate([np.empty((0, 3)), *soles])


def sum_loads(phase: Mapping[str, Any], moved: LinkPlacements) -> Float[np.ndarray, "S 6"]:
    """Return the wrench on the robot of all loads of a phase at their largest, about the world's origin [N, Nm].

    Args:
        phase: an entry of ``phases``; its loads act on the middle of their slides.
        moved: poses of the links of ``movables`` at the samples.

    Raises:
        ValueError: a load acts on a link that is no movable.
    """
    total = np.zeros((len(moved.poses), 6))
    for load in phase.get("loads") or []:
        if load["link"] == WORLD:
            force, point = -np.asarray(load["force_n"], dtype=float), np.asarray(load["place"], dtype=float)
            total += np.concatenate([force, np.cross(point, force)])
            continue
        if load["link"] not in moved.links:
            raise ValueError(f"phase {phase.get('name')!r}: a load acts on {load['link']!r}, which is no movable")
        poses = moved.poses[:, moved.links.index(load["link"])]
        turns = Rotation.from_quat(poses[:, 3:], scalar_first=True)
        force, point = -turns.apply(load["force_n"]), turns.apply(load["place"]) + poses[:, :3]
        total += np.hstack([force, np.cross(point, force)])
    return total


def find_holding_forces(
    region: Mapping[str, Any], com: Float[np.ndarray, "F k"], wrench: Float[np.ndarray, "F 6"]
) -> Float[np.ndarray, "F C 3"]:
    """Return contact forces that hold the robot at rest at places of its centre of mass, under wrenches on it [N].

    They are the combination of the region's witnesses whose vertices have that centre of mass and whose wrenches add
    to that wrench: balances of forces and friction cones are convex, so that it holds the robot
    (``costs.static_region``). Other forces may hold it as well. NaN where the centre of mass is outside or unknown, or
    the wrench is no combination of the region's.

    Args:
        region: an entry of ``phases[].regions`` with ``polygon`` (V, 2), ``wrenches`` (W, 6) and ``witnesses``
            (V, W, C, 3).
        com: (F, 2) or (F, 3) places of the centre of mass [m].
        wrench: force and moment about the world's origin [N, Nm].
    """
    vertices = find_weights(np.asarray(region["polygon"], dtype=float), np.asarray(com, dtype=float)[:, :2])
    shares = share_wrenches(np.asarray(region["wrenches"], dtype=float), wrench)
    witnesses = np.asarray(region["witnesses"], dtype=float)
    return np.asarray(np.einsum("fv,fw,vwck->fck", vertices, shares, witnesses))


def share_wrenches(wrenches: Float[np.ndarray, "W 6"], wanted: Float[np.ndarray, "F 6"]) -> Float[np.ndarray, "F W"]:
    """Return weights of wrenches whose mean each wanted one is, to 1 N and 1 Nm; NaN where there are none."""
    from scipy.optimize import nnls  # slow to import, and rarely needed

    table = np.vstack([wrenches.T, np.full(len(wrenches), _SUM_WEIGHT)])
    shares = np.full((len(wanted), len(wrenches)), np.nan)
    for row, wrench in enumerate(wanted):
        found, _ = nnls(table, np.append(wrench, _SUM_WEIGHT))
        if found.sum() > 0.0 and np.abs(wrenches.T @ (found / found.sum()) - wrench).max() <= _WRENCH_TOLERANCE:
            shares[row] = found / found.sum()
    return shares


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
