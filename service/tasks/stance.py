"""Where the robot should stand instead: the smallest shift of pelvis and feet from which a circle is in reach."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.scene import Scene
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint, Sense
from service.body.phases import PhaseSolver
from service.demands.wheel import HAND_AXIS, Hand, Wheel

SHIFTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)  # [m]
ANGLES = np.deg2rad([0.0, 120.0, 240.0])
QUICK: dict[str, Any] = {"max_iterations": 20, "max_penalty_raises": 2}  # a yes takes few steps; a no is worth no more
AXIS_AIM = np.deg2rad(1.5)


def stance_advice(solver: PhaseSolver, wheel: Wheel, hand: Hand) -> str:
    """A sentence about the pelvis shift that would bring the whole rim into reach, as far as limits and balance go.

    What the robot may hit is left out: the shift says where to stand, the next plan says whether that is free.
    """
    body = replace(solver.body, scene=Scene())
    quick = replace(solver, body=body, settings=replace(solver.settings, **QUICK))
    yaw = body.nominal[3]
    forward, left = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    for ahead, aside in _candidates():
        shift = ahead * forward + aside * left
        if _is_reachable(quick, wheel, hand, shift):
            if ahead == aside == 0.0:
                return f"the rim is within reach of the {hand.side} hand from here; what stands around it is in the way"
            words = [f"{abs(ahead):.1f} m {'forward' if ahead > 0 else 'back'}"] if ahead else []
            words += [f"{abs(aside):.1f} m to the {'left' if aside > 0 else 'right'}"] if aside else []
            return f"moving the pelvis (and the feet) {' and '.join(words)} would bring the rim within reach"
    return f"no shift of the pelvis by up to {max(SHIFTS):.1f} m brings the rim within reach of the {hand.side} hand"


def _candidates() -> list[tuple[float, float]]:
    """Shifts forwards and to the left, the smallest first [m]."""
    signed = [-shift for shift in SHIFTS[1:4]] + list(SHIFTS)
    return sorted(product(signed, (-0.2, 0.0, 0.2)), key=lambda shift: np.hypot(*shift))


def _is_reachable(solver: PhaseSolver, wheel: Wheel, hand: Hand, shift: Float[np.ndarray, "3"]) -> bool:
    """Whether the hand reaches four points of the rim, the wheel moved against the shift instead of the robot."""
    body = solver.body
    waypoints = np.arange(len(ANGLES))
    targets = np.tile(np.eye(4), (len(ANGLES), 1, 1))
    targets[:, :3, 3] = [wheel.rim_point(angle) - shift for angle in ANGLES]
    place = FramePose(body.robot, hand.tool, waypoints, targets, (True,) * 3 + (False,) * 3)
    along = AxisDirection(body.robot, hand.tool, waypoints, HAND_AXIS, -wheel.axis)
    result = solver.trajectory(
        "stance",
        [np.tile(body.nominal, (len(ANGLES), 1))],
        {},
        constraints=(
            Constraint("tool on the rim", place, Sense.EQUAL_ZERO, 2e-3),
            Constraint("hand axis", WithinTolerance(along, AXIS_AIM), tolerance=0.2 * AXIS_AIM),
        ),
    )
    return result.is_feasible
