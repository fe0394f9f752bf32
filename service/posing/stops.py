"""What stops a led pose: pairs, limits, balance and torque at their ends, and targets that are missed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from service.body.whole_body import CLEARANCE_TOLERANCE, LIMIT_RESERVE, SELF_SHARE, WholeBody
from service.demands.stance import BALANCE_RESERVE
from service.posing.drag import Drag, Stop, StopKind
from service.verify import RestingPose

MOST_STOPS = 4
AT_LIMIT_RAD = 1e-3  # beside the reserve that the optimiser keeps from a limit
FULL_TORQUE = 0.97  # share of a torque limit that counts as all of it
SHORTEST_M = 2e-3  # from its target at which a link has not arrived


def list_stops(
    body: WholeBody,
    q: Float[np.ndarray, "n"],
    resting: RestingPose,
    drag: Drag,
    miss_m: Sequence[float],
    refused: RestingPose | None,
) -> tuple[Stop, ...]:
    """Return what stops a pose, at most four.

    Args:
        body: the robot.
        q: the pose.
        resting: what the verifier measured at it.
        drag: where it was led to.
        miss_m: distance of each target's link from its target [m].
        refused: a pose nearer to the targets that the verifier refused; None without one.
    """
    stops = [*_list_refused(refused), *_list_pairs(body, resting), *_list_balance(body, resting)]
    stops += [*_list_torque(resting), *_list_limits(body, q)]
    return (*stops[: MOST_STOPS - 1], *_list_misses(drag, miss_m))[:MOST_STOPS]


def _list_refused(refused: RestingPose | None) -> Iterator[Stop]:
    for check in () if refused is None else refused.failed[:1]:
        names = () if check.where is None else check.where.names
        text = f"a pose nearer to the target was refused: {check.text}"
        yield Stop(StopKind.REFUSED, names, float(check.value), text)


def _list_pairs(body: WholeBody, resting: RestingPose) -> Iterator[Stop]:
    links = {own.name for own in body.robot.bodies}
    for pair in resting.near:
        share = SELF_SHARE if set(pair.names) <= links else 1.0
        if not pair.may_touch and pair.distance_m < share * body.aims.margin + CLEARANCE_TOLERANCE:
            first, second = pair.names
            text = f"{first} is {1e3 * pair.distance_m:.0f} mm from {second}"
            yield Stop(StopKind.PAIR, pair.names, pair.distance_m, text)


def _list_balance(body: WholeBody, resting: RestingPose) -> Iterator[Stop]:
    margin = resting.balance_margin_m
    if margin is not None and margin < body.aims.balance_margin + 2.0 * BALANCE_RESERVE:
        text = f"the centre of mass is {1e3 * margin:.0f} mm inside the edge of the support"
        yield Stop(StopKind.BALANCE, (), margin, text)


def _list_torque(resting: RestingPose) -> Iterator[Stop]:
    share = resting.torque_share
    if share is not None and share > FULL_TORQUE:
        text = f"{resting.torque_joint} needs {100.0 * share:.0f} % of its torque"
        yield Stop(StopKind.TORQUE, (resting.torque_joint,), share, text)


def _list_limits(body: WholeBody, q: Float[np.ndarray, "n"]) -> Iterator[Stop]:
    robot = body.robot
    left = np.minimum(q - robot.lower, robot.upper - q)
    reserve = np.minimum(LIMIT_RESERVE, 0.05 * (robot.upper - robot.lower)) + AT_LIMIT_RAD
    first = len(BASE_NAMES) if robot.is_floating else 0
    for column in np.flatnonzero(left < reserve).tolist():
        if column >= first:
            name, value = robot.joint_names[column], float(left[column])
            yield Stop(StopKind.JOINT_LIMIT, (name,), value, f"{name} is {value:.3f} rad from its limit")


def _list_misses(drag: Drag, miss_m: Sequence[float]) -> Iterator[Stop]:
    missed = [(value, target.link) for value, target in zip(miss_m, drag.targets, strict=True) if value > SHORTEST_M]
    for value, link in sorted(missed, reverse=True)[:1]:
        yield Stop(StopKind.REACH, (link,), value, f"{link} is {1e3 * value:.0f} mm from where it is led to")
