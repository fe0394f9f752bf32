"""Proof that an object at rest stays where it is: the pieces that it touches hold its weight."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
from jaxtyping import Float

from costs.robot import LinkBody
from costs.scene import ConvexPiece
from service.verify.forces.pads import find_contact_corners
from service.verify.forces.rounded import RoundedBody, list_round_contact
from service.verify.solids import make_coal_convex

REST_GAP_M = 3e-3  # between an object and what carries it, either way
REST_FRICTION = 0.3
STEEPEST = 0.5  # least upward part of the normal of a contact that holds by friction, too: walls do not squeeze
SIDES = 8
DIRECTIONS = 8  # in which the centre of mass may be off
FARTHEST_M = 1.0  # that it may be off: what is held from above as well could be anywhere


def measure_rest_margin(
    body: LinkBody, centre: Float[np.ndarray, "3"], pieces: Sequence[ConvexPiece]
) -> tuple[float, tuple[str, ...]]:
    """Return how far a resting object's centre of mass may be off to any side, and the pieces that it touches.

    Args:
        body: the object, in the world [m].
        centre: (3,) its centre of mass in the world [m].
        pieces: the scene.

    Returns:
        The margin, negative infinity where nothing holds the object [m]; names of the pieces within ``REST_GAP_M``.
    """
    points, normals, names = [], [], []
    for piece in pieces:
        spots, normal = find_rest_contact(body, piece)
        if len(spots):
            points.append(spots)
            normals.append(np.tile(normal, (len(spots), 1)))
            names.append(piece.name)
    if not points:
        return -np.inf, ()
    every = np.concatenate(normals)
    friction = np.where(every[:, 2] >= STEEPEST, REST_FRICTION, 0.0)
    return measure_margin_on(np.concatenate(points), every, centre, friction), tuple(names)


def measure_margin_on(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    centre: Float[np.ndarray, "3"],
    friction: Float[np.ndarray, "P"],
) -> float:
    """Return how far a weight at ``centre`` may be off to any side of what contact points hold [m].

    It is negative infinity where they do not hold it.

    Args:
        points, normals: of the contacts, into the object.
        centre: (3,) of mass.
        friction: (P,) coefficients.
    """
    edges = _list_edges(points, normals, centre, friction)
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return min(_find_farthest(edges, np.array([np.cos(angle), np.sin(angle)])) for angle in angles.tolist())


def find_rest_contact(body: LinkBody, piece: ConvexPiece) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "3"]]:
    """Return where a piece carries an object, and the normal into the object; no points where they do not touch."""
    low, high = body.vertices.min(axis=0) - REST_GAP_M, body.vertices.max(axis=0) + REST_GAP_M
    if np.any(piece.lower > high) or np.any(piece.upper < low):
        return np.zeros((0, 3)), np.zeros(3)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    solid, place = RoundedBody.of_body(body), coal.Transform3s()
    apart = float(coal.distance(make_coal_convex(piece.vertices), place, solid.core, solid.pose, request, result))
    normal = np.array(result.normal)
    if abs(apart - solid.radius) > REST_GAP_M:
        return np.zeros((0, 3)), normal
    point = np.array(result.getNearestPoint1())
    line = list_round_contact(body, normal, 0.0)
    spots = find_contact_corners(piece.vertices, body.vertices, normal) if line is None else line
    if not len(spots):
        return point[None], normal
    return np.asarray(spots + (point @ normal) * normal), normal


def _list_edges(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    centre: Float[np.ndarray, "3"],
    friction: Float[np.ndarray, "P"],
) -> Float[np.ndarray, "6 E"]:
    """Return the wrenches about ``centre`` of the edges of all friction pyramids."""
    basis = np.linalg.svd(normals[:, None])[2][:, 1:]
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ basis
    forces = normals[:, None] + friction[:, None, None] * around
    arms = np.cross((points - centre)[:, None], forces)
    return np.asarray(np.concatenate([forces, arms], axis=2).reshape(-1, 6).T)


def _find_farthest(edges: Float[np.ndarray, "6 E"], direction: Float[np.ndarray, "2"]) -> float:
    """Return how far a weight of 1 N may be off in a direction; negative infinity where the edges hold none [m]."""
    from scipy.optimize import linprog  # slow to import, and rarely needed

    # The moment about the centre of a unit weight at ``t * direction`` is t * (-dy, dx, 0); forces balance it.
    count = edges.shape[1]
    shift = np.array([0.0, 0.0, 0.0, -direction[1], direction[0], 0.0])
    found = linprog(
        np.append(np.zeros(count), -1.0),
        A_eq=np.hstack([edges, shift[:, None]]),
        b_eq=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        bounds=[(0.0, None)] * count + [(None, FARTHEST_M)],
        method="highs",
    )
    return float(found.x[-1]) if found.status == 0 and found.x is not None else -np.inf
