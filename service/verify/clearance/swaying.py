"""How far the sway of a base that something else balances moves the bodies of a robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.robot.model import LinkBody, RobotModel
from service.verify.joint_chain import JointTree
from service.verify.motion import Sway


def bound_sways(tree: JointTree, bodies: Sequence[LinkBody], sway: Sway) -> Float[np.ndarray, "B"]:
    """Return the largest distance by which sway moves any point of each body, in whatever pose of the joints [m].

    The base frame is the world's origin.  A point at the distance r from it moves by at most
    ``distance + 2 sin(angle / 2) r``.
    """
    if not sway:
        return np.zeros(len(bodies))
    turn = 2.0 * np.sin(0.5 * np.deg2rad(sway.angle_deg))
    return np.array([sway.distance_m + turn * tree.distance(body.joint, body.vertices) for body in bodies])


def bound_largest_sway(robot: RobotModel, sway: Sway) -> float:
    """Return the largest distance by which sway moves any point of a robot with a fixed base, within its limits [m]."""
    if not sway or not robot.bodies:
        return 0.0
    travel = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
    return float(bound_sways(JointTree(robot.model, travel, 0), robot.bodies, sway).max())
