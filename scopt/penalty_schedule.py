"""Rule of the penalty: the weight mu of the constraints in the merit, and when it stops rising."""

from __future__ import annotations

from dataclasses import dataclass

from scopt.result import Status


@dataclass(frozen=True)
class PenaltyLevel:
    """Penalty of one outer iteration.

    Attributes:
        mu: weight of the constraints in the merit.
        n_raises: how often it has risen.
    """

    mu: float
    n_raises: int = 0


@dataclass(frozen=True)
class PenaltySchedule:
    """Geometric schedule of the penalty.

    Attributes:
        first: mu of the first outer iteration.
        factor: growth from one to the next.
        max_raises: how often it grows at most.
    """

    first: float
    factor: float
    max_raises: int

    def init(self) -> PenaltyLevel:
        """Return the first level."""
        return PenaltyLevel(self.first)

    def step(self, level: PenaltyLevel) -> PenaltyLevel:
        """Return the next level."""
        return PenaltyLevel(level.mu * self.factor, level.n_raises + 1)

    def terminate(self, level: PenaltyLevel, *, is_feasible: bool) -> Status | None:
        """Return why the outer loop ends at this level; None if the penalty rises."""
        if is_feasible:
            return Status.CONVERGED
        return Status.STALLED if level.n_raises >= self.max_raises else None
