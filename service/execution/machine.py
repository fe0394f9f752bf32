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

FREE_S = 0.1  # of the plan's clock by which a hand goes on back while it presses too hard


class Mode(Enum):
    """What an execution does."""

    RUNNING = "running"
    PAUSED = "paused"  # the clock slows down, then stands still
    WAITING = "waiting"  # at the end of a phase, for what the next phase needs
    RETURNING = "returning"  # aborted, on the way back to the last pose in balance
    HOLDING = "holding"  # stopped, or a sensor or servo is not to be trusted: it comes to rest, and ends there
    ABORTED = "aborted"  # there, at rest; only a new plan goes on
    FALLEN = "fallen"  # nothing is commanded any more but the last pose
    DONE = "done"


class Order(Enum):
    """What an operator asks for."""

    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"  # back to the last pose in balance
    STOP = "stop"  # to rest where it is, for good
    RETREAT = "retreat"  # back to where the plan began, or where the hands were free and the robot rested last


class TimedPhase(Protocol):
    """A phase with its ends on the plan's clock."""

    @property
    def name(self) -> str: ...

    @property
    def begin_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...

    @property
    def rests(self) -> bool: ...

    @property
    def retreat_s(self) -> float | None: ...


@dataclass(frozen=True)
class MachineSettings:
    """How the clock moves.

    Attributes:
        speed: of the plan's clock while it runs, share of real time.
        return_speed: the same on the way back after an abort.
        ramp_s: time in which the clock comes to full speed or to rest [s].
        load_ramp_s: the same of coming to rest when a hand presses too hard [s].
        wait_s: longest wait for what a phase needs before the execution is aborted [s].
        margin_m: balance margin of the pose that an abort returns to [m].
        slow_share: of both speeds while a guard asks to go slowly.
    """

    speed: float = 1.0
    return_speed: float = 0.5
    ramp_s: float = 0.3
    load_ramp_s: float = 0.1
    wait_s: float = 3.0
    margin_m: float = 0.03
    slow_share: float = 0.3

    def __post_init__(self) -> None:
        if not (0.01 <= self.speed <= 1.0 and 0.01 <= self.return_speed <= 1.0):
            raise ExecutionError(f"speed {self.speed:g}, return_speed {self.return_speed:g}; expected 0.01 to 1")
        if not (min(self.ramp_s, self.load_ramp_s) > 0.0 and self.wait_s >= 0.0):
            raise ExecutionError(
                f"ramp_s {self.ramp_s:g}, load_ramp_s {self.load_ramp_s:g}, wait_s {self.wait_s:g}; expected positive "
                "ramps and a wait of 0 or more"
            )
        if not 0.0 < self.slow_share <= 1.0:
            raise ExecutionError(f"slow_share {self.slow_share:g}; expected above 0, at most 1")


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
        returns: whether it was paused on its way back after an abort.
        frees: whether a hand presses too hard, and goes back until it no longer does.
        retreats: whether the way back was ordered, and nothing was wrong.
    """

    mode: Mode = Mode.RUNNING
    time_s: float = 0.0
    rate: float = 0.0
    phase: int = 0
    waited_s: float = 0.0
    goal_s: float = 0.0
    reason: str = ""
    returns: bool = False
    frees: bool = False
    retreats: bool = False

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
        state = self._react(state, findings)
        slow = self.settings.slow_share if any(finding.severity is Severity.SLOW for finding in findings) else 1.0
        if state.mode is Mode.FALLEN:
            return state
        if state.mode is Mode.RETURNING:
            return self._go_back(state, slow, period_s)
        if state.mode is Mode.HOLDING or state.returns:
            return self._come_to_rest(state, period_s)
        if state.mode is Mode.WAITING:
            return self._wait(state, findings, period_s)
        wanted = slow * self.settings.speed if state.mode is Mode.RUNNING else 0.0
        return self._go_on(replace(state, rate=self._approach(state.rate, wanted, period_s)), findings, period_s)

    def _react(self, state: MachineState, findings: Sequence[Finding]) -> MachineState:
        """Return the state after the gravest finding.

        The way back is left for nothing but a fall, unless it was ordered, and a hold for nothing but a hand that
        presses too hard: it stays where it is then no longer, and goes back until it no longer presses too hard.
        """
        worst = {finding.severity: finding for finding in reversed(findings)}
        if Severity.STOP in worst:
            return replace(state, mode=Mode.FALLEN, rate=0.0, reason=worst[Severity.STOP].sentence)
        presses = next((f for f in findings if f.severity is Severity.ABORT and f.is_load), None)
        if state.mode is Mode.RETURNING and not (state.retreats and Severity.HOLD in worst):
            return self._free(state) if presses is not None else replace(state, frees=state.frees and state.rate >= 0.0)
        if state.mode is Mode.HOLDING and presses is None:
            return state
        if state.mode is not Mode.HOLDING and Severity.HOLD in worst:
            return replace(state, mode=Mode.HOLDING, returns=False, reason=worst[Severity.HOLD].sentence)
        if Severity.ABORT in worst and not state.returns:
            lost = [finding.link for finding in findings if finding.is_lost]
            state = self._abort(
                replace(state, frees=presses is not None), (presses or worst[Severity.ABORT]).sentence, lost
            )
            return self._free(state)
        return state

    def _free(self, state: MachineState) -> MachineState:
        """Return a state whose way back goes on while a hand presses too hard, at most to the last rest."""
        if not state.frees:
            return state
        k = state.phase
        while k > 0 and not self.phases[k - 1].rests:
            k -= 1
        goal = max(state.time_s - FREE_S, self.phases[k].begin_s)
        return replace(state, goal_s=min(state.goal_s, goal))

    def check_order(self, state: MachineState, order: Order) -> None:
        """Refuse an order that makes no sense in the present mode.

        Raises:
            ExecutionError: the execution is over, or was aborted; it can be paused and stopped on its way back, too. Or
                no way back is known to be free.
        """
        if state.is_over:
            raise ExecutionError(f"{order.value}: the execution is {state.mode.value}; plan again to go on")
        if state.mode is Mode.RETURNING and order not in (Order.PAUSE, Order.STOP, Order.RETREAT):
            raise ExecutionError(f"{order.value}: the execution was aborted and returns to its last pose in balance")
        if state.mode is Mode.HOLDING:
            raise ExecutionError(f"{order.value}: the execution comes to rest for good, since {state.reason}")
        if order is Order.RETREAT and self.phases[state.phase].retreat_s is None:
            raise ExecutionError(
                f"retreat: in '{self.phases[state.phase].name}' hands press on something, or have just let it go, or a "
                "foot has just moved, so that no way back is known to be free; give abort, or resume"
            )

    def _obey(self, state: MachineState, order: Order | None) -> MachineState:
        if order is None or state.is_over or state.mode is Mode.HOLDING:
            return state
        if order is Order.STOP:
            return replace(state, mode=Mode.HOLDING, returns=False, reason="stopped by the operator")
        if order is Order.PAUSE:
            returns = state.returns or state.mode is Mode.RETURNING
            reason = state.reason if returns else "paused by the operator"
            return replace(state, mode=Mode.PAUSED, reason=reason, waited_s=0.0, returns=returns)
        if order is Order.RETREAT:
            goal = self.phases[state.phase].retreat_s
            if goal is None:
                return state
            goal = min(goal, state.goal_s) if state.returns or state.mode is Mode.RETURNING else goal
            reason = "retreats by the operator's order"
            is_sound = state.retreats or not (state.returns or state.mode is Mode.RETURNING)
            state = replace(state, frees=False, retreats=is_sound, goal_s=goal, reason=reason)
            return replace(state, mode=Mode.RETURNING, returns=False)
        if state.returns:  # resumed or aborted: the way back goes on
            return replace(state, mode=Mode.RETURNING, returns=False)
        if state.mode is Mode.RETURNING:
            return state
        if order is Order.ABORT:
            return self._abort(state, "aborted by the operator", ())
        return replace(state, mode=Mode.RUNNING, reason="")

    def _abort(self, state: MachineState, reason: str, lost: Sequence[str]) -> MachineState:
        """Return the state on its way to the last pose in balance, counted from where the clock can come to rest."""
        speed, rate = self.settings.speed, max(state.rate, 0.0)
        rest = (max(rate - speed, 0.0) + 0.5 * min(rate, speed) ** 2 / speed) * self._find_ramp(state)
        goal = min(state.time_s + rest, self._find_rest(state.phase))
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
        if not self.phases[state.phase].rests:
            waiting = []  # nothing comes into contact at this border, through which the robot moves
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

    def _come_to_rest(self, state: MachineState, period_s: float) -> MachineState:
        """Slow the clock down inside the present phase; a hold has ended once it stands still."""
        rate, end = self._approach(state.rate, 0.0, period_s), self._find_rest(state.phase)
        time = min(max(state.time_s + rate * period_s, 0.0), end)  # what the next phase needs may be missing
        rate = 0.0 if rate > 0.0 and time == end else rate  # all motion rests at this border
        state = replace(state, time_s=time, rate=rate, phase=self._find_phase(time, state.phase))
        return replace(state, mode=Mode.ABORTED) if state.mode is Mode.HOLDING and rate == 0.0 else state

    def _go_back(self, state: MachineState, slow: float, period_s: float) -> MachineState:
        """Move the clock towards the time of the last pose in balance, forwards only to come to rest."""
        settings = self.settings
        left = state.time_s - state.goal_s
        slope = settings.speed / settings.ramp_s
        wanted = -min(
            slow * settings.return_speed, float(np.sqrt(slope * max(left, 0.0))), 10.0 * slope * max(left, 0.0)
        )
        rate = self._approach(state.rate, wanted, period_s, self._find_ramp(state))
        time = max(state.time_s + rate * period_s, state.goal_s) if rate < 0.0 else state.time_s + rate * period_s
        time = min(time, self._find_rest(state.phase))  # what the next phase needs may be missing
        if rate <= 0.0 and time - state.goal_s <= 1e-4:
            return replace(state, mode=Mode.ABORTED, time_s=time, rate=0.0, phase=self._find_phase(time, state.phase))
        return replace(state, time_s=time, rate=rate, phase=self._find_phase(time, state.phase))

    def _find_rest(self, phase: int) -> float:
        """Return when the robot rests next, from a phase on [s]."""
        return next((own.end_s for own in self.phases[phase:] if own.rests), self.phases[-1].end_s)

    def _find_phase(self, time_s: float, phase: int) -> int:
        while phase + 1 < len(self.phases) and not self.phases[phase].rests and time_s >= self.phases[phase].end_s:
            phase += 1
        while phase > 0 and time_s < self.phases[phase].begin_s:
            phase -= 1
        return phase

    def _find_ramp(self, state: MachineState) -> float:
        """Return the time in which the clock comes to rest from full speed [s]."""
        return self.settings.load_ramp_s if state.frees and state.rate > 0.0 else self.settings.ramp_s

    def _approach(self, rate: float, wanted: float, period_s: float, ramp_s: float | None = None) -> float:
        """Return the clock's rate one cycle later: towards the wanted one, to full speed in the ramp's time.

        A clock that runs faster than the full speed, since that was lowered, slows down as fast.
        """
        step = max(self.settings.speed, abs(rate)) / (ramp_s or self.settings.ramp_s) * period_s
        return rate + float(np.clip(wanted - rate, -step, step))
