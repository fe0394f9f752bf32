"""Feet of a floating robot during an execution: how they come down, keep the balance, and share the weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.execution.driver import JointCommand, RobotReading
from service.execution.reference import ReferencePhase, ReferenceState
from service.execution.stance.capture_point import WORLD_AXES, Balance, BalanceControl, BalanceSettings
from service.execution.stance.touchdown import (
    FootReading,
    Stage,
    TouchdownSettings,
    TouchdownState,
    find_ankle,
    find_landing,
    find_seek_speed,
    move_target,
    soften,
    step_touchdown,
)
from service.verify import PlantedContact

RELEASE_S = 0.1  # before the end of a phase, in which the margin is looked at [s]
STANDING = (Stage.STIFF, Stage.SETTLED, Stage.BALANCING)  # of planted feet that may move up and down
LEAST_RATE = 0.01  # of the plan's clock, for the time to the next touch


@dataclass(frozen=True)
class FeetState:
    """Feet between two cycles.

    Attributes:
        landings: state of every foot that has an ankle.
        balance: what the ankles do for the balance; None where they follow the plan, since others than the feet carry
            force and go on doing so in the next phase.
        margin_m: of the capture point inside the feet, before other contacts leave them alone [m]; else None.
        trim: (3,) displacement of the body that brings the capture point to its place before the feet are alone [m].
    """

    landings: Mapping[str, TouchdownState]
    balance: Balance | None = None
    margin_m: float | None = None
    trim: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Sight:
    """What the feet need to know in one cycle.

    Attributes:
        time_s, rate: of the plan's clock.
        phase: index of the phase.
        wanted: by the plan.
        reading: of the sensors.
        q, v: (n,) configuration and speeds as measured.
        command: (n,) configuration of the earlier command.
        forces: measured by link (3,), world axes [N].
        is_blind: whether a sensor has failed, so that the ankles of planted feet follow the plan.
    """

    time_s: float
    rate: float
    phase: int
    wanted: ReferenceState
    reading: RobotReading
    q: Float[np.ndarray, "n"]
    v: Float[np.ndarray, "n"]
    command: Float[np.ndarray, "n"]
    forces: Mapping[str, Float[np.ndarray, "3"]]
    is_blind: bool = False


class Feet:
    """Feet that carry a robot through the phases of a plan."""

    def __init__(
        self,
        robot: RobotModel,
        joint_names: Sequence[str],
        phases: Sequence[ReferencePhase],
        period_s: float,
        touchdown: TouchdownSettings,
        balance: BalanceSettings | None,
        load_gain: float,
        margins: Sequence[float],
    ) -> None:
        """Prepare the ankles.

        Args:
            robot: of the plan.
            joint_names: order of readings and commands.
            phases: of the plan.
            period_s: of the cycle [s].
            touchdown: of feet that land.
            balance: None for ankles that follow the plan while they are planted.
            load_gain: speed at which both feet move against each other per newton of a wrong share [m/(N s)].
            margins: least balance margin of the plan in each phase [m].

        Raises:
            ExecutionError: a foot has no ankle of two joints.
        """
        self.robot, self.phases, self.period_s = robot, tuple(phases), period_s
        self.settings, self.load_gain = touchdown, load_gain
        self.ankles = {foot: find_ankle(robot, joint_names, foot) for foot in robot.link_groups.get("feet", ())}
        columns = np.array([robot.joint_names.index(name) for name in joint_names], dtype=int)
        self._columns = {foot: columns[ankle.joints] for foot, ankle in self.ankles.items()}
        least = np.inf if balance is None else balance.least_m
        # Hands that press on a mechanism would be taken for errors.
        alone = [
            not phase.loads and {contact.link for contact in phase.contacts} <= set(self.ankles) and margin >= least
            for phase, margin in zip(self.phases, margins, strict=True)
        ]
        soon = [later and bool(self._find_remaining(k)) for k, later in enumerate([*alone[1:], False])]
        self._may_balance = [now or later for now, later in zip(alone, soon, strict=True)]
        self._control = None if balance is None else BalanceControl(robot, self._columns, balance)
        self._data, self._plan = robot.model.createData(), robot.model.createData()

    def start(self, earlier: FeetState | None = None) -> FeetState:
        """Return feet that follow their commands; after another plan, as that one left them."""
        before = {} if earlier is None else earlier.landings
        landings = {foot: before.get(foot, TouchdownState.stiff()) for foot in self.ankles}
        return FeetState(landings) if earlier is None else FeetState(landings, trim=earlier.trim)

    def step(self, state: FeetState, sight: Sight) -> FeetState:
        """Return the feet one cycle later."""
        phase, remaining = self.phases[sight.phase], self._find_remaining(sight.phase)
        balances = self._may_balance[sight.phase] and not sight.is_blind
        balance = self._find_balance(sight, remaining or phase.contacts) if balances else None
        landings = self._step_landings(state.landings, phase, sight, balance is not None)
        if sight.is_blind:
            return FeetState(landings, None, None, state.trim)
        held = {contact.link for contact in remaining or phase.contacts}
        if held == set(self.ankles) and self.load_gain and len(self.ankles) == 2:
            landings = self._share_weight(landings, sight)
        elif held - set(self.ankles) and self.load_gain:
            landings = self._seek_ground(state.landings, landings, phase, sight)
        trim = self._step_trim(state.trim, balance, remaining)
        return FeetState(landings, balance, self._find_margin(phase, remaining, sight), trim)

    def soften(self, state: FeetState, command: JointCommand, reading: RobotReading) -> JointCommand:
        """Return a command with the ankles as touchdown and balance want them."""
        for foot, ankle in self.ankles.items():
            torque = None if state.balance is None else state.balance.torques.get(foot)
            command = soften(self.settings, ankle, state.landings[foot], command, reading, torque)
        return command

    def _find_balance(self, sight: Sight, planted: Sequence[PlantedContact]) -> Balance | None:
        """Return what the balance wants of the planted feet."""
        if self._control is None or not planted:
            return None
        return self._control.step(sight.q, sight.v, sight.wanted, sight.rate, planted, sight.forces)

    def _find_remaining(self, index: int) -> tuple[PlantedContact, ...]:
        """Return the feet that are alone once the other contacts of a phase have let go; empty where none lets go."""
        if index + 1 == len(self.phases):
            return ()
        feet, ankles = self.phases[index + 1].contacts, set(self.ankles)
        now = {contact.link for contact in self.phases[index].contacts}
        leave = now - {contact.link for contact in feet} - ankles
        return feet if leave and {contact.link for contact in feet} <= ankles & now else ()

    def _find_margin(self, phase: ReferencePhase, remaining: Sequence[PlantedContact], sight: Sight) -> float | None:
        """Return the margin of the capture point at the end of a phase after which feet are alone [m]."""
        if self._control is None or not remaining or sight.time_s < phase.end_s - RELEASE_S:
            return None
        return self._control.find_margin(sight.q, sight.v, remaining)

    def _step_trim(
        self, trim: Float[np.ndarray, "3"], balance: Balance | None, remaining: Sequence[PlantedContact]
    ) -> Float[np.ndarray, "3"]:
        """Return the displacement of the body one cycle later: against the error while others still hold the robot."""
        if self._control is None:
            return trim
        settings = self._control.settings
        if balance is None or not remaining:
            return settings.trim.fade(trim, self.period_s)
        return settings.trim.move(trim, -settings.trim_gain * np.append(balance.error, 0.0), self.period_s)

    def _step_landings(
        self, states: Mapping[str, TouchdownState], phase: ReferencePhase, sight: Sight, balances: bool
    ) -> dict[str, TouchdownState]:
        """Advance the feet that come down, stand or go up."""
        landings = {foot: find_landing(self.phases, sight.phase, foot) for foot in self.ankles}
        left = {
            foot: np.inf if landing is None else (landing.begin_s - sight.time_s) / max(sight.rate, LEAST_RATE)
            for foot, landing in landings.items()
        }
        lead, made = self.settings.lead_s, dict(states)
        planted = {contact.link for contact in phase.contacts}
        moving = [
            foot
            for foot in self.ankles
            if balances or foot not in planted or left[foot] <= lead or not states[foot].is_idle
        ]
        if moving:
            pin.forwardKinematics(self.robot.model, self._data, sight.q)
            pin.forwardKinematics(self.robot.model, self._plan, sight.wanted.configuration, sight.wanted.velocity)
        for foot in moving:
            landing, columns = landings[foot], self._columns[foot]
            own = next((contact for contact in phase.contacts if contact.link == foot), None)
            after = () if landing is None else landing.contacts
            ground = own or next((contact for contact in after if contact.link == foot), None)
            slope = 0.0 if ground is None else self._find_slope(ground)
            made[foot] = step_touchdown(
                self.settings,
                states[foot],
                self.ankles[foot],
                FootReading(
                    float(sight.forces[foot][2]),
                    sight.rate * self._find_rise(foot),
                    slope,
                    sight.q[columns] - sight.command[columns],
                ),
                lands=left[foot] <= lead,
                planted=own is not None,
                balances=balances,
                left_s=left[foot] if own is None else 0.0,
                period_s=self.period_s,
            )
        return made

    def _find_rise(self, foot: str) -> float:
        """Return the upward speed of a foot in the plan at full rate [m/s]."""
        model = self.robot.model
        return float(pin.getFrameVelocity(model, self._plan, model.getFrameId(foot), WORLD_AXES).linear[2])

    def _find_slope(self, contact: PlantedContact) -> float:
        """Return the angle between a placed sole and that of the plan [rad]."""
        model = self.robot.model
        place = pin.updateFramePlacement(model, self._data, model.getFrameId(contact.link))
        cosine = float(place.rotation[:, 2] @ contact.pose_world_link[:3, 2])
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def _share_weight(self, states: Mapping[str, TouchdownState], sight: Sight) -> dict[str, TouchdownState]:
        """Lower the foot that carries less than in the plan and raise the other one; keep both on the ground.

        That also rights a body that leans.  The share that the balance wants would lean it further: to bring the centre
        of mass back, the pressure has to go to the side where it is too far already.
        """
        settings, made = self.settings, dict(states)
        left, right = self.ankles
        measured = {foot: float(sight.forces[foot][2]) for foot in self.ankles}
        upright = {foot: float(sight.wanted.contact_wrenches[foot][2]) for foot in self.ankles}
        least, total = settings.press_n, sum(upright.values())
        upright = {foot: min(max(force, least), max(total - least, least)) for foot, force in upright.items()}
        more = 0.5 * (measured[left] - upright[left] - measured[right] + upright[right])
        speed = float(np.clip(self.load_gain * more, -settings.probe_speed, settings.probe_speed))
        for foot, own in ((left, speed), (right, -speed)):
            if made[foot].stage in STANDING:
                own = -settings.probe_speed if measured[foot] < settings.touch_n else own
                made[foot] = replace(made[foot], height=move_target(settings, made[foot].height, own, self.period_s))
        return made

    def _seek_ground(
        self,
        before: Mapping[str, TouchdownState],
        states: Mapping[str, TouchdownState],
        phase: ReferencePhase,
        sight: Sight,
    ) -> dict[str, TouchdownState]:
        """Lower the feet that carry much less than planned while others hold the robot too.

        Hip, hands and chest can hold it so that a foot hangs above its ground, until they let go.  A foot that was
        lowered goes up again, to the plan's height at most, where it carries much more than planned.  ``before`` is the
        state of the cycle before.
        """
        settings, made = self.settings, dict(states)
        for foot in {contact.link for contact in phase.contacts} & set(made):
            state, wanted = made[foot], float(sight.wanted.contact_wrenches[foot][2])
            if state.stage not in STANDING:
                continue
            speed = find_seek_speed(settings, float(sight.forces[foot][2]), wanted)
            if speed > 0.0 and state.height.offset[2] >= 0.0:
                speed = 0.0
            made[foot] = replace(state, height=move_target(settings, before[foot].height, speed, self.period_s))
        return made
