"""What position servos without feed-forward make of a motion: the key ``servo`` of ``result.json``, and its notes."""

from __future__ import annotations

from typing import Any

from costs.robot import RobotModel
from service.motion.hand_sag import list_short_hands
from service.motion.servo_sag import measure_sag
from service.request.schema import PlanRequest
from service.start.robot import resolve_stiffness
from service.verify import Certificate, Motion


def expect_sag(
    motion: Motion, robot: RobotModel, request: PlanRequest, certificate: Certificate | None
) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """Return the sag of the centre of mass and of the hands on the request's servos as plain data, and notes on it.

    None for a robot without base, masses or planted links, and where the default stiffness is not known because the
    request leaves out torque limits.

    Args:
        motion: complete, as executed.
        robot: without the joints that the task moves.
        request: names the servos.
        certificate: of the motion; its balance margin is the one that is left.
    """
    if request.robot.torque is not None:
        return None, ()
    proven = None if certificate is None else certificate.min_balance_margin_m
    stiffness = resolve_stiffness(robot, request)
    sag = measure_sag(motion, stiffness, proven)
    if sag is None:
        return None, ()
    hands = list_short_hands(motion, stiffness)
    notes = (*sag.list_notes(), *(hand.describe() for hand in hands[:1]))
    return {**sag.to_json(), "hands": [hand.to_json() for hand in hands]}, notes
