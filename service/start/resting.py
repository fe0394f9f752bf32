"""Carried bodies that rest on pieces at the start: they may touch these until they are raised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.start.overlaps import ExactShape
from service.start.standing import find_sole, place_bodies
from service.verify import UNSEEN_KIND, find_ground_gaps

SUPPORT_DEPTH_M = 2e-3  # of an object in what it rests on, as it is lifted and put down
TOUCHING_M = 5e-4  # farthest above a piece that a body rests on it
NEAR_M = 0.01  # between a body and a piece that are compared


def find_rests(
    robot: RobotModel, q: Float[np.ndarray, "n"], pieces: Sequence[ConvexPiece], carried: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Return the carried bodies that rest on pieces, as names of link and piece: at most 0.5 mm above, or 2 mm inside.

    The piece is below a corner of the body's lower face, or ends below it.  What is unseen carries nothing.
    """
    rests = []
    for link in carried:
        for body, vertices in place_bodies(robot, q, link):
            sole, shape = find_sole([vertices]), ExactShape.of_hull(replace(body, vertices=vertices))
            for piece in pieces:
                is_below = piece.upper[2] <= sole[:, 2].min() + SUPPORT_DEPTH_M
                gap = float(piece.upper[2] - sole[:, 2].min()) if is_below else find_ground_gaps(sole, [piece]).min()
                if piece.kind == UNSEEN_KIND or not np.abs(gap) <= NEAR_M:
                    continue
                if -TOUCHING_M <= shape.depth_in(ExactShape.of_hull(piece)) <= SUPPORT_DEPTH_M:
                    rests.append((link, piece.name))
    return tuple(dict.fromkeys(rests))
