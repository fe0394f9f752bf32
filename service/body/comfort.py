"""Costs of comfort: small displacements, upright links, and a centre of mass well inside what holds the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.robot import BASE_NAMES, RobotModel
from costs.state import MotionState
from costs.support import SupportPolygon
from costs.terms import (
    AxisDirection,
    CentreOfMassAt,
    CentreOfMassInPolygon,
    Joined,
    JointDifference,
    JointTarget,
    Positive,
)
from scopt import Cost, Residual
from service.body.forces.loaded_regions import PlannedRegion

UPRIGHT_WEIGHT = 10.0  # of pelvis and torso, averaged over the waypoints [cost/rad^2]
BASE_WEIGHTS = np.array([6.0, 6.0, 6.0, 2.0, 2.0, 2.0])  # 1 m of the base counts as 6 rad of a joint
BALANCE_WEIGHT = 50.0  # averaged over the waypoints [cost/m^2]
RESERVE_M = 0.045  # balance margin that is enough for position servos, and a little for the curve between waypoints [m]
RESERVE_WEIGHT = 2000.0  # of what is missing of it, averaged over the waypoints [cost/m^2]


def smooth_joints(
    robot: RobotModel, nominal: Float[np.ndarray, "n"], n_waypoints: int
) -> tuple[Cost[MotionState], ...]:
    """Return costs of joint displacement, the same for a finer trajectory of the same motion."""
    weights = np.ones(robot.n)
    if robot.is_floating:
        weights[: len(BASE_NAMES)] = BASE_WEIGHTS
    joints = np.arange(len(BASE_NAMES) if robot.is_floating else 0, robot.n)
    posture = JointTarget(n_waypoints, robot.n, np.arange(n_waypoints), joints, nominal[joints])
    costs: list[Cost[MotionState]] = [Cost("nominal posture", posture, weight=0.05 / n_waypoints)]
    if n_waypoints > 1:
        costs.append(Cost("displacement", JointDifference(n_waypoints, weights), weight=0.2 * n_waypoints))
    return tuple(costs)


def keep_upright(robot: RobotModel, everywhere: Int[np.ndarray, "T"]) -> tuple[Cost[MotionState], ...]:
    """Return costs that keep the links of the robot's upright group upright."""
    up = np.array([0.0, 0.0, 1.0])
    return tuple(
        Cost(
            f"upright {link}",
            AxisDirection(robot, link, everywhere, up, up),
            weight=UPRIGHT_WEIGHT / len(everywhere),
        )
        for link in robot.link_groups.get("upright", ())
    )


def keep_balanced(
    polygon: SupportPolygon | None,
    regions: Sequence[PlannedRegion],
    everywhere: Int[np.ndarray, "T"],
    *,
    wants_reserve: bool,
) -> tuple[Cost[MotionState], ...]:
    """Return costs that keep the centre of mass near the middle of where the feet hold it, and off its edges.

    The first makes motions faster; the second leaves position servos a margin to sag by.

    Args:
        polygon: of the soles, which holds the robot unless regions do; None for a fixed base.
        regions: by stretches of the waypoints.
        everywhere: the waypoints.
        wants_reserve: whether to have the second one; single poses never do, which would take half as long again.
    """
    middle: Residual[MotionState]
    inside: Residual[MotionState]
    if regions:
        middle = Joined(
            [
                CentreOfMassAt(planned.region.vertices.mean(axis=0), everywhere[planned.first : planned.last + 1])
                for planned in regions
            ]
        )
        inside = Joined([keep_in_region(planned, everywhere, RESERVE_M) for planned in regions])
    elif polygon is not None:
        middle = CentreOfMassAt(polygon.vertices.mean(axis=0), everywhere)
        inside = CentreOfMassInPolygon(polygon, everywhere, RESERVE_M)
    else:
        return ()
    comfort = Cost("comfortable balance", middle, BALANCE_WEIGHT / len(everywhere))
    if not wants_reserve or len(everywhere) == 1:
        return (comfort,)
    return (comfort, reserve_balance(inside, len(everywhere)))


def reserve_balance(outside: Residual[MotionState], n_waypoints: int) -> Cost[MotionState]:
    """Return the cost of a balance margin in which position servos have too little room to sag.

    Args:
        outside: distance of the centre of mass outside of what holds the robot, which is made smaller by the margin
            that is enough, ``RESERVE_M`` [m].
        n_waypoints: at which it is measured.
    """
    return Cost("balance for servos", Positive(outside), RESERVE_WEIGHT / n_waypoints)


def keep_in_region(planned: PlannedRegion, everywhere: Int[np.ndarray, "T"], margin: float) -> Residual[MotionState]:
    """Return the distance of the centre of mass outside a region, at the waypoints of its stretch [m]."""
    waypoints = everywhere[planned.first : planned.last + 1]
    return CentreOfMassInPolygon(planned.region.polygon, waypoints, margin + planned.shift_m)
