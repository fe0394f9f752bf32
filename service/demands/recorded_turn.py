"""Choices of a recorded valve turn that its task permits: hands, gaps of the wheel and number of strokes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from service.demands.wheel import HAND_AXIS, HANDS, Hand, Wheel, make_hook_allowances, make_stroke_targets
from service.request.schema import ValveRequest
from service.verify import CircleTarget, Motion, Phase, RelativePoseTarget, Target

TURN = "turn"
TOUCHING = ("insert", TURN, "retract")  # phases in which the hook may touch the rim
STILL = 1e-5  # largest angle by which a wheel at rest may be off [rad]
SAME_PLACE_M = 1e-6
ROUNDING = 1e-9  # of path parameters
TURNED_ROUNDING_DEG = 3.0  # the tool may be off its point of the rim


@dataclass(frozen=True)
class Stroke:
    """A stroke of a recorded turn.

    Attributes:
        phase: index of the phase that turns.
        hand: the hand on the rim.
        entry: angle of its gap [rad].
        grasp: rotation_valve_tool of a hand that turns with the wheel, or None.
        last: angle of the wheel at its end [rad].
    """

    phase: int
    hand: Hand
    entry: float
    grasp: Float[np.ndarray, "3 3"] | None
    last: float


@dataclass(frozen=True)
class RecordedTurn:
    """Choices of a recorded turn, among those the task permits.

    Attributes:
        strokes: strokes in order.
        problems: one sentence for each violation of the task.
    """

    wheel: Wheel
    strokes: tuple[Stroke, ...]
    problems: tuple[str, ...]

    @staticmethod
    def of(wheel: Wheel, request: ValveRequest, motion: Motion) -> RecordedTurn:
        """Read the strokes of a motion whose last coordinate is the wheel's angle."""
        turns = [index for index, phase in enumerate(motion.phases) if _role(phase) == TURN]
        strokes: list[Stroke] = []
        problems = list(_wheel_problems(motion))
        if not turns:
            problems.append("no phase turns the valve")
        for count, index in enumerate(turns, start=1):
            last = float(np.deg2rad(request.turn_deg)) * count / len(turns)
            choice = _choice(wheel, request, motion.phases[index])
            if isinstance(choice, str):
                problems.append(choice)
            else:
                strokes.append(Stroke(index, *choice, last))
        return RecordedTurn(wheel, tuple(strokes), tuple(problems))

    def targets(self, index: int, at: float) -> tuple[Target, ...]:
        """Return the targets of a phase that turns; none for any other."""
        return tuple(
            target
            for stroke in self.strokes
            if stroke.phase == index
            for target in make_stroke_targets(self.wheel, stroke.hand, stroke.entry, stroke.last, at, stroke.grasp)
        )

    def allowances(self, index: int, phase: Phase) -> tuple[Allowance, ...]:
        """Return the allowances of a phase near the rim: the hook of that stroke's hand may touch it."""
        if _role(phase) not in TOUCHING or not self.strokes:
            return ()
        # An insertion belongs to the next stroke, a retraction to the one before.
        after = [stroke for stroke in self.strokes if stroke.phase >= index] or [self.strokes[-1]]
        before = [stroke for stroke in self.strokes if stroke.phase <= index] or [self.strokes[0]]
        stroke = before[-1] if _role(phase) == "retract" else after[0]
        return make_hook_allowances(self.wheel, stroke.hand)


def _role(phase: Phase) -> str:
    """Return the role of a phase, the first word of its name: ``turn 2`` turns."""
    return phase.name.split(" ")[0]


def _choice(
    wheel: Wheel, request: ValveRequest, phase: Phase
) -> tuple[Hand, float, Float[np.ndarray, "3 3"] | None] | str:
    """Return hand, gap and grasp of a phase that turns, or a sentence where the task forbids them."""
    tools = {target.frame for target in phase.targets if isinstance(target, CircleTarget)}
    hands = [hand for hand in HANDS.values() if hand.tool in tools and request.hand in ("auto", hand.side)]
    if len(hands) != 1:
        return f"no hand that the task permits holds the rim in phase '{phase.name}'"
    holds = [
        target
        for target in phase.targets
        if isinstance(target, RelativePoseTarget) and target.frame == hands[0].tool and target.reference is not None
    ]
    for entry in wheel.gaps:
        for hold in holds:
            if not _is_near(hold.position, wheel.rim_point(entry) - wheel.centre):
                continue
            if request.mode == "hook":
                return hands[0], entry, None
            if hold.free_axis is None and _is_near(hold.rotation @ HAND_AXIS, -wheel.axis):
                return hands[0], entry, hold.rotation
            return f"the hand does not turn with the wheel in phase '{phase.name}', as a grasp has it"
    return f"the hook is in no gap of the valve in phase '{phase.name}'"


def _is_near(place: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> bool:
    return bool(np.linalg.norm(place - other) <= SAME_PLACE_M)


def _wheel_problems(motion: Motion) -> Iterator[str]:
    """Yield a sentence where the wheel does not start at 0, or moves in a phase that does not turn it."""
    curve = motion.curve
    if abs(curve.positions[0, -1]) > STILL:
        yield "the wheel does not start at 0 degrees"
    for phase in motion.phases:
        if _role(phase) == TURN:
            continue
        inside = (curve.knots >= phase.first - ROUNDING) & (curve.knots <= phase.last + ROUNDING)
        angle, rate = curve.positions[inside, -1], curve.tangents[inside, -1]
        if np.ptp(angle) > STILL or np.abs(rate).max() > STILL:
            yield f"the wheel moves in phase '{phase.name}', which does not turn it"


def compare_turn(request: ValveRequest, figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence where the figures of a result name another angle than the request."""
    turned = figures.get("turned_deg")
    if not isinstance(turned, float | int) or abs(turned - request.turn_deg) > TURNED_ROUNDING_DEG:
        yield f"figures.turned_deg is {turned}, the request turns by {request.turn_deg:g}"
