"""Whether a shut leaf can be pushed, pulled, or both, as far as what stands about it tells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.scene import ConvexPiece
from perception.detect.door.geometry import UP, DoorGeometry, Opens
from perception.detect.door.model import choose_opening
from service.verify import CoalSolid, DistanceQuery

ANGLES = np.deg2rad([0.0, 2.0, 4.0, 6.0, 8.0, 10.0])
INSET_M, ABOVE_FLOOR_M = 0.005, 0.03  # by which the leaf is taken smaller than it was seen
MEETS_M = 0.01  # by which it goes deeper into a piece than it was while shut


def list_free_openings(geometry: DoorGeometry, pieces: Sequence[ConvexPiece]) -> tuple[Opens, ...]:
    """Return the ways of opening in which the leaf does not meet a piece within its first 10 deg.

    Args:
        geometry: a door that is seen shut, or hardly ajar.
        pieces: of the scene, without the door itself.
    """
    ways: tuple[Opens, ...] = ("push", "pull")
    return tuple(opens for opens in ways if find_met_at_once(choose_opening(geometry, opens), pieces) is None)


def find_met_at_once(door: DoorGeometry, pieces: Sequence[ConvexPiece]) -> str | None:
    """Return the piece that a leaf meets within its first 10 deg; None where it meets none."""
    leaf = _list_corners(door)
    middle, reach = door.hinge + 0.5 * door.height * UP, float(np.hypot(door.width, door.height)) + door.thickness
    rotation = np.stack([Rotation.from_rotvec(angle * door.hinge_axis).as_matrix() for angle in ANGLES])
    shift = door.hinge - rotation @ door.hinge
    own, query = CoalSolid("leaf", "", 0, leaf).convex, DistanceQuery()
    for piece in pieces:
        beside = np.maximum(np.maximum(piece.lower - middle, middle - piece.upper), 0.0)
        if piece.kind == "floor" or np.linalg.norm(beside) > reach:
            continue
        still = [CoalSolid.of_piece(piece).convex] * len(ANGLES)
        distance, _ = query.closest([own] * len(ANGLES), rotation, shift, still)
        if distance[1:].min() < min(float(distance[0]), 0.0) - MEETS_M:
            return piece.name
    return None


def _list_corners(door: DoorGeometry) -> Float[np.ndarray, "8 3"]:
    """Return the corners of the shut leaf [m]."""
    along = np.array([INSET_M, door.width - INSET_M])
    out = np.array([door.face - door.thickness + INSET_M, door.face - INSET_M])
    up = np.array([ABOVE_FLOOR_M, door.height - INSET_M])
    x, y, z = (values.ravel()[:, None] for values in np.meshgrid(along, np.sort(out), up, indexing="ij"))
    return np.asarray(door.hinge + x * door.along + y * door.normal + z * UP)
