"""Constraints of a phase: frames that are led, contacts that stay in front of what they touch, torques under loads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance
from costs.kinematics import locate_frame
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import HeldTorque, PairWithin, WithinTolerance
from scopt import Constraint, Sense
from service.body.whole_body import WholeBody
from service.demands.phase import DEPTH_RESERVE, FrameMotion, TaskPhase
from service.tasks.contacts.held_pose import keep_sides
from service.tasks.held_tool import aim_tool, keep_near_line, lean_tool, place_tool, slide_tool
from service.verify import HandLoad

LINE_TOLERANCE = 2e-4  # of a frame that keeps its line, at a waypoint [m, rad]
POSITION_TOLERANCE = 5e-4  # of the tool at a waypoint [m]
TORQUE_TOLERANCE = 0.01  # share of a joint's limit
AXIS_TOLERANCE = 4e-3  # of the hand's lean at a waypoint [rad]


def keep_contacts_and_frames(
    body: WholeBody, phase: TaskPhase, waypoints: Int[np.ndarray, "S"], count: int
) -> tuple[Constraint[MotionState], ...]:
    """Return the constraints of frames that are led, and of contacts, at waypoints of a phase with ``count``."""
    if not len(waypoints):
        return ()
    led = (constraint for frame in phase.frames for constraint in lead_frame(body.robot, frame, waypoints, count))
    return (*led, *keep_sides(body, phase.contacts or (), waypoints))


def lead_frame(
    robot: RobotModel, hand: FrameMotion, waypoints: Int[np.ndarray, "S"], count: int
) -> tuple[Constraint[MotionState], ...]:
    """Return the constraints of one frame that is led."""
    places = hand.places(count)[waypoints]
    if hand.keeps_line:
        near = keep_near_line(robot, hand, waypoints, places)
        return (Constraint(f"{hand.tool} on its line", near, tolerance=LINE_TOLERANCE, unit="m or rad"),)
    name = "tool on its line" if hand.is_line else "tool at its place"
    residual = place_tool(robot, hand, waypoints, places)
    constraints = [Constraint(name, residual, Sense.EQUAL_ZERO, POSITION_TOLERANCE, unit="m")]
    if hand.slide is not None:
        along = slide_tool(robot, hand, waypoints, places)
        room = float(np.linalg.norm(hand.slide)) - POSITION_TOLERANCE
        constraints.append(
            Constraint("tool within its slide", WithinTolerance(along, room), tolerance=POSITION_TOLERANCE, unit="m")
        )
    if hand.turns_freely:
        return tuple(constraints)
    axis = PairWithin(aim_tool(robot, hand, waypoints), hand.aim_rad)
    tolerance = min(0.2 * hand.aim_rad, AXIS_TOLERANCE)
    constraints.append(Constraint("hand axis", axis, tolerance=tolerance, unit="rad"))
    if hand.way is not None:
        lean = lean_tool(robot, hand, hand.way, waypoints)
        constraints.append(Constraint("rod across the way", lean, tolerance=AXIS_TOLERANCE, unit="rad"))
    return tuple(constraints)


def limit_torques(
    body: WholeBody,
    loads: Sequence[HandLoad],
    share: float | None,
    waypoints: Int[np.ndarray, "S"],
    values: Float[np.ndarray, "T k"],
) -> Iterator[Constraint[MotionState]]:
    """Yield the limits of the torques that loads cost before the hand; none without a share of them.

    Args:
        body: the robot; its last coordinates are the mechanism's.
        loads: of the phase.
        share: of the limits that may be used.
        waypoints: where they are kept.
        values: of the mechanism's joints at all waypoints [rad, m].
    """
    if share is None or not len(waypoints):
        return
    q = np.tile(body.nominal, (len(values), 1))
    q[:, body.robot.n - values.shape[1] :] = values
    kinematics = body.engine(q)
    for number, together in enumerate(list_together(loads), start=1):
        name = "torque under the load" if number == 1 else f"torque under the load {number}"
        forces = np.zeros((len(waypoints), 3))
        for load in together:
            joint, _ = locate_frame(body.robot, load.link)
            forces -= kinematics.rotation[waypoints, joint] @ load.force
        torque = HeldTorque(body.robot, together[0].tool, waypoints, forces, share)
        yield Constraint(name, torque, tolerance=TORQUE_TOLERANCE, unit="of the limit")


def shrink(touches: Sequence[Allowance], reserve_m: float = DEPTH_RESERVE) -> tuple[Allowance, ...]:
    """Return allowances with depths for the waypoints, which leave a reserve for the curve between them [m]."""
    return tuple(replace(touch, depth=max(touch.depth - reserve_m, 0.0)) for touch in touches)


def list_together(loads: Sequence[HandLoad]) -> Iterator[tuple[HandLoad, ...]]:
    """Yield the loads that one tool may carry at the same time: each alone, then several.

    Torques are affine in the size of each load, so that these and no load at all bound every combination.
    """
    for count in range(1, len(loads) + 1):
        for together in combinations(loads, count):
            if len({load.tool for load in together}) == 1:
                yield together
