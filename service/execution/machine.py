"""State machine of an execution: the phases of a plan in order, with guards, pause, resume and abort.

The machine moves the plan's clock; it commands nothing itself.  Its steps are functions of the earlier state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

import numpy as np

from service.errors import ExecutionError
from service.execution.balance import PlannedBalance
from service.execution.guards import Finding, Severity


class Mode(Enum):
    """What an execution does."""

    RUNNING = "running"
    PAUSED = "paused"  # the clock slows down, then stands still
    WAITING = "waiting"  # at the end of a phase, for what the next phase needs
    RETURNING = "returning"  # aborted, on the way back to the last pose in balance
    ABORTED = "aborted"  # there, at rest; only a new plan goes on
    FALLEN = "fallen"  # nothing is commanded any more but the last pose
    DONE = "done"


class Order(Enum):
    """What an operator asks for."""

    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"


class TimedPhase(Protocol):
    """A phase with its ends on the plan's clock."""

    @property
    def name(self) -> str: ...

    @property
    def begin_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...


@dataclass(frozen=True)
class MachineSettings:
    """How the clock moves.

    Attributes:
        speed: of the plan's clock while it runs, share of real time.
        return_speed: the same on the way back after an abort.
        ramp_s: time in which the clock comes to full speed or to rest [s].
        wait_s: longest wait for what a phase needs before the execution is aborted [s].
        margin_m: balance margin of the pose that an abort returns to [m].
    """

    speed: float = 1.0
    return_speed: float = 0.5
    ramp_s: float = 0.3
    wait_s: float = 3.0
    margin_m: float = 0.03

    def __post_init__(self) -> None:
        if not (0.01 <= self.speed <= 1.0 and 0.01 <= self.return_speed <= 1.0):
            raise ExecutionError(f"speed {self.speed:g}, return_speed {self.return_speed:g}; expected 0.01 to 1")
        if not (self.ramp_s > 0.0 and self.wait_s >= 0.0):
            raise ExecutionError(f"ramp_s {self.ramp_s:g}, wait_s {self.wait_s:g}; expected a positive ramp and wait")


@dataclass(frozen=True)
class MachineState:
    """Where an execution is.

    Attributes:
        mode: what it does.
        time_s: on the plan's clock [s].
        rate: of that clock per second of real time; negative on the way back.
        phase: index of the phase.
        waited_s: time spent in ``WAITING`` [s].
        goal_s: time that an abort returns to [s].
        reason: why it paused, waits or was aborted; empty while it runs.
    """

    mode: Mode = Mode.RUNNING
    time_s: float = 0.0
    rate: float = 0.0
    phase: int = 0
    waited_s: float = 0.0
    goal_s: float = 0.0
    reason: str = ""

    @property
    def is_over(self) -> bool:
        """Whether nothing more moves without a new plan."""
        return self.mode in (Mode.DONE, Mode.ABORTED, Mode.FALLEN)


