"""An iterate of the optimiser with everything measured on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np
from jaxtyping import Float

from scopt.errors import ProblemError
from scopt.problem import Problem
from scopt.residual import StateT


@dataclass(frozen=True)
class Iterate(Generic[StateT]):
    """Waypoints and what every term measures there.

    Attributes:
        x: (T, n) waypoints.
        state: what residuals share there.
        cost: weighted cost by name.
        violation: largest row violation by name.
        total_cost: sum of the costs.
        total_violation: sum of all rows' violations, each times its constraint's scale.
        excess: largest violation relative to its tolerance; infinite where a term has no finite value.
        is_acceptable: whether every violation is within its tolerance or its acceptable size.
    """

    x: Float[np.ndarray, "T n"]
    state: StateT
    cost: dict[str, float]
    violation: dict[str, float]
    total_cost: float
    total_violation: float
    excess: float
    is_acceptable: bool

    @property
    def is_feasible(self) -> bool:
        """Whether every violation is within its tolerance."""
        return self.excess <= 1.0

    @property
    def is_acceptable_only(self) -> bool:
        """Whether violations are acceptable, but not within their tolerances."""
        return self.is_acceptable and not self.is_feasible

    def merit(self, mu: float) -> float:
        """Return the exact merit at a penalty."""
        return self.total_cost + mu * self.total_violation

    def is_better_than(self, other: Iterate[StateT]) -> bool:
        """Return whether it costs less, both being feasible, or else has the smaller excess."""
        if self.is_feasible and other.is_feasible:
            return self.total_cost < other.total_cost
        return self.excess < other.excess


def measure_start(problem: Problem[StateT], x0: Float[np.ndarray, "T n"]) -> Iterate[StateT]:
    """Measure every term at a start, clipped into the bounds.

    Raises:
        ProblemError: ``x0`` has the wrong shape or holds NaN, or a term has no finite value there.
    """
    if x0.shape != problem.lower.shape or not np.isfinite(x0).all():
        raise ProblemError(f"x0 must be finite with shape {problem.lower.shape}, got shape {x0.shape}")
    start = measure(problem, x0)
    without_value = [name for name, size in (start.cost | start.violation).items() if not np.isfinite(size)]
    if without_value:
        raise ProblemError(f"'{without_value[0]}' has no finite value at x0")
    return start


def measure(problem: Problem[StateT], x: Float[np.ndarray, "T n"]) -> Iterate[StateT]:
    """Measure every term at ``x``, clipped into the bounds."""
    x = np.clip(x, problem.lower, problem.upper)
    state = problem.state(x)
    cost = {term.name: term.measure(term.residual.value(state)) for term in problem.costs}
    violation: dict[str, float] = {}
    total_violation = excess = 0.0
    is_acceptable = True
    for constraint in problem.constraints:
        rows = constraint.measure_violation(constraint.residual.value(state))
        largest = float(rows.max(initial=0.0))
        violation[constraint.name] = largest
        total_violation += constraint.scale * float(rows.sum())
        excess = max(excess, largest / float(constraint.tolerance))
        is_acceptable = is_acceptable and largest <= max(constraint.tolerance, constraint.acceptable)
    total_cost = sum(cost.values())
    if not np.isfinite(total_cost + total_violation):
        excess = np.inf  # max() above lets NaN pass: a step into where a term has no value is never the best
    return Iterate(x, state, cost, violation, total_cost, total_violation, excess, is_acceptable)
