"""Correction of hands that are measured elsewhere than the plan has them: a PID control of each hand's place."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.execution.sensing.filters import PidGains, PidState, find_share, low_pass, step_pid
from service.execution.shift import Shift

CUTOFF_HZ = 3.0  # of the low-pass filter of the measured errors


@dataclass(frozen=True)
class HandState:
    """Correction of one hand between two steps.

    Attributes:
        offset: (3,) displacement of the hand's target, world axes [m].
        control: state of its PID control.
        error: (3,) filtered distance of the hand from its target [m]; None before it was measured.
    """

    offset: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    control: PidState = field(default_factory=lambda: PidState.zero((3,)))
    error: Float[np.ndarray, "3"] | None = None


class HandCorrection:
    """PID control of where hands are, from the measured configuration of the robot."""

    def __init__(self, robot: RobotModel, hands: Sequence[str], gains: PidGains, period_s: float) -> None:
        """Prepare the control.

        Args:
            robot: of the plan.
            hands: links to correct.
            gains: of every hand [m per m].
            period_s: from one step to the next [s].
        """
        self.hands, self.gains, self.period_s = tuple(hands), gains, period_s
        self._model, self._data = robot.model, robot.model.createData()
        self._frames = [robot.model.getFrameId(hand) for hand in self.hands]
        self._share = find_share(CUTOFF_HZ, period_s)

    def start(self) -> dict[str, HandState]:
        """Return hands without correction."""
        return {hand: HandState() for hand in self.hands}

    def step(
        self,
        states: Mapping[str, HandState],
        planned: Float[np.ndarray, "n"],
        measured: Float[np.ndarray, "n"],
        shifts: Mapping[str, Shift],
        held: Collection[str],
    ) -> dict[str, HandState]:
        """Return the corrections one step later.

        Args:
            states: the earlier ones, by hand.
            planned, measured: configurations (n,).
            shifts: displacements of the targets by the operator.
            held: hands whose correction rests, since they would press on what they hold.
        """
        goals, places = self._place_hands(planned), self._place_hands(measured)
        made = dict(states)
        for k, hand in enumerate(self.hands):
            if hand in held:
                continue
            error = goals[k] - places[k]
            if hand in shifts:
                error = error + shifts[hand].offset
            error = low_pass(states[hand].error, error, self._share)
            offset, control = step_pid(self.gains, states[hand].control, error, self.period_s)
            made[hand] = HandState(offset, control, error)
        return made

    def _place_hands(self, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "H 3"]:
        """Return the places of all hands at a configuration [m]."""
        pin.framesForwardKinematics(self._model, self._data, q)
        return np.array([self._data.oMf[frame].translation for frame in self._frames])