class ExecutionMachine:
    """Linear state machine over a plan's phases."""

    def __init__(
        self, phases: Sequence[TimedPhase], balance: PlannedBalance | None, settings: MachineSettings | None = None
    ) -> None:
        """Prepare the machine.

        Args:
            phases: of the plan, in order.
            balance: of the plan; None to abort where the robot is (a fixed base).
            settings: of the clock.
        """
        if not phases:
            raise ExecutionError("the plan has no phases")
        self.phases, self.balance = tuple(phases), balance
        self.settings = settings or MachineSettings()

    def step(
        self, state: MachineState, findings: Sequence[Finding], order: Order | None, period_s: float
    ) -> MachineState:
        """Return the state one control cycle later.

        Args:
            state: the earlier one.
            findings: what the guards found in this cycle.
            order: of the operator, if any; ignored once the execution is over or aborted.
            period_s: of the cycle [s].
        """
        state = self._obey(state, order)
        if state.is_over:
            return replace(state, rate=0.0)
        stopping = [finding for finding in findings if finding.severity is Severity.STOP]
        if stopping:
            return replace(state, mode=Mode.FALLEN, rate=0.0, reason=stopping[0].sentence)
        aborting = [finding for finding in findings if finding.severity is Severity.ABORT]
        if aborting and state.mode is not Mode.RETURNING:
            lost = [finding.link for finding in findings if finding.is_lost]
            state = self._abort(state, aborting[0].sentence, lost)
        if state.mode is Mode.RETURNING:
            return self._go_back(state, period_s)
        if state.mode is Mode.WAITING:
            return self._wait(state, findings, period_s)
        wanted = self.settings.speed if state.mode is Mode.RUNNING else 0.0
        return self._go_on(replace(state, rate=self._approach(state.rate, wanted, period_s)), findings, period_s)

    def check_order(self, state: MachineState, order: Order) -> None:
        """Refuse an order that makes no sense in the present mode.

        Raises:
            ExecutionError: the execution is over, or was aborted.
        """
        if state.is_over:
            raise ExecutionError(f"{order.value}: the execution is {state.mode.value}; plan again to go on")
        if state.mode is Mode.RETURNING:
            raise ExecutionError(f"{order.value}: the execution was aborted and returns to its last pose in balance")

    def _obey(self, state: MachineState, order: Order | None) -> MachineState:
        if order is None or state.is_over or state.mode is Mode.RETURNING:
            return state
        if order is Order.ABORT:
            return self._abort(state, "aborted by the operator", ())
        if order is Order.PAUSE:
            return replace(state, mode=Mode.PAUSED, reason="paused by the operator", waited_s=0.0)
        return replace(state, mode=Mode.RUNNING, reason="")

    def _abort(self, state: MachineState, reason: str, lost: Sequence[str]) -> MachineState:
        """Return the state on its way to the last pose in balance, counted from where the clock can come to rest."""
        rest = 0.5 * max(state.rate, 0.0) ** 2 * self.settings.ramp_s / self.settings.speed
        goal = min(state.time_s + rest, self.phases[state.phase].end_s)
        if self.balance is not None:
            goal = self.balance.find_last(goal, lost, self.settings.margin_m)
        return replace(state, mode=Mode.RETURNING, goal_s=goal, reason=reason)

    def _go_on(self, state: MachineState, findings: Sequence[Finding], period_s: float) -> MachineState:
        """Move the clock forwards, up to the end of the phase if the next one may not begin."""
        time, end = state.time_s + state.rate * period_s, self.phases[state.phase].end_s
        if time < end:
            return replace(state, time_s=time)
        if state.phase + 1 == len(self.phases):
            return replace(state, mode=Mode.DONE, time_s=end, rate=0.0, reason="")
        waiting = [finding for finding in findings if finding.severity is Severity.WAIT]
        if waiting and state.mode is Mode.RUNNING:
            # All motion rests at this border, so that the clock may stop at once.
            sentence = waiting[0].sentence
            return replace(state, mode=Mode.WAITING, time_s=end, rate=0.0, waited_s=0.0, reason=sentence)
        if waiting:
            return replace(state, time_s=end, rate=0.0)
        return replace(state, time_s=time, phase=state.phase + 1)

    def _wait(self, state: MachineState, findings: Sequence[Finding], period_s: float) -> MachineState:
        waiting = [finding for finding in findings if finding.severity is Severity.WAIT]
        if not waiting:
            return replace(state, mode=Mode.RUNNING, phase=state.phase + 1, waited_s=0.0, reason="")
        waited = state.waited_s + period_s
        if waited > self.settings.wait_s:
            return self._abort(state, waiting[0].sentence, [f.link for f in waiting if f.is_lost])
        return replace(state, waited_s=waited, reason=waiting[0].sentence)

    def _go_back(self, state: MachineState, period_s: float) -> MachineState:
        """Move the clock towards the time of the last pose in balance, forwards only to come to rest."""
        settings = self.settings
        left = state.time_s - state.goal_s
        slope = settings.speed / settings.ramp_s
        wanted = -min(settings.return_speed, float(np.sqrt(slope * max(left, 0.0))), 10.0 * slope * max(left, 0.0))
        rate = self._approach(state.rate, wanted, period_s)
        time = max(state.time_s + rate * period_s, state.goal_s) if rate < 0.0 else state.time_s + rate * period_s
        time = min(time, self.phases[state.phase].end_s)  # what the next phase needs may be missing
        if rate <= 0.0 and time - state.goal_s <= 1e-4:
            return replace(state, mode=Mode.ABORTED, time_s=time, rate=0.0, phase=self._find_phase(time, state.phase))
        return replace(state, time_s=time, rate=rate, phase=self._find_phase(time, state.phase))

    def _find_phase(self, time_s: float, phase: int) -> int:
        while phase > 0 and time_s < self.phases[phase].begin_s:
            phase -= 1
        return phase

    def _approach(self, rate: float, wanted: float, period_s: float) -> float:
        """Return the clock's rate one cycle later: towards the wanted one, to full speed in the ramp's time."""
        step = self.settings.speed / self.settings.ramp_s * period_s
        return rate + float(np.clip(wanted - rate, -step, step))
