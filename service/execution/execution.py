"""Execution of a plan: reads the robot, moves the plan's clock, and commands the joints, once per control cycle."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.robot.poses import matrix_rpy
from service.errors import ExecutionError
from service.execution.balance import PlannedBalance
from service.execution.driver import JointCommand, RobotDriver, RobotReading
from service.execution.guards import Finding, Severity
from service.execution.hands.swaying import SwayCorrection
from service.execution.machine import ExecutionMachine, MachineState, Mode, Order
from service.execution.pose_control import Command, PoseController
from service.execution.reference import PlannedReference, ReferencePhase, ReferenceState
from service.execution.reflexes import Reflexes, Senses
from service.execution.sensing.estimator import PelvisEstimate, PelvisEstimator
from service.execution.sensing.forces import ForceMeter, MeasuredForces
from service.execution.settings import ExecutionSettings
from service.execution.shift import Shift, step_shift
from service.execution.stance.capture_point import find_turn_rates
from service.execution.watch.driver_link import DriverLink
from service.execution.watch.watch import Watch
from service.verify import describe_inside

START_TOLERANCE = 0.1  # of a joint from the plan's start [rad, m]
CONTINUE_TOLERANCE = 0.02  # between the last command and the start of another plan [rad, m]


@dataclass(frozen=True)
class Cycle:
    """What happened in one control cycle.

    Attributes:
        state: of the state machine.
        phase: name of the phase.
        wanted: what the plan wants.
        command: of the pose control.
        sent: what was handed to the driver.
        reading: of the sensors.
        estimate: of the pelvis; None without floating base or foot forces.
        forces: measured.
        findings: of the guards.
        control_s: computing time of the pose control [s].
        cycle_s: computing time of everything but the driver [s].
    """

    state: MachineState
    phase: str
    wanted: ReferenceState
    command: Command
    sent: JointCommand
    reading: RobotReading
    estimate: PelvisEstimate | None
    forces: MeasuredForces
    findings: tuple[Finding, ...]
    control_s: float
    cycle_s: float


class Execution:
    """A plan on its way through a driver.

    One call of :meth:`step` is one cycle.  Orders and displacements take effect in the next cycle.
    """

    def __init__(
        self,
        reference: PlannedReference,
        driver: RobotDriver,
        settings: ExecutionSettings | None = None,
        begin_s: float = 0.0,
        start_tolerance: float = START_TOLERANCE,
    ) -> None:
        """Prepare the control of a plan on a robot that stands at its start.

        Args:
            reference: the plan.
            driver: the robot.
            settings: gains, guards and limits.
            begin_s: time of the plan to begin at; the robot rests in that pose [s].
            start_tolerance: how far each joint may be from that pose [rad, m].

        Raises:
            ExecutionError: the driver has other joints than the plan, or the robot is not at the plan's start.
        """
        self.settings = settings or ExecutionSettings()
        self.driver = driver
        if set(driver.joint_names) != set(reference.joint_names):
            other = sorted(set(driver.joint_names) ^ set(reference.joint_names))
            raise ExecutionError(f"the driver's joints are not those of the plan: {', '.join(other[:3])}")
        self._reflexes: Reflexes | None = None
        self._shifts: dict[str, Shift] = {}
        self._forces: MeasuredForces | None = None
        self._estimate: PelvisEstimate | None = None
        self._order: Order | None = None
        self._watch: Watch | None = None
        start, first = reference.at(begin_s), driver.read()
        self.command = Command.at_rest(start.configuration)
        still = np.zeros(len(driver.joint_names))
        order = [reference.joint_names.index(name) for name in driver.joint_names]
        self._link = DriverLink(
            driver, JointCommand(start.q[order], still, start.tau[order]), self.settings.watch.silent_s
        )
        self._load(reference, first, begin_s)
        self._check_start(start, first, start_tolerance)

    def _load(self, reference: PlannedReference, first: RobotReading, begin_s: float = 0.0) -> None:
        """Take a plan, from a time of its own on."""
        settings, driver, robot = self.settings, self.driver, reference.robot
        self.reference = reference
        self._columns = np.array([robot.joint_names.index(name) for name in driver.joint_names], dtype=int)
        self._order_of_plan = np.array([reference.joint_names.index(name) for name in driver.joint_names], dtype=int)
        self.controller = PoseController(robot, settings.gains, driver.period_s)
        balance = PlannedBalance.of(reference) if robot.is_floating else None
        self.machine = ExecutionMachine(reference.phases, balance, settings.machine)
        self.state = MachineState(time_s=begin_s, phase=reference.find_phase_number(begin_s))
        self._wanted = reference.at(begin_s)
        sensors = first if self._watch is None else self._watch.readings
        self._watch = Watch(
            reference, tuple(driver.joint_names), driver.period_s, settings.guards, settings.watch, sensors
        )
        feet, reading = robot.link_groups.get("feet", ()), first
        self._has_forces = robot.is_floating and all(foot in reading.foot_wrenches for foot in feet) and len(feet) == 2
        margins = balance.list_margins() if balance is not None else [np.inf] * len(reference.phases)
        earlier = self._reflexes
        self._reflexes = Reflexes(reference, driver, settings, margins, earlier) if self._has_forces else None
        tools = sorted({load.tool for phase in reference.phases for load in phase.loads}) if self._has_forces else []
        self._meter = ForceMeter(robot, driver.joint_names, tools, driver.period_s)
        self._swaying = SwayCorrection(reference.motion, driver.period_s) if reference.motion.sway else None
        self._forces = None
        self._estimator = None
        if self._has_forces:
            self._estimator = PelvisEstimator(robot, driver.joint_names, driver.period_s, settings.noise)
            if self._estimate is None:
                self._estimate = self._estimator.start(reading, reference.at(begin_s).pose_world_base[:3, 3])

    @property
    def is_at_rest(self) -> bool:
        """Whether the plan's clock stands still."""
        return self.state.rate == 0.0 and self.state.mode not in (Mode.RETURNING, Mode.HOLDING)

    @property
    def is_lost(self) -> bool:
        """Whether the driver has not answered for so long that nothing is commanded any more."""
        return self._link.is_lost

    @property
    def watch(self) -> Watch:
        """The guards, for their limits and for what they cannot see."""
        assert self._watch is not None
        return self._watch

    def give(self, order: Order) -> None:
        """Give an order, which the next cycle obeys.

        Raises:
            ExecutionError: the execution is over, or on its way back after an abort.
        """
        self.machine.check_order(self.state, order)
        self._order = order

    def set_speed(self, share: float) -> None:
        """Change the speed of the plan's clock, as a share of real time; the way back keeps its own.

        Raises:
            ExecutionError: the share is below 0.01 or above 1.
        """
        self.machine.settings = replace(self.machine.settings, speed=share)

    def give_up(self, reason: str) -> None:
        """End an execution that is at rest, where it is.

        Raises:
            ExecutionError: something still moves.
        """
        if not self.is_at_rest:
            raise ExecutionError(f"the execution is {self.state.mode.value} and moves; pause it first")
        self.state = replace(self.state, mode=Mode.ABORTED, reason=reason)

    def shift(self, link: str, offset: Float[np.ndarray, "3"]) -> None:
        """Displace the target of a foot or a hand from the plan, in world axes [m]; it goes there smoothly.

        Raises:
            ExecutionError: the link is no foot or hand, it carries the robot now, or the displacement makes no sense.
        """
        self.controller.check_link(link)
        phase, _ = self._current_phases()
        if any(contact.link == link for contact in phase.contacts):
            raise ExecutionError(
                f"shift: {link} carries the robot in '{phase.name}'; it can be shifted while it moves, or plan again"
            )
        self._shifts[link] = self._shifts.get(link, Shift.zero()).towards(np.asarray(offset, dtype=float))

    @property
    def shifts(self) -> Mapping[str, Shift]:
        """Displacements of targets that the operator asked for, by link."""
        return self._shifts

    def replace_plan(self, reference: PlannedReference) -> None:
        """Go on with another plan, which starts where this execution stands.

        Raises:
            ExecutionError: something still moves, or the plan starts elsewhere.
        """
        if not self.is_at_rest:
            raise ExecutionError(f"the execution is {self.state.mode.value} and moves; pause it before another plan")
        if reference.joint_names != self.reference.joint_names:
            raise ExecutionError("the other plan has other joints")
        start, n = reference.at(0.0).configuration, len(self._columns)
        columns = np.array([reference.robot.joint_names.index(name) for name in self.driver.joint_names], dtype=int)
        off = np.abs(start[columns] - self.command.q[self._columns])
        if off.max(initial=0.0) > CONTINUE_TOLERANCE:
            worst = int(off.argmax())
            raise ExecutionError(
                f"the other plan starts with {self.driver.joint_names[worst]} {off[worst]:.3g} off the last command; "
                f"expected at most {CONTINUE_TOLERANCE:g} for all {n} joints"
            )
        self._shifts = {}
        self._load(reference, self.watch.readings.good)
        first = reference.at(0.0).configuration.copy()
        first[columns] = self.command.q[self._columns]
        self.command = Command.at_rest(first)

    def step(self) -> Cycle:
        """Carry out one control cycle."""
        begin = time.perf_counter()
        period, settings = self.driver.period_s, self.settings
        reading = self.watch.read(self._link)
        waited = time.perf_counter() - begin
        wanted = self._wanted
        gain = np.zeros(len(self._columns))
        self._forces = self._meter.step(self._forces, reading, gain)
        if self._estimator is not None and self._estimate is not None:
            self._estimate = self._estimator.step(self._estimate, reading)
        findings = self._find(reading, wanted)
        order, self._order = self._order, None
        self.state = self.machine.step(self.state, findings, order, period)
        if self.is_lost and not self.state.is_over:
            self.state = replace(self.state, mode=Mode.ABORTED, rate=0.0, reason=self._link.problem)
        phase, _ = self._current_phases()
        wanted = self._wanted = self.reference.at(self.state.time_s)
        planted = {contact.link for contact in phase.contacts}  # what carries the robot stays where it is
        self._shifts = {
            link: shift.stop() if link in planted else step_shift(shift, settings.shifts, period)
            for link, shift in self._shifts.items()
        }
        control = time.perf_counter()
        sent = self._control(reading, wanted)
        control_s = time.perf_counter() - control
        cycle_s = time.perf_counter() - begin - waited
        if not self.is_lost:
            sent = self._link.command(sent)
        return Cycle(
            self.state,
            phase.name,
            wanted,
            self.command,
            sent,
            reading,
            self._estimate,
            self._forces,
            findings,
            control_s,
            cycle_s,
        )

    def run(self, on_cycle: Callable[[Cycle], None] | None = None, settle_s: float = 0.0) -> MachineState:
        """Carry out cycles until the plan is done or aborted, and ``settle_s`` longer; return the last state.

        An operator acts through ``on_cycle``, which is called after every cycle.
        """
        after = 0.0
        while after <= settle_s and not (self.is_lost and self.state.is_over):
            cycle = self.step()
            if on_cycle is not None:
                on_cycle(cycle)
            after = after + self.driver.period_s if self.state.is_over else 0.0
        return self.state

    def _current_phases(self) -> tuple[ReferencePhase, ReferencePhase | None]:
        phases, k = self.reference.phases, self.state.phase
        return phases[k], phases[k + 1] if k + 1 < len(phases) else None

    def _find(self, reading: RobotReading, wanted: ReferenceState) -> tuple[Finding, ...]:
        """Return everything that is wrong in this cycle."""
        assert self._forces is not None
        phase, following = self._current_phases()
        place = None if self._estimate is None else (self._read_configuration(reading, wanted), self.command.q)
        found = self.watch.judge(
            self._link,
            reading,
            wanted,
            (self.state.phase, phase, following),
            self._forces,
            wanted.tau[self._order_of_plan],
            place,
        )
        sway = () if self._swaying is None else self._swaying.judge(reading)
        return (*found, *sway, *self._find_fall(reading, wanted), *self._find_imbalance(following))

    def _control(self, reading: RobotReading, wanted: ReferenceState) -> JointCommand:
        """Return the next command; where none can be computed, the last one at rest, and the execution ends."""
        try:
            if self._reflexes is not None:
                self._reflexes.step(self._see(reading, wanted), self._shifts)
            q, qd = wanted.configuration, self.state.rate * wanted.velocity
            if self._swaying is not None and reading.base_offset is not None:
                offset, rate = self._swaying.step(q, reading.base_offset)
                q, qd = q + offset, qd + rate
            command = self.controller.step(self.command, q, qd, self.list_shifts())
        except (ExecutionError, np.linalg.LinAlgError) as error:
            self._reflexes = None
            self.command = Command.at_rest(self.command.q)
            self.state = replace(self.state, mode=Mode.ABORTED, rate=0.0, reason=str(error))
            return JointCommand(self._link.sent.q, np.zeros(len(self._columns)), self._link.sent.tau)
        self.command = command
        return self._send(wanted, reading)

    def _check_start(self, start: ReferenceState, first: RobotReading, tolerance: float) -> None:
        measured = np.asarray(first.q)
        off = np.abs(measured - start.configuration[self._columns])
        if not off.max(initial=0.0) <= tolerance:
            worst = int(off.argmax())
            raise ExecutionError(
                f"the robot is not at the plan's start: {self.driver.joint_names[worst]} is {measured[worst]:.3f}, the "
                f"plan starts with {start.configuration[self._columns][worst]:.3f}, {off[worst]:.3f} from there; "
                f"expected at most {tolerance:g}"
            )

    def _find_fall(self, reading: RobotReading, wanted: ReferenceState) -> tuple[Finding, ...]:
        """Return a finding if the pelvis leans far off the plan."""
        if not self._has_forces:
            return ()
        up = reading.imu_rotation[:, 2] @ wanted.pose_world_base[:3, 2]
        lean = float(np.arccos(np.clip(up, -1.0, 1.0)))
        if lean <= self.settings.guards.fall_rad:
            return ()
        return (Finding(Severity.STOP, "", 0.0, 0.0, f"the pelvis leans {np.rad2deg(lean):.0f} deg off the plan"),)

    def _find_imbalance(self, following: ReferencePhase | None) -> tuple[Finding, ...]:
        """Return a finding if feet that are about to be alone could not hold the robot."""
        settings, margin = self.settings.balance, None if self._reflexes is None else self._reflexes.margin_m
        if settings is None or margin is None or following is None or margin >= settings.release_m:
            return ()
        words = (
            f"the capture point is {describe_inside(margin)} the feet; '{following.name}' needs it "
            f"{1e3 * settings.release_m:.0f} mm inside"
        )
        return (Finding(Severity.WAIT, "", 0.0, 0.0, words),)

    def _read_configuration(self, reading: RobotReading, wanted: ReferenceState) -> Float[np.ndarray, "n"]:
        """Return the configuration that sensors and estimator show."""
        q = wanted.configuration.copy()
        q[self._columns] = reading.q
        if self._estimate is not None:
            q[:3], q[3:6] = self._estimate.position, matrix_rpy(self._estimate.rotation)[::-1]
        return q

    def _see(self, reading: RobotReading, wanted: ReferenceState) -> Senses:
        """Return what the reflexes need to know in this cycle."""
        assert self._estimate is not None
        assert self._forces is not None
        q, v = self._read_configuration(reading, wanted), np.zeros(self.reference.robot.model.nv)
        v[:3], v[self._columns] = self._estimate.speed, self._estimate.joint_speeds
        v[3:6] = find_turn_rates(q[3:6], reading.imu_rotation @ reading.imu_angular_velocity)
        return Senses(self.state, wanted, reading, q, v, self.command.q, self._forces, self.watch.is_blind)

    def list_shifts(self) -> Mapping[str, Shift]:
        """Return the displacements of all targets: the operator's, and those of the reflexes."""
        return self._shifts if self._reflexes is None else self._reflexes.list_shifts(self._shifts)

    def _send(self, wanted: ReferenceState, reading: RobotReading) -> JointCommand:
        """Return the command for the driver: the pose control's, with the plan's torques and the reflexes' laws."""
        command = JointCommand(
            self.command.q[self._columns], self.command.qd[self._columns], wanted.tau[self._order_of_plan]
        )
        return command if self._reflexes is None else self._reflexes.alter(command, reading)
