"""What a valve task demands of any motion, and the choices it leaves: hand, gap of the wheel and number of strokes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism
from service.demands.hands import HANDS, Hand
from service.demands.phase_spec import PhaseSpec
from service.demands.wheel import HAND_AXIS, Grasp, Wheel, make_stroke_phases, make_wheel_mechanism
from service.request.schema import ValveRequest
from service.verify import CircleTarget, Motion, Phase, RelativePoseTarget

TURN = "turn"
SAME_PLACE_M = 1e-6
TURNED_ROUNDING_DEG = 3.0  # the tool may be off its point of the rim


@dataclass(frozen=True)
class ValveDemand:
    """What the task of turning a wheel demands.

    Attributes:
        wheel: the wheel.
        request: the task.
    """

    wheel: Wheel
    request: ValveRequest

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

    def compare_figures(self, figures: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence where the figures of a result name another angle than the request."""
        turned = figures.get("turned_deg")
        if not isinstance(turned, float | int) or abs(turned - self.request.turn_deg) > TURNED_ROUNDING_DEG:
            yield f"figures.turned_deg is {turned}, the request turns by {self.request.turn_deg:g}"

    def _read_choice(self, phase: Phase) -> tuple[Hand, float, Grasp | None] | str:
        """Return hand, gap and grasp of a phase that turns, or a sentence where the task forbids them."""
        wheel = self.wheel
        tools = {target.frame for target in phase.targets if isinstance(target, CircleTarget)}
        hands = [hand for hand in HANDS.values() if hand.tool in tools and self.request.hand in ("auto", hand.side)]
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
                if hold.free_axis is None and _is_near(hold.rotation @ HAND_AXIS, -wheel.axis):
                    return hands[0], entry, Grasp(hold.rotation)
                return f"the hand does not turn with the wheel in phase '{phase.name}', as a grasp has it"
        return f"the hook is in no gap of the valve in phase '{phase.name}'"


def _is_near(place: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> bool:
    return bool(np.linalg.norm(place - other) <= SAME_PLACE_M)
