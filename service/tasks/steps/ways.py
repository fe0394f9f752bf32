"""Frames on their ways: residuals at shares of them, how many waypoints they need, and where an arm cannot follow."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, Joined, OnGuide
from scopt import Residual
from service.body.holds import POSITION, ROTATION, Hold, largest_hold_error
from service.body.whole_body import WholeBody
from service.demands.steps.phases import Led

WAY_STEP_M, WAY_STEP_RAD = 0.04, float(np.deg2rad(12.0))  # of a frame between two waypoints
FLOW_STEP_M = 0.015  # between two waypoints of a path that goes round corners without a rest
LEAST_WAYPOINTS, MOST_WAYPOINTS = 6, 60
FOLLOWED = 1e-3  # largest residual of a waypoint that follows its way
AT_LIMIT, LARGEST_JUMP = 0.02, 0.8  # of a joint at its limit, and of one between two waypoints [rad, m]


def count_waypoints(led: Sequence[Led], *, flows: bool = False) -> int:
    """Return the number of waypoints of ways; those of a path without rests are as far apart as on its other parts."""
    length = max((own.guide.length for own in led), default=0.0)
    if flows:
        return int(np.clip(np.ceil(length / FLOW_STEP_M) + 1, 3, MOST_WAYPOINTS))
    turn = max((max(own.guide.turned, abs(own.guide.angle)) for own in led), default=0.0)
    steps = max(length / WAY_STEP_M, turn / WAY_STEP_RAD)
    return int(np.clip(np.ceil(steps) + 1, LEAST_WAYPOINTS, MOST_WAYPOINTS))


def stay_on(robot: RobotModel, led: Led, waypoints: np.ndarray) -> OnGuide:
    """Return how far a frame is off its way, wherever it is on it."""
    return OnGuide(
        robot,
        led.frame,
        waypoints,
        led.guide,
        led.free_axis,
        turns_freely=led.turns_freely,
        moves_freely=led.moves_freely,
    )


def hold_share(body: WholeBody, led: Led, share: float) -> Hold:
    """Return the hold of a frame at a share of its way."""
    pose = led.guide.poses(np.array([share]))[0]
    return lambda waypoints: Joined([term for _, term, _ in measure_led(body, led, waypoints, pose[None])])


def measure_led(
    body: WholeBody, led: Led, waypoints: np.ndarray, poses: Float[np.ndarray, "#S 4 4"]
) -> list[tuple[str, Residual[MotionState], str]]:
    """Return name, residual and unit of what a led frame keeps at poses."""
    robot = body.robot
    terms: list[tuple[str, Residual[MotionState], str]] = []
    if not led.moves_freely:
        terms.append((f"place of {led.frame}", FramePose(robot, led.frame, waypoints, poses, POSITION), "m"))
    if led.turns_freely:
        return terms
    if led.free_axis is None:
        terms.append((f"orientation of {led.frame}", FramePose(robot, led.frame, waypoints, poses, ROTATION), "rad"))
        return terms
    axis = led.free_axis
    directions = poses[:, :3, :3] @ axis
    if np.ptp(directions, axis=0).max() < 1e-9:
        leans: Residual[MotionState] = AxisDirection(robot, led.frame, waypoints, axis, directions[0])
    else:
        each = zip(waypoints.tolist(), directions, strict=True)
        leans = Joined([AxisDirection(robot, led.frame, [k], axis, way) for k, way in each])
    terms.append((f"axis of {led.frame}", leans, "rad"))
    return terms


def explain_break(body: WholeBody, led: Sequence[Led], path: Float[np.ndarray, "T n"]) -> Iterator[str]:
    """Yield a sentence where inverse kinematics alone leaves the ways: out of reach, at joint limits, or by a jump."""
    robot, shares = body.robot, np.linspace(0.0, 1.0, len(path))
    lower, upper = (bound[0] for bound in body.bounds(1, {}))
    remedy = "a shorter way or a free_axis would help"
    for own in led:
        each = zip(path, shares, strict=True)
        error = np.array([largest_hold_error(body.engine, q[None], [hold_share(body, own, s)])[0] for q, s in each])
        off = np.flatnonzero(error > FOLLOWED)
        if not len(off):
            continue
        q, share = path[off[0]], 100.0 * shares[max(off[0] - 1, 0)]
        is_stuck = (q <= lower + AT_LIMIT) | (q >= upper - AT_LIMIT)
        names = np.array(robot.joint_names)[is_stuck & np.isfinite(robot.lower)].tolist()
        why = "there the arm reaches no farther"
        if names:
            why = f"there {', '.join(names)} {'is at its limit' if len(names) == 1 else 'are at their limits'}"
        yield f"{own.frame} follows its way to {share:.0f} %: {why}; {remedy}"
        return
    steps = np.abs(np.diff(path, axis=0))
    at, column = np.unravel_index(int(steps.argmax()), steps.shape)
    if steps[at, column] > LARGEST_JUMP:
        name, jump = robot.joint_names[column], steps[at, column]
        between = f"{100.0 * shares[at]:.0f} and {100.0 * shares[at + 1]:.0f} %"
        yield f"{name} jumps by {jump:.2f} rad between {between} of the way; {remedy}"
