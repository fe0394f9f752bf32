"""Rule of termination: when a model promises too little, and when a solve ends before the penalty is at its largest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scopt.iterate import Iterate
from scopt.result import Status

SEARCHED_GAIN = 5.0  # times the gain at which a feasible solve ends
LEAST_PROGRESS = 0.9  # of the violation some steps ago


@dataclass(frozen=True)
class Progress:
    """Course of a solve as far as termination depends on it.

    Attributes:
        excess: ``Iterate.excess`` after every trial step.
        n_acceptable: trial steps in a row after which the iterate was acceptable, but not feasible.
    """

    excess: tuple[float, ...] = ()
    n_acceptable: int = 0


@dataclass(frozen=True)
class Termination:
    """Limits of a solve; the attributes are those of ``Settings``."""

    min_improvement: float
    min_improvement_fraction: float
    min_improvement_feasible: float
    acceptable_steps: int
    patience: float
    max_iterations: int
    time_limit_s: float

    def init(self) -> Progress:
        """Return the progress before the first trial step."""
        return Progress()

    def step(self, progress: Progress, iterate: Iterate[Any]) -> Progress:
        """Return the progress after a trial step that led to, or stayed at, an iterate."""
        n_acceptable = progress.n_acceptable + 1 if iterate.is_acceptable_only else 0
        return Progress((*progress.excess, iterate.excess), n_acceptable)

    def terminate(
        self, progress: Progress, iterate: Iterate[Any], elapsed_s: float, *, is_cancelled: bool = False
    ) -> Status | None:
        """Return why no further trial step is made from an iterate; None if one is."""
        if is_cancelled:
            return Status.CANCELLED
        if elapsed_s > self.time_limit_s:
            return Status.TIME_LIMIT
        if progress.n_acceptable >= self.acceptable_steps:
            return Status.ACCEPTABLE
        if len(progress.excess) > self.patience and not iterate.is_feasible:
            earlier = progress.excess[-1 - int(self.patience)]
            if iterate.excess > LEAST_PROGRESS * earlier:
                return Status.STALLED
        if len(progress.excess) >= self.max_iterations:
            return Status.ITERATION_LIMIT
        return None

    def terminate_rejected(self, iterate: Iterate[Any]) -> Status | None:
        """Return why the solve ends at an iterate from which a step was rejected; None if it goes on."""
        return Status.ACCEPTABLE if iterate.is_acceptable_only else None

    def is_negligible(self, promised: float, merit: float, iterate: Iterate[Any]) -> bool:
        """Return whether a promised fall of the merit is too small for a trial step from an iterate."""
        fraction = self.min_improvement_feasible if iterate.is_feasible else self.min_improvement_fraction
        return promised < max(self.min_improvement, fraction * abs(merit))

    def is_not_worth_searching(self, promised: float, merit: float, iterate: Iterate[Any]) -> bool:
        """Return whether a promised fall of the merit is too small to look for the right box after a rejected step."""
        return iterate.is_feasible and promised < SEARCHED_GAIN * self.min_improvement_feasible * abs(merit)
