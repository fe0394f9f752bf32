"""Time limit, cancellation and progress of one plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from scopt import Clock, EffortClock, Iteration, Result, Settings, Status, TrustRegionSQP

OnIteration = Callable[[str, tuple[str, ...], Iteration, Float[np.ndarray, "T n"]], None]
"""Called after every trial step with the plan's step, the coordinates' names, the iteration and its waypoints."""

OnProgress = Callable[[str, float], None]
"""Called with the name of the current step and the fraction of the plan that is done."""

INTERRUPTED = (Status.TIME_LIMIT, Status.CANCELLED)


class Interrupted(Exception):  # noqa: N818 - a way to end a plan early, not an error
    """The plan ran out of time or was cancelled; ``status`` says which."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.value)
        self.status = status


@dataclass(frozen=True)
class TriedStart:
    """One start that the search tried.

    Attributes:
        step: pose or phase that was searched.
        start: what the search began from, in words.
        cpu_s: processor time of this process, from making the start to its outcome [s].
        n_steps: of the optimiser.
        is_feasible: whether it led to a solution.
    """

    step: str
    start: str
    cpu_s: float
    n_steps: int
    is_feasible: bool


@dataclass
class Monitor:
    """Time limit, cancellation, progress and record of one plan.

    Attributes:
        time_limit_s: for the whole plan, on the clock.
        should_stop: polled often; True ends the plan as cancelled.
        on_progress, on_iteration: callbacks.
        clock: measures the time limit, by default as effort.
        timings: seconds of wall time by step, in the order of the steps.
        history: (step, iterations) of every solve.
        tried: every start of the search, in the order in which they were tried.
        miss: of the attempt that missed least at the step that was searched last: the step, its largest violation
            relative to the tolerance, and a function that describes what it missed.
        started: of the clock.
    """

    time_limit_s: float
    should_stop: Callable[[], bool] | None = None
    on_progress: OnProgress | None = None
    on_iteration: OnIteration | None = None
    clock: Clock = field(default_factory=EffortClock)
    timings: dict[str, float] = field(default_factory=dict)
    history: list[tuple[str, tuple[Iteration, ...]]] = field(default_factory=list)
    tried: list[TriedStart] = field(default_factory=list)
    miss: tuple[str, float, Callable[[], tuple[str, ...]]] | None = None
    started: float = field(init=False)

    def __post_init__(self) -> None:
        self.started = self.clock()

    def elapsed_s(self) -> float:
        """Return the seconds that count towards the time limit so far."""
        return self.clock() - self.started

    def remaining_s(self) -> float:
        """Return the seconds left."""
        return self.time_limit_s - self.elapsed_s()

    def is_cancelled(self) -> bool:
        """Return whether the caller has cancelled the plan."""
        return self.should_stop is not None and self.should_stop()

    def is_over(self) -> bool:
        """Return whether the plan is out of time or cancelled."""
        return self.remaining_s() <= 0.0 or self.is_cancelled()

    def check_stop(self) -> None:
        """
        Raises:
            Interrupted: the plan was cancelled.
        """
        if self.is_cancelled():
            raise Interrupted(Status.CANCELLED)

    def check(self) -> None:
        """
        Raises:
            Interrupted: the plan is out of time or was cancelled.
        """
        self.check_stop()
        if self.remaining_s() <= 0.0:
            raise Interrupted(Status.TIME_LIMIT)

    def stop_reason(self) -> Status:
        """Return why a poll ended the plan; with time left it was cancelled by surrounding work."""
        return Status.CANCELLED if self.is_cancelled() or self.remaining_s() > 0.0 else Status.TIME_LIMIT

    def report(self, step: str, fraction: float) -> None:
        """Report progress."""
        if self.on_progress is not None:
            self.on_progress(step, fraction)

    def make_callback(
        self, step: str, names: tuple[str, ...]
    ) -> Callable[[Iteration, Float[np.ndarray, "T n"]], None] | None:
        """Return the optimiser's callback while it works on a step; None without ``on_iteration``."""
        notify = self.on_iteration
        return None if notify is None else lambda iteration, x: notify(step, names, iteration, x)

    @contextmanager
    def step(self, name: str, fraction: float) -> Iterator[None]:
        """Report and time a step of the plan; durations of equal names add up."""
        self.check()
        self.report(name, fraction)
        began = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - began

    def count_attempts(self, step: str) -> int:
        """Return the number of solves of a step; ``turn`` counts for ``turn 2`` as well."""
        return sum(step == name or step.startswith(f"{name} ") for name, _ in self.history)

    def mark(self) -> tuple[float, int]:
        """Return where the costs of a start begin."""
        return time.process_time(), len(self.history)

    def log_start(
        self, step: str, start: str, mark: tuple[float, int], is_feasible: bool, n_steps: int | None = None
    ) -> None:
        """Record a start that was tried since a mark; steps of the optimiser are counted if they are not given."""
        began, n_solved = mark
        steps = sum(len(history) for _, history in self.history[n_solved:]) if n_steps is None else n_steps
        self.tried.append(TriedStart(step, start, time.process_time() - began, steps, bool(is_feasible)))

    def note_miss(self, step: str, shortfall: float, describe: Callable[[], tuple[str, ...]]) -> None:
        """Keep what an attempt at a step missed, if no other missed less."""
        if self.miss is None or self.miss[0] != step or shortfall < self.miss[1]:
            self.miss = step, shortfall, describe

    def describe_delay(self) -> tuple[str, ...]:
        """Return what the attempt that missed least missed or, where none has ended, how far it came, as sentences."""
        if self.miss is not None:
            return self.miss[2]()
        if not self.history:
            return ()
        step, iterations = self.history[-1]
        return (f"no attempt at '{step}' ended before, the last one after {len(iterations)} steps of the optimiser",)

    def make_optimiser(self, settings: Settings) -> TrustRegionSQP:
        """Return the optimiser with the plan's clock and remaining time."""
        return TrustRegionSQP(replace(settings, time_limit_s=max(self.remaining_s(), 0.0)), self.clock)

    def record(self, step: str, result: Result) -> None:
        """Record a solve's history.

        Raises:
            Interrupted: the solve was stopped.
        """
        self.history.append((step, result.history))
        if result.status in INTERRUPTED:
            raise Interrupted(result.status)
