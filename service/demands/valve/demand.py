"""Demands of a valve task on any motion, and the choices it leaves: hand, entry into the wheel, number of strokes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from costs.robot import Mechanism
from service.demands.figures.travel import measure_turn
from service.demands.hands import HANDS, Hand
from service.demands.phase import FrameMotion, TaskPhase
from service.demands.rest.phases import RestTask, check_travel, start_mechanism
from service.demands.valve.strokes import (
    TURN,
    TurnChoice,
    find_count,
    find_hold,
    list_strokes,
    list_usable_entries,
    make_turn_phases,
)
from service.demands.valve.wheel import Wheel, make_wheel_mechanism, wrap_angle
from service.errors import RequestError
from service.request.fields import HAND_FRICTION
from service.request.resume import ResumeRequest, StrokeChoice
from service.request.tasks.valve import VALVE_JOINT, ValveRequest
from service.verify import Motion, Phase, RelativePoseTarget

if TYPE_CHECKING:
    from perception import LeverDetection, ValveDetection

SAME_PLACE_M = 1e-6


@dataclass(frozen=True)
class ValveDemand:
    """What the task of turning a wheel demands.

    Attributes:
        wheel: the wheel.
        request: the task.
        hands: of the robot.
        friction: largest coefficient between a peg and the wheel.
    """

    wheel: Wheel
    request: ValveRequest
    hands: tuple[Hand, ...] = tuple(HANDS.values())
    friction: float = HAND_FRICTION[1]

    @property
    def mechanism(self) -> Mechanism:
        """The wheel as a mechanism."""
        return make_wheel_mechanism(self.wheel, float(np.deg2rad(self.request.turn_deg)))

    def read_choices(self, recorded: Motion) -> tuple[tuple[TaskPhase, ...], tuple[str, ...]]:
        """Return the phases of all strokes with the record's choices, and a sentence for each that is forbidden."""
        choice = self._read_choice(recorded)
        if isinstance(choice, str):
            return (), (choice,)
        return make_turn_phases(self.wheel, self.request, choice, friction=self.friction), ()

    def keep_choices(self, recorded: Motion) -> dict[str, Any] | str:
        """Return hand, entry and number of strokes of a recorded turn, or a sentence why there are none."""
        choice = self._read_choice(recorded)
        if isinstance(choice, str):
            return choice
        return {"stroke": StrokeChoice(choice.hand.side, choice.entry, choice.count, choice.is_flipped)}

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure how far the recorded hand turns the wheel, and the torque it could hold; nothing without one."""
        choice = self._read_choice(motion)
        return {} if isinstance(choice, str) else self.measure_turn(choice.hand, motion)

    def measure_turn(self, hand: Hand, motion: Motion) -> Mapping[str, float]:
        """Measure how far a hand turns the wheel, and the torque it could hold."""
        frame = hand.peg if self.request.mode == "hook" else hand.tool
        return measure_turn(self.wheel, self.request.torque_nm, frame, motion)

    def _read_choice(self, recorded: Motion) -> TurnChoice | str:
        """Return hand, first entry and number of strokes of a motion, or a sentence where the task forbids them."""
        turns = [phase for phase in recorded.phases if phase.name.split(" ")[0] == TURN]
        if not turns:
            return "no phase turns the valve"
        holds = _list_holds(turns[0])
        known = [hand for hand in self.hands if self.request.hand in ("auto", hand.side)]
        mode = self.request.mode
        hands = [
            hand for hand in known if any(hold.frame == (hand.peg if mode == "hook" else hand.tool) for hold in holds)
        ]
        if len(hands) != 1:
            return f"no hand that the task permits holds the rim in phase '{turns[0].name}'"
        count = find_count(self.request, len(turns))
        first = list_strokes(self.request, count)[0]
        for entry in list_usable_entries(self.wheel, hands[0], mode, first.sense):
            for is_flipped in (False, True) if mode == "grasp" else (False,):
                choice = TurnChoice(hands[0], entry, count, is_flipped)
                motion = find_hold(self.wheel, choice, mode, first.sense)
                if any(_is_hold_of(hold, motion) for hold in holds):
                    return choice
        return f"the {mode} is in no gap of the valve in phase '{turns[0].name}'"


def _is_hold_of(hold: RelativePoseTarget, motion: FrameMotion) -> bool:
    """Return whether a promise keeps a hand at its place of the wheel."""
    is_turned = motion.rotation is None or float(np.abs(hold.rotation - motion.rotation).max()) <= SAME_PLACE_M
    return is_turned and bool(np.linalg.norm(hold.position - motion.place) <= SAME_PLACE_M)


def _list_holds(phase: Phase) -> tuple[RelativePoseTarget, ...]:
    """Return the promises of a phase that keep a frame at a link of the mechanism."""
    targets = [target for target in phase.targets if isinstance(target, RelativePoseTarget)]
    return tuple(target for target in targets if target.reference is not None)


def read_kept_choice(demand: ValveDemand, resume: ResumeRequest) -> TurnChoice:
    """Return the choice of an earlier plan that the rest of it keeps; a new scan moves its entry a little.

    Raises:
        RequestError: the request has none, or the task forbids it.
    """
    request, stroke = demand.request, resume.stroke
    if stroke is None:
        raise RequestError("resume.stroke: is missing; a valve is turned as the earlier plan chose to")
    if request.hand not in ("auto", stroke.hand):
        raise RequestError(f"resume.stroke.hand: {stroke.hand}; task.valve.hand permits {request.hand}")
    hand = next((hand for hand in demand.hands if hand.side == stroke.hand), None)
    if hand is None:
        raise RequestError(f"resume.stroke.hand: the robot has no {stroke.hand} hand")
    sense = list_strokes(request, stroke.strokes)[0].sense
    usable = list_usable_entries(demand.wheel, hand, request.mode, sense)
    if not usable:
        raise RequestError("resume.stroke: the wheel of this request has no room for the hand")
    entry = min(usable, key=lambda angle: abs(wrap_angle(angle - stroke.gap_rad)))
    return TurnChoice(hand, entry, stroke.strokes, stroke.is_flipped)


def turn_back(valve: ValveDetection | LeverDetection, resume: ResumeRequest | None) -> ValveDetection | LeverDetection:
    """Return a detected valve with its spokes, or its lever, as the earlier plan found them."""
    if resume is None or not resume.is_rescanned:
        return valve
    turned = resume.mechanism.get(VALVE_JOINT, 0.0)
    from perception import LeverDetection  # slow to import

    if isinstance(valve, LeverDetection):
        return replace(valve, direction=Rotation.from_rotvec(-turned * valve.axis).apply(valve.direction))
    return replace(valve, spoke_angles=tuple(angle - turned for angle in valve.spoke_angles))


def make_valve_rest(demand: ValveDemand, resume: ResumeRequest) -> RestTask:
    """Return what the rest of a valve task demands.

    Raises:
        RequestError: its phase, mechanism or choices do not fit the task.
    """
    choice = read_kept_choice(demand, resume)
    specs = make_turn_phases(demand.wheel, demand.request, choice, friction=demand.friction)
    mechanism = start_mechanism(demand.mechanism, resume.mechanism)
    check_travel(mechanism, specs, resume.phase)
    return RestTask(mechanism, specs, resume.phase, partial(demand.measure_turn, choice.hand))
