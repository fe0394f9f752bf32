"""What watches over one plan: the clock, the stop button, and those who want to see it work."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from scopt import Iteration, Result, Settings, Status

OnIteration = Callable[[str, tuple[str, ...], Iteration, Float[np.ndarray, "T n"]], None]
"""Told the step at work, the names of its coordinates, a trial of the optimiser, and the waypoints it is at."""

OnProgress = Callable[[str, float], None]
"""Told the step at work and the fraction of the plan that is done."""

INTERRUPTED = (Status.TIME_LIMIT, Status.CANCELLED)


class Interrupted(Exception):  # noqa: N818 - it is how a plan ends early, not an error
    """The clock ran out or somebody pressed stop; ``status`` says which."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.value)
        self.status = status


@dataclass
class Monitor:
    """Clock, stop button, progress and the record of one plan.

    Attributes:
        time_limit_s: wall time for the whole plan.
        should_stop: asked often; True ends the plan as cancelled.
        on_progress: told what is being done.
        on_iteration: told every trial of the optimiser.
        timings: seconds by step, in the order of the steps.
        history: (step, iterations) of every solve.
    """

    time_limit_s: float
    should_stop: Callable[[], bool] | None = None
    on_progress: OnProgress | None = None
    on_iteration: OnIteration | None = None
    timings: dict[str, float] = field(default_factory=dict)
    history: list[tuple[str, tuple[Iteration, ...]]] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)

    def remaining_s(self) -> float:
        """Seconds left."""
        return self.time_limit_s - (time.perf_counter() - self.started)

    def is_over(self) -> bool:
        """Whether the plan shall end."""
        return self.remaining_s() <= 0.0 or (self.should_stop is not None and self.should_stop())

    def check_stop(self) -> None:
        """
        Raises:
            Interrupted: the stop button was pressed.
        """
        if self.should_stop is not None and self.should_stop():
            raise Interrupted(Status.CANCELLED)

    def check(self) -> None:
        """
        Raises:
            Interrupted: time is up or the stop button was pressed.
        """
        self.check_stop()
        if self.remaining_s() <= 0.0:
            raise Interrupted(Status.TIME_LIMIT)

    def stop_reason(self) -> Status:
        """Why a poll ended the plan; whoever surrounds it cancels it, too."""
        is_cancelled = self.should_stop is not None and self.should_stop()
        return Status.CANCELLED if is_cancelled or self.remaining_s() > 0.0 else Status.TIME_LIMIT

    def report(self, step: str, fraction: float) -> None:
        """Tell whoever watches."""
        if self.on_progress is not None:
            self.on_progress(step, fraction)

    def iterations_of(
        self, step: str, names: tuple[str, ...]
    ) -> Callable[[Iteration, Float[np.ndarray, "T n"]], None] | None:
        """What the optimiser tells its trials while it works on a step; None where nobody listens."""
        tell = self.on_iteration
        return None if tell is None else lambda iteration, x: tell(step, names, iteration, x)

    @contextmanager
    def step(self, name: str, fraction: float) -> Iterator[None]:
        """Time a step of the plan; steps of one name add up."""
        self.check()
        self.report(name, fraction)
        began = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - began

    def attempts(self, step: str) -> int:
        """How many solves were made for a step; ``turn`` counts for ``turn 2`` as well."""
        return sum(step == name or step.startswith(f"{name} ") for name, _ in self.history)

    def settings(self, base: Settings) -> Settings:
        """Optimiser settings that respect the clock."""
        return Settings(**{**base.__dict__, "time_limit_s": max(self.remaining_s(), 0.0)})

    def note(self, step: str, result: Result) -> None:
        """Keep a solve's history.

        Raises:
            Interrupted: the solve was stopped by the clock or the button.
        """
        self.history.append((step, result.history))
        if result.status in INTERRUPTED:
            raise Interrupted(result.status)
