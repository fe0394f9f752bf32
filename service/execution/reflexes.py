"""Reflexes of an execution: feet, trunk, arms and hands that answer to measured forces, besides the plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from service.execution.driver import JointCommand, RobotDriver, RobotReading
from service.execution.hands.correction import HandCorrection
from service.execution.hands.relief import HandRelief, ReliefSettings
from service.execution.machine import MachineState, Mode
from service.execution.pose_control import BODY
from service.execution.reference import PlannedReference, ReferencePhase, ReferenceState
from service.execution.sensing.filters import PidGains
from service.execution.sensing.forces import MeasuredForces
from service.execution.settings import ExecutionSettings
from service.execution.shift import Shift
from service.execution.stance.feet import Feet, FeetState, Sight
from service.execution.yielding import ArmYield, Yielding, bound_forces, holds_arm, press_trunk
from service.verify import PlantedContact, list_phases

HAND_CYCLES = 10  # control cycles from one correction of the hands to the next


@dataclass(frozen=True)
class Senses:
    """What the reflexes need to know in one cycle.

    Attributes:
        machine: state of the plan's clock.
        wanted: by the plan.
        reading: of the sensors.
        q, v: (n,) configuration and speeds as sensors and estimator show them.
        command: (n,) configuration of the earlier command.
        forces: measured.
        is_blind: whether a sensor has failed: feet become stiff, and nothing else gives way any more.
    """

    machine: MachineState
    wanted: ReferenceState
    reading: RobotReading
    q: Float[np.ndarray, "n"]
    v: Float[np.ndarray, "n"]
    command: Float[np.ndarray, "n"]
    forces: MeasuredForces
    is_blind: bool = False


class Reflexes:
    """Displacements of targets and joints by which a robot with force sensors gives way and holds on.

    Feet come down softly, keep the balance and look for their ground; arms and trunk yield to forces near their caps;
    hands are corrected where they touch nothing, and give way where they press on a mechanism.
    """

    def __init__(
        self,
        reference: PlannedReference,
        driver: RobotDriver,
        settings: ExecutionSettings,
        margins: Sequence[float],
        earlier: Reflexes | None = None,
    ) -> None:
        """Prepare the reflexes of a plan.

        Args:
            reference: the plan.
            driver: the robot.
            settings: of the execution; parts of them that are None leave that reflex out.
            margins: least balance margin of the plan in each phase [m].
            earlier: of the plan before, whose displacements stay.

        Raises:
            ExecutionError: a foot has no ankle of two joints.
        """
        robot, names, period = reference.robot, driver.joint_names, driver.period_s
        self.reference, self.settings, self._period_s, self._n_cycles = reference, settings, period, 0
        self._feet: Feet | None = None
        self._feet_state: FeetState | None = None
        if settings.touchdown is not None:
            self._feet = Feet(
                robot,
                names,
                reference.phases,
                period,
                settings.touchdown,
                settings.balance,
                settings.load_gain,
                margins,
            )
            self._feet_state = self._feet.start(None if earlier is None else earlier._feet_state)
        planted = [contact for phase in reference.phases for contact in phase.contacts]
        self._yielding = Yielding(robot, names, planted if settings.yielding else [], settings.yielding)
        ends = {*robot.link_groups.get("feet", ()), *self._yielding.arms}
        self._trunk = {contact.link for contact in planted} - ends
        self._yields: dict[str, ArmYield] = self._yielding.start()
        self._pressed: Float[np.ndarray, "3"] = np.zeros(3)
        if earlier is not None:
            self._yields |= {link: state for link, state in earlier._yields.items() if link in self._yielding.arms}
            self._pressed = earlier._pressed
        # A hand that is moved near what the arms hold on to presses the robot off it.
        is_free = settings.hand_gains is not None and not self._yielding.arms
        hands = robot.link_groups.get("hands", ()) if is_free else ()
        gains = settings.hand_gains or PidGains(kp=0.0)
        self._hands = HandCorrection(robot, hands, gains, HAND_CYCLES * period)
        self._hand_states = self._hands.start()
        relief = settings.relief or ReliefSettings(gain=0.0)
        self._relief = HandRelief(robot, list_phases(reference.motion), hands, relief)
        self._relieved: dict[str, np.ndarray] = {}

    @property
    def margin_m(self) -> float | None:
        """Margin of the capture point inside the feet, before other contacts leave them alone [m]; else None."""
        return None if self._feet_state is None else self._feet_state.margin_m

    def step(self, senses: Senses, shifts: Mapping[str, Shift]) -> None:
        """Advance all reflexes by one cycle; ``shifts`` are the operator's displacements of targets."""
        self._step_feet(senses)
        if senses.is_blind:
            return
        self._step_yielding(senses)
        self._n_cycles += 1
        if self._n_cycles % HAND_CYCLES == 0:
            self._step_hands(senses, shifts)

    def list_shifts(self, own: Mapping[str, Shift]) -> Mapping[str, Shift]:
        """Return the displacements of all targets: the operator's ``own``, of hands, the body and the feet."""
        shifts = dict(own)
        for hand, corrected in self._hand_states.items():
            asked = shifts.get(hand, Shift.zero())
            relieved = self._relieved.get(hand, np.zeros(3))
            shifts[hand] = Shift(asked.offset + corrected.offset + relieved, asked.speed, asked.goal)
        body = self._pressed if self._feet_state is None else self._pressed + self._feet_state.trim
        if body.any():
            shifts[BODY] = Shift(body, np.zeros(3), body)
        landings = {} if self._feet_state is None else self._feet_state.landings
        for foot, state in landings.items():
            asked, height = shifts.get(foot, Shift.zero()), state.height
            shifts[foot] = Shift(asked.offset + height.offset, asked.speed + height.speed, asked.goal)
        return shifts

    def alter(self, command: JointCommand, reading: RobotReading) -> JointCommand:
        """Return a command with the arms displaced that yield, and the ankles' laws."""
        for link, state in self._yields.items():
            if state.offset.any():
                command.q[self._yielding.arms[link].joints] += state.offset
        if self._feet is None or self._feet_state is None:
            return command
        return self._feet.soften(self._feet_state, command, reading)

    def _find_phases(self, senses: Senses) -> tuple[ReferencePhase, tuple[PlantedContact, ...]]:
        """Return the present phase, and the contacts of the next one (of the last one its own)."""
        phases, k = self.reference.phases, senses.machine.phase
        return phases[k], phases[min(k + 1, len(phases) - 1)].contacts

    def _step_feet(self, senses: Senses) -> None:
        """Advance the feet that come down, keep the balance, and share the weight."""
        if self._feet is None or self._feet_state is None:
            return
        machine = senses.machine
        sight = Sight(
            machine.time_s,
            machine.rate,
            machine.phase,
            senses.wanted,
            senses.reading,
            senses.q,
            senses.v,
            senses.command,
            senses.forces.contacts,
            senses.is_blind,
        )
        self._feet_state = self._feet.step(self._feet_state, sight)

    def _step_yielding(self, senses: Senses) -> None:
        """Advance the arms and the trunk that press on something, or are about to."""
        if self.settings.yielding is None:
            return
        phase, following = self._find_phases(senses)
        measured, held = senses.forces.contacts, {contact.link for contact in phase.contacts}
        bounds = bound_forces(
            self.settings.yielding,
            phase.contacts,
            [contact for contact in following if contact.link not in held],
            leaving=held - {contact.link for contact in following},
            is_waiting=senses.machine.mode is Mode.WAITING,
            expected=senses.wanted.contact_wrenches,
        )
        # The body does not follow what it sits on or leans on.
        trunk = {
            link: replace(bound, least=0.0) if link in held else bound
            for link, bound in bounds.items()
            if link in self._trunk
        }
        self._pressed = press_trunk(self.settings.yielding, self._pressed, trunk, measured, self._period_s)
        if self._yields:
            self._yields = self._yielding.step(self._yields, senses.command, bounds, measured, self._period_s)

    def _step_hands(self, senses: Senses, shifts: Mapping[str, Shift]) -> None:
        """Advance the corrections of the hands; those that press on a mechanism give way instead."""
        if not self._hand_states:
            return
        phase, following = self._find_phases(senses)
        wanted = senses.wanted.configuration
        self._relieved = self._relief.step(
            self._relieved, senses.machine.phase, wanted, senses.forces.hands, HAND_CYCLES * self._period_s
        )
        if phase.loads:
            return
        touched = (*phase.contacts, *following)
        held = [hand for hand in self._hands.hands if holds_arm(self.reference.robot.model, hand, touched)]
        self._hand_states = self._hands.step(self._hand_states, wanted, senses.q, shifts, held)
