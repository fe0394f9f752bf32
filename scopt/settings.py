"""Settings of the optimiser, and clocks that measure its time limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

Clock = Callable[[], float]
"""Seconds since some moment; only differences count."""

READ_EVERY_S = 2e-3  # of wall time: the processor's clock is asked by a call of the system, thousands of times a plan
WALL_SHARE = 0.1  # effort per second of wall time, at least: a process that waits for others ends as well


class EffortClock:
    """Processor time of this process since the clock was made, or a share of the wall time if that is more.

    A limit measured with it does not depend on what else the machine does, unless it slows the process down by more
    than the share.

    Attributes:
        wall_share: 0 to 1.
    """

    def __init__(self, wall_share: float = WALL_SHARE) -> None:
        self.wall_share = wall_share
        self._cpu, self._wall = time.process_time(), time.monotonic()
        self._effort, self._next = 0.0, self._wall

    def __call__(self) -> float:
        """Return the effort so far, as of the last 2 ms [s]."""
        now = time.monotonic()
        if now >= self._next:
            self._effort = max(time.process_time() - self._cpu, self.wall_share * (now - self._wall))
            self._next = now + READ_EVERY_S
        return self._effort


@dataclass(frozen=True)
class Settings:
    """Settings of ``TrustRegionSQP``.

    Attributes:
        qp: back end by name (``piqp``, ``clarabel``, ``cvxpy``); ``qp_fallback`` solves what it cannot.
        accept_ratio: a step is taken when the exact merit falls by this fraction of what the model promised.
        shrink, expand: trust radius factors after a rejected and an accepted step.
        trust_radius: first box [variable units times ``Problem.step_scale``].
        min_trust_radius: a smaller box ends the inner loop.
        min_improvement, min_improvement_fraction: the middle loop ends when the model promises less than this,
            absolutely or as a fraction of the merit; ``min_improvement_feasible`` is the fraction for feasible
            iterates.
        is_corrected: whether trial steps are corrected for the curvature of smooth constraints.
        acceptable_steps: the solve ends after this many trial steps in a row with an acceptable iterate.
        patience: trial steps within which the largest violation (relative to its tolerance) must fall by a tenth; the
            solve ends where it does not.
        penalty, penalty_factor, max_penalty_raises: mu of the first outer iteration, its growth, how often.
        max_iterations: trial steps in all.
        time_limit_s: on the clock of the optimiser, by default wall time.
    """

    qp: str = "piqp"
    qp_fallback: str = "clarabel"
    accept_ratio: float = 0.25
    shrink: float = 0.3
    expand: float = 1.5
    trust_radius: float = 0.3
    min_trust_radius: float = 1e-4
    min_improvement: float = 1e-4
    min_improvement_fraction: float = 1e-3
    min_improvement_feasible: float = 0.02
    is_corrected: bool = True
    acceptable_steps: int = 4
    patience: float = float("inf")
    penalty: float = 10.0
    penalty_factor: float = 10.0
    max_penalty_raises: int = 5
    max_iterations: int = 100
    time_limit_s: float = float("inf")
