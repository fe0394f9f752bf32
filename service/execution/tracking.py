"""A plan carried out with scheduled orders of an operator, and the report about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.errors import ExecutionError
from service.execution.driver import JointCommand, RobotReading
from service.execution.execution import Cycle, Execution
from service.execution.guards import Severity
from service.execution.machine import Mode, Order
from service.execution.reference import PlannedReference
from service.execution.watch.assumptions import Assumption

VERDICTS = {Mode.DONE: "TRACKED", Mode.ABORTED: "ABORTED", Mode.FALLEN: "FELL"}


class KinematicRobot:
    """A robot without dynamics that is where it is commanded to be; implements ``RobotDriver``.

    It has no force sensors unless ``foot_wrenches`` is set.

    Attributes:
        joint_names: actuated joints.
        period_s: between two commands [s].
        foot_wrenches: what the foot sensors say, by link.
        commands: number of commands so far.
    """

    def __init__(self, joint_names: Sequence[str], start: Float[np.ndarray, "k"], period_s: float = 1e-3) -> None:
        """Put the joints at a start, at rest."""
        self.joint_names = tuple(joint_names)
        self.period_s = period_s
        self.foot_wrenches: Mapping[str, np.ndarray] = {}
        self.commands = 0
        self._last = JointCommand(np.array(start, dtype=float), np.zeros(len(start)), np.zeros(len(start)))

    def read(self) -> RobotReading:
        """Return the last command as measured."""
        last = self._last
        return RobotReading(
            time_s=self.commands * self.period_s,
            q=last.q,
            qd=last.qd,
            imu_rotation=np.eye(3),
            imu_angular_velocity=np.zeros(3),
            imu_acceleration=np.array([0.0, 0.0, 9.81]),
            foot_wrenches=self.foot_wrenches,
            torque=last.tau,
        )

    def command(self, command: JointCommand) -> None:
        """Follow a command."""
        self._last = command
        self.commands += 1


@dataclass(frozen=True)
class Action:
    """What an operator does at a time of the run.

    Attributes:
        at_s: since the run began [s].
        order: pause, resume or abort; None for a displacement.
        link: foot or hand whose target is displaced; with ``plans`` a target of the request.
        offset: (3,) displacement in world axes [m].
        plans: whether to pause and plan again with the displaced target, from the present phase on.
    """

    at_s: float
    order: Order | None = None
    link: str = ""
    plans: bool = False
    offset: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Change:
    """A change of mode or phase.

    Attributes:
        at_s: since the run began [s].
        plan_s: on the plan's clock [s].
        mode: of the state machine.
        phase: name.
        reason: why.
    """

    at_s: float
    plan_s: float
    mode: str
    phase: str
    reason: str


@dataclass(frozen=True)
class Fault:
    """The first finding of one kind at one place that changed what the execution did.

    Attributes:
        at_s: since the run began [s].
        name: kind, such as ``encoder`` or ``weak servo``.
        where: link, joint or sensor.
        reaction: ``slow``, ``abort`` (back to the last pose in balance), ``hold`` or ``stop``.
        value, limit: measured value and its limit, in the unit of the sentence.
        sentence: for the operator.
    """

    at_s: float
    name: str
    where: str
    reaction: str
    value: float
    limit: float
    sentence: str


@dataclass(frozen=True)
class TrackReport:
    """What became of a plan.

    Attributes:
        verdict: ``TRACKED``, ``ABORTED`` or ``FELL``.
        reason: why it was aborted.
        run_s: time it took [s].
        plan_s: on the plan's clock at the end [s].
        changes: of mode and phase.
        off_m: by foot and hand, largest distance of the command from the plan, displacements aside [m].
        speed_share, acceleration_share: largest of the commanded joints, relative to their limits.
        bound_cycles: number of cycles in which a limit held a joint back.
        control_ms, cycle_ms: median, 99th percentile and largest computing time of the pose control, and of everything
            but the driver [ms].
        faults: what the guards found, in their order.
        unwatched: what the robot's sensors leave unwatched, a sentence each.
        guards: limits of the guards, from the plan and the servos' law.
        assumptions: of the certificate, with what watches each.
    """

    verdict: str
    reason: str
    run_s: float
    plan_s: float
    changes: tuple[Change, ...]
    off_m: Mapping[str, float]
    speed_share: float
    acceleration_share: float
    bound_cycles: int
    control_ms: tuple[float, float, float]
    cycle_ms: tuple[float, float, float]
    faults: tuple[Fault, ...]
    unwatched: tuple[str, ...]
    guards: Mapping[str, Any]
    assumptions: tuple[Assumption, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        data = {key: value for key, value in vars(self).items() if key != "changes"}
        return {
            **data,
            "off_m": dict(self.off_m),
            "control_ms": list(self.control_ms),
            "cycle_ms": list(self.cycle_ms),
            "changes": [vars(change) for change in self.changes],
            "faults": [vars(fault) for fault in self.faults],
            "unwatched": list(self.unwatched),
            "assumptions": [vars(one) for one in self.assumptions],
        }


class _Watch:
    """Figures of a run, collected cycle by cycle."""

    def __init__(self, reference: PlannedReference, period_s: float) -> None:
        groups = reference.robot.link_groups
        self.links = (*groups.get("feet", ()), *groups.get("hands", ()))
        self.off = dict.fromkeys(self.links, 0.0)
        self.changes: list[Change] = []
        self.faults: dict[tuple[str, str], Fault] = {}
        self.control_s: list[float] = []
        self.cycle_s: list[float] = []
        self.speed = self.acceleration = 0.0
        self.bound = 0
        self._period_s = period_s
        self._last: np.ndarray | None = None

    def look(self, execution: Execution, cycle: Cycle) -> None:
        """Take one cycle."""
        robot, columns = execution.reference.robot, execution.reference.joint_columns
        state, command = cycle.state, cycle.command
        last = self.changes[-1] if self.changes else None
        if last is None or (last.mode, last.phase) != (state.mode.value, cycle.phase):
            at_s = len(self.cycle_s) * self._period_s
            self.changes.append(Change(at_s, state.time_s, state.mode.value, cycle.phase, state.reason))
        for finding in cycle.findings:
            if finding.severity not in (Severity.NOTE, Severity.WAIT):
                at_s, reaction = len(self.cycle_s) * self._period_s, finding.severity.value
                fault = Fault(
                    at_s, finding.name, finding.link, reaction, finding.value, finding.limit, finding.sentence
                )
                self.faults.setdefault((finding.name, finding.link), fault)
        self.control_s.append(cycle.control_s)
        self.cycle_s.append(cycle.cycle_s)
        self.bound += bool(command.is_bound[columns].any())
        qd = command.qd[columns]
        self.speed = max(self.speed, float((np.abs(qd) / robot.velocity[columns]).max(initial=0.0)))
        if self._last is not None:
            gain = np.abs(qd - self._last) / self._period_s
            self.acceleration = max(self.acceleration, float((gain / robot.acceleration[columns]).max(initial=0.0)))
        self._last = qd
        if len(self.cycle_s) % 10 == 0:
            self._compare(execution, cycle)

    def _compare(self, execution: Execution, cycle: Cycle) -> None:
        """Compare the command with the plan."""
        model = execution.reference.robot.model
        data, shifts = model.createData(), execution.list_shifts()
        pin.framesForwardKinematics(model, data, cycle.wanted.configuration)
        wanted = {link: data.oMf[model.getFrameId(link)].translation.copy() for link in self.links}
        pin.framesForwardKinematics(model, data, cycle.command.q)
        for link in self.links:
            off = data.oMf[model.getFrameId(link)].translation - wanted[link]
            if link in shifts:
                off = off - shifts[link].offset
            self.off[link] = max(self.off[link], float(np.linalg.norm(off)))

    def finish(self, execution: Execution) -> TrackReport:
        """Return the report."""
        return TrackReport(
            verdict=VERDICTS[execution.state.mode],
            reason=execution.state.reason,
            run_s=len(self.cycle_s) * self._period_s,
            plan_s=execution.state.time_s,
            changes=tuple(self.changes),
            off_m=self.off,
            speed_share=self.speed,
            acceleration_share=self.acceleration,
            bound_cycles=self.bound,
            control_ms=summarize_times(self.control_s),
            cycle_ms=summarize_times(self.cycle_s),
            faults=tuple(self.faults.values()),
            unwatched=execution.watch.list_unwatched(),
            guards=execution.watch.describe(),
            assumptions=execution.watch.list_assumptions(),
        )


def track(
    execution: Execution,
    actions: Sequence[Action] = (),
    *,
    on_cycle: Callable[[Cycle], None] | None = None,
    replan: Callable[[Execution, Action], PlannedReference] | None = None,
    settle_s: float = 0.0,
) -> TrackReport:
    """Carry out a plan with an operator's actions at given times, and report.

    Args:
        execution: ready to start.
        actions: in any order.
        on_cycle: called after every cycle.
        replan: makes the new plan of an action that plans; called when the robot is at rest.
        settle_s: time to go on after the end [s].

    Raises:
        ExecutionError: an action makes no sense when its time comes, or a pause is never ended.
    """
    pending = sorted(actions, key=lambda action: action.at_s)
    watch = _Watch(execution.reference, execution.driver.period_s)

    def act(cycle: Cycle) -> None:
        watch.look(execution, cycle)
        if execution.state.mode is Mode.PAUSED and execution.is_at_rest and not pending:
            execution.give_up(f"paused at {execution.state.time_s:.2f} s and never resumed")
        now = len(watch.cycle_s) * execution.driver.period_s
        while pending and pending[0].at_s <= now and not execution.state.is_over:
            action = pending[0]
            if action.plans:
                if not _replan_at_rest(execution, action, replan):
                    break
            elif action.order is not None:
                execution.give(action.order)
            else:
                execution.shift(action.link, action.offset)
            pending.pop(0)
        if on_cycle is not None:
            on_cycle(cycle)

    execution.run(act, settle_s)
    return watch.finish(execution)


def _replan_at_rest(
    execution: Execution, action: Action, replan: Callable[[Execution, Action], PlannedReference] | None
) -> bool:
    """Pause an execution; once it is at rest go on with a new plan. Return whether it does."""
    if replan is None:
        raise ExecutionError(f"adjust: nothing plans again for {action.link!r}")
    if not (execution.is_at_rest and execution.state.mode is Mode.PAUSED):
        if execution.state.mode is not Mode.PAUSED:
            execution.give(Order.PAUSE)
        return False
    execution.replace_plan(replan(execution, action))
    return True


def summarize_times(seconds: Sequence[float]) -> tuple[float, float, float]:
    """Return median, 99th percentile and maximum of computing times [ms]."""
    if not seconds:
        raise ExecutionError("no cycle was carried out")
    p50, p99, most = (float(value) for value in 1e3 * np.percentile(seconds, [50, 99, 100]))
    return p50, p99, most
