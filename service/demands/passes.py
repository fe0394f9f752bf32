"""Which of several goals a motion ends at, and where it passes the places on its way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from costs.work_space import borrow_data
from service.demands.phase import EndTarget
from service.demands.targets import make_goal_targets
from service.request.tasks.reach import GoalPartRequest, GoalRequest
from service.verify import (
    JointTarget,
    Motion,
    Phase,
    PoseTarget,
    RegionTarget,
    limits_rotation,
    list_position_demands,
    measure_angle,
    measure_lean,
    offset_from_target,
)

SAME_PLACE = 1e-9  # of path parameters
LEAST_LIMIT = 1e-6  # of a tolerance, so that errors have a ratio [m, rad]
STEPS = 8  # places between two knots at which a motion is tried


def choose_alternative(robot: RobotModel, goal: GoalRequest, q: Float[np.ndarray, "n"]) -> int:
    """Return the goal of which a configuration keeps all tolerances, the first of several; else the nearest one."""
    parts = goal.alternatives
    if len(parts) == 1:
        return 0
    misses = [measure_miss(robot, make_goal_targets(robot, part, q), q) for part in parts]
    kept = [k for k, miss in enumerate(misses) if miss <= 1.0]
    return kept[0] if kept else int(np.argmin(misses))


def find_passes(robot: RobotModel, goal: GoalRequest, recorded: Motion, last: Phase) -> tuple[EndTarget, ...]:
    """Return the targets of the places on the way, in their order, at the path parameters where a motion passes them.

    These are the ones of the record where it says them, else the first ones that keep all tolerances.
    """
    if not goal.via:
        return ()
    places = [getattr(target, "at", None) for target in last.targets]
    at = sorted({float(place) for place in places if place is not None and place < last.last - SAME_PLACE})
    if len(at) != len(goal.via):
        at = _search_passes(robot, goal.via, recorded, last)
    near = [recorded.curve(np.array([s]))[0, : robot.n] for s in at]
    return make_passes(robot, goal, at, near)


def make_passes(
    robot: RobotModel, goal: GoalRequest, at: Sequence[float], near: Sequence[Float[np.ndarray, "n"]]
) -> tuple[EndTarget, ...]:
    """Return the targets of the places on the way at path parameters; joints by turns to ``near``."""
    return tuple(
        replace(target, at=s)
        for part, s, q in zip(goal.via, at, near, strict=True)
        for target in make_goal_targets(robot, part, q)
    )


def _search_passes(robot: RobotModel, via: Sequence[GoalPartRequest], motion: Motion, phase: Phase) -> list[float]:
    """Return path parameters in rising order at which a motion passes places, or comes nearest to them."""
    knots = motion.curve.knots[(motion.curve.knots >= phase.first) & (motion.curve.knots <= phase.last)]
    s = np.unique(np.concatenate([np.linspace(a, b, STEPS + 1) for a, b in pairwise(knots)]))
    q = motion.curve(s)[:, : robot.n]
    at, first = [], 1
    for part in via:
        row = find_row(robot, part, q, first)
        at.append(float(s[row]))
        first = row + 1
    return at


def find_row(robot: RobotModel, part: GoalPartRequest, q: Float[np.ndarray, "S n"], first: int) -> int:
    """Return the first configuration, from one on and before the last, that keeps a goal; else the nearest to it."""
    first = min(first, len(q) - 2)
    misses = np.array([measure_miss(robot, make_goal_targets(robot, part, row), row) for row in q[first:-1]])
    kept = np.flatnonzero(misses <= 1.0)
    return first + (int(kept[0]) if len(kept) else int(misses.argmin()))


def measure_miss(robot: RobotModel, targets: Sequence[EndTarget], q: Float[np.ndarray, "n"]) -> float:
    """Return the largest error of a configuration relative to its tolerance: at most 1 where all targets are kept."""
    data = borrow_data(robot.model)
    pin.framesForwardKinematics(robot.model, data, q)
    errors = [error for target in targets for error in _list_errors(robot, data, target, q)]
    return max((error / max(limit, LEAST_LIMIT) for error, limit in errors), default=0.0)


def _list_errors(
    robot: RobotModel, data: pin.Data, target: EndTarget, q: Float[np.ndarray, "n"]
) -> Iterator[tuple[float, float]]:
    """Yield the errors of a target, each with its limit [m, rad]."""
    if isinstance(target, JointTarget):
        yield abs(float(q[robot.joint_names.index(target.joint)]) - target.value), target.tolerance
        return
    pose = data.oMf[robot.model.getFrameId(target.frame)]
    if isinstance(target, RegionTarget):
        if target.reference is not None:
            pose = data.oMf[robot.model.getFrameId(target.reference)].actInv(pose)
        yield from _list_region_errors(target, pose)
    elif isinstance(target, PoseTarget):
        offset = offset_from_target(target, pose.translation[None])
        yield from ((float(each.measure(offset)[0]), each.tolerance_m) for each in list_position_demands(target))
        if target.rotation is not None and limits_rotation(target):
            yield (
                float(measure_angle((target.rotation.T @ pose.rotation)[None])[0]),
                float(target.rotation_tolerance[0]),
            )
    else:
        yield float(measure_lean((pose.rotation @ target.frame_axis)[None], target.axis)[0]), target.tolerance_rad


def _list_region_errors(target: RegionTarget, pose: pin.SE3) -> Iterator[tuple[float, float]]:
    """Yield the errors of a frame at ``pose_reference_frame``, each with its limit; for bounds what is beyond them."""
    offset = target.rotation.T @ (pose.translation - target.position)
    beyond = np.maximum(np.maximum(target.lower - offset, offset - target.upper), 0.0)
    yield from ((1.0 + float(each) / LEAST_LIMIT if each > 0.0 else 0.0, 1.0) for each in beyond)
    yield float(np.linalg.norm(offset[:2])), target.radius_m
    yield float(np.linalg.norm(offset)), target.distance_m
    turned = (target.rotation.T @ pose.rotation)[None]
    yield float(measure_angle(turned)[0]), target.turn_rad
    yield from zip(np.abs(pin.log3(turned[0])).tolist(), target.turns_rad.tolist(), strict=True)
    if target.axis is not None:
        wanted = target.rotation @ target.axis
        if target.place is not None:
            sight = target.place - pose.translation
            wanted = sight / max(float(np.linalg.norm(sight)), LEAST_LIMIT)
        yield float(measure_lean((pose.rotation @ target.axis)[None], wanted)[0]), target.lean_rad
