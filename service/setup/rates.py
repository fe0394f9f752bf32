"""Rates at which joints move at the start and at the goal: those that no motion can have are refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from costs.work_space import borrow_data
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.start.configuration import find_unknown_joints, is_sliding
from service.verify import place_rates

FOOT_M_S = 1e-3  # of a planted link that still counts as standing
ROUNDING = 1e-9  # share of a limit


def check_rates(
    robot: RobotModel, start: Float[np.ndarray, "n"], request: PlanRequest, planted: Mapping[str, np.ndarray]
) -> None:
    """Check the rates of a request against its other fields, the limits of its joints, and the links that stand.

    Args:
        robot: the robot.
        start: configuration at the start.
        request: the request.
        planted: (C, 3) sole corners of each planted link at the start [m].

    Raises:
        RequestError: one line per rate that is not possible.
    """
    problems: list[str] = []
    start_rates, end_rates = request.end_rates
    goal = {} if request.goal is None else dict(request.goal.joints)
    places = (("start.rates", start_rates, dict(zip(robot.joint_names, start.tolist(), strict=True)), 1.0),)
    for field, rates, positions, ahead in (*places, ("goal.rates", end_rates, goal, -1.0)):
        if not rates:
            continue
        wrong = [*_list_contradictions(field, request), *find_unknown_joints(robot, rates, field)]
        problems += wrong
        if not wrong:
            problems += _list_limits(robot, request, field, rates, positions, ahead)
            problems += _list_moved_feet(robot, start, field, rates, planted)
    if problems:
        raise RequestError(problems)


def _list_contradictions(field: str, request: PlanRequest) -> Iterator[str]:
    """Yield a line for each other field with which no end is in motion."""
    options = request.options
    if request.task is not None:
        yield f"{field}: given with a task, which begins and ends at rest; expected a goal"
    if request.resume is not None:
        yield f"{field}: given with resume, which begins at rest; leave one of them out"
    if not options.timed:
        yield f"{field}: given with options.timed: false, and a path without times has no rates; leave one of them out"
    if options.jerk_scale is not None:
        scale = f"options.jerk_scale {options.jerk_scale:g}"
        yield f"{field}: given with {scale}, which holds from rest to rest; leave one of them out"


def _list_limits(
    robot: RobotModel,
    request: PlanRequest,
    field: str,
    rates: Mapping[str, float],
    positions: Mapping[str, float],
    ahead: float,
) -> Iterator[str]:
    """Yield a line for each rate beyond the used speed limits, or with too little way to brake (or to speed up).

    ``ahead`` is 1 where the joint moves on from its position, -1 where it arrives there.
    """
    speed = robot.velocity * request.options.speed_share
    acceleration = robot.acceleration * request.options.acceleration_share
    for name, rate in rates.items():
        k, unit = robot.joint_names.index(name), "m" if is_sliding(robot, name) else "rad"
        if abs(rate) > speed[k] * (1.0 + ROUNDING):
            yield (
                f"{field}.{name}: {rate:g} {unit}/s is faster than the share of its speed limit that options allow; "
                f"expected at most {speed[k]:.4g} {unit}/s"
            )
            continue
        if name not in positions:
            continue
        way = 0.5 * rate**2 / acceleration[k]
        goes_up = ahead * rate > 0.0
        room = float(robot.upper[k] - positions[name] if goes_up else positions[name] - robot.lower[k])
        if way > room * (1.0 + ROUNDING):
            fastest, does = np.sqrt(2.0 * acceleration[k] * max(room, 0.0)), "brake" if ahead > 0.0 else "get up to it"
            yield (
                f"{field}.{name}: to {does}, {rate:g} {unit}/s needs {way:.3g} {unit} before the joint's limit, "
                f"which is {room:.3g} {unit} away; expected at most {fastest:.3g} {unit}/s"
            )


def _list_moved_feet(
    robot: RobotModel,
    q: Float[np.ndarray, "n"],
    field: str,
    rates: Mapping[str, float],
    planted: Mapping[str, np.ndarray],
) -> Iterator[str]:
    """Yield a line for each planted link that the rates would move."""
    model, data, v = robot.model, borrow_data(robot.model), place_rates(robot, rates)
    pin.forwardKinematics(model, data, q, v)
    for link, corners in planted.items():
        twist = pin.getFrameVelocity(model, data, model.getFrameId(link), pin.ReferenceFrame.WORLD)
        fastest = float(np.linalg.norm(twist.linear + np.cross(twist.angular, corners), axis=1).max())
        if fastest > FOOT_M_S:
            yield (
                f"{field}: {', '.join(sorted(rates))} would move the planted {link} by {fastest:.3g} m/s; "
                "expected rates with which the planted links stand"
            )
