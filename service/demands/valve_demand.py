"""What a valve task demands of any motion, and the choices it leaves: hand, gap of the wheel and number of strokes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism
from service.demands.hands import HANDS, Hand
from service.demands.phase_spec import AXIS, PhaseSpec
from service.demands.resume import ResumedDemand, check_travel, start_mechanism
from service.demands.wheel import Grasp, Wheel, make_stroke_phases, make_wheel_mechanism
from service.errors import RequestError
from service.request.names import VALVE_JOINT
from service.request.resume import ResumeRequest, StrokeChoice
from service.request.schema import ValveRequest
from service.verify import CircleTarget, Motion, Phase, RelativePoseTarget

if TYPE_CHECKING:
    from perception import ValveDetection

TURN = "turn"
SAME_PLACE_M = 1e-6
TURNED_ROUNDING_DEG = 3.0  # the tool may be off its point of the rim


@dataclass(frozen=True)
class ValveDemand:
    """What the task of turning a wheel demands.

    Attributes:
        wheel: the wheel.
        request: the task.
        hands: of the robot.
    """

    wheel: Wheel
    request: ValveRequest
    hands: tuple[Hand, ...] = tuple(HANDS.values())

    @property
    def mechanism(self) -> Mechanism:
        """The wheel as a mechanism."""
        return make_wheel_mechanism(self.wheel)

    def read_choices(self, recorded: Motion) -> tuple[tuple[PhaseSpec, ...], tuple[str, ...]]:
        """Return the phases of all strokes with the record's choices, and a sentence for each that is forbidden."""
        turns = [phase for phase in recorded.phases if phase.name.split(" ")[0] == TURN]
        if not turns:
            return (), ("no phase turns the valve",)
        edges = np.linspace(0.0, np.deg2rad(self.request.turn_deg), len(turns) + 1)
        specs: list[PhaseSpec] = []
        problems: list[str] = []
        for count, phase in enumerate(turns):
            choice = self._read_choice(phase)
            if isinstance(choice, str):
                problems.append(choice)
                continue
            hand, entry, grasp = choice
            suffix = "" if len(turns) == 1 else f" {count + 1}"
            turn = (float(edges[count]), float(edges[count + 1]))
            specs += make_stroke_phases(self.wheel, hand, entry, turn, suffix, grasp, self.request.torque_nm)
        return tuple(specs), tuple(problems)

    def read_stroke(self, recorded: Motion) -> StrokeChoice | str:
        """Return hand, gap and number of strokes of a recorded turn, or a sentence why there are none."""
        turns = [phase for phase in recorded.phases if phase.name.split(" ")[0] == TURN]
        if not turns:
            return "no phase turns the valve"
        choice = self._read_choice(turns[0])
        return choice if isinstance(choice, str) else StrokeChoice(choice[0].side, choice[1], len(turns))

    def compare_figures(self, figures: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence where the figures of a result name another angle than the request."""
        turned = figures.get("turned_deg")
        if not isinstance(turned, float | int) or abs(turned - self.request.turn_deg) > TURNED_ROUNDING_DEG:
            yield f"figures.turned_deg is {turned}, the request turns by {self.request.turn_deg:g}"

    def _read_choice(self, phase: Phase) -> tuple[Hand, float, Grasp | None] | str:
        """Return hand, gap and grasp of a phase that turns, or a sentence where the task forbids them."""
        wheel = self.wheel
        tools = {target.frame for target in phase.targets if isinstance(target, CircleTarget)}
        hands = [hand for hand in self.hands if hand.tool in tools and self.request.hand in ("auto", hand.side)]
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
                if self.request.mode == "hook":
                    return hands[0], entry, None
                if hold.free_axis is None and _is_near(hold.rotation @ AXIS, -wheel.axis):
                    return hands[0], entry, Grasp(hold.rotation)
                return f"the hand does not turn with the wheel in phase '{phase.name}', as a grasp has it"
        return f"the hook is in no gap of the valve in phase '{phase.name}'"


def read_kept_stroke(
    request: ValveRequest, resume: ResumeRequest, hands: Sequence[Hand] = tuple(HANDS.values())
) -> tuple[Hand, StrokeChoice]:
    """Return the hand and the choice of an earlier plan that the rest of it keeps.

    Raises:
        RequestError: the request has none, or the task forbids it.
    """
    stroke = resume.stroke
    if stroke is None:
        raise RequestError("resume.stroke: is missing; a valve is turned as the earlier plan chose to")
    if request.hand not in ("auto", stroke.hand):
        raise RequestError(f"resume.stroke.hand: {stroke.hand}; task.valve.hand permits {request.hand}")
    hand = next((hand for hand in hands if hand.side == stroke.hand), None)
    if hand is None:
        raise RequestError(f"resume.stroke.hand: the robot has no {stroke.hand} hand")
    return hand, stroke


def turn_back(valve: ValveDetection, resume: ResumeRequest | None) -> ValveDetection:
    """Return a detected valve with its spokes as the earlier plan found them."""
    if resume is None or not resume.is_rescanned:
        return valve
    turned = resume.mechanism.get(VALVE_JOINT, 0.0)
    return replace(valve, spoke_angles=tuple(angle - turned for angle in valve.spoke_angles))


def resume_valve(demand: ValveDemand, resume: ResumeRequest) -> ResumedDemand:
    """Return what the rest of a valve task demands.

    Raises:
        RequestError: its phase, mechanism or choices do not fit the task.
    """
    hand, stroke = read_kept_stroke(demand.request, resume, demand.hands)
    turn, count = float(np.deg2rad(demand.request.turn_deg)), stroke.strokes
    edges = np.linspace(0.0, turn, count + 1).tolist()
    grasp = None if demand.request.mode == "hook" else Grasp()
    specs = tuple(
        spec
        for k, ends in enumerate(pairwise(edges))
        for spec in make_stroke_phases(
            demand.wheel, hand, stroke.gap_rad, ends, "" if count == 1 else f" {k + 1}", grasp, demand.request.torque_nm
        )
    )
    mechanism = start_mechanism(demand.mechanism, resume.mechanism)
    check_travel(mechanism, specs, resume.phase)
    rest = float(np.rad2deg(turn - mechanism.start[0]))

    def compare(figures: Mapping[str, Any]) -> Iterator[str]:
        turned = figures.get("turned_deg")
        if not isinstance(turned, float | int) or abs(turned - rest) > TURNED_ROUNDING_DEG:
            yield f"figures.turned_deg is {turned}, the rest of the turn is {rest:.1f}"

    return ResumedDemand(mechanism, specs, resume.phase, compare)


def _is_near(place: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> bool:
    return bool(np.linalg.norm(place - other) <= SAME_PLACE_M)
