"""Optimisation problems: costs, constraints and bounds over all waypoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic

import numpy as np
from jaxtyping import Float

from scopt.affine import AffineRows
from scopt.errors import ProblemError
from scopt.expression import ConvexExpression
from scopt.residual import Residual, StateT, linearize_residual


class Penalty(Enum):
    """Measure of a residual row ``r`` in a cost: ``r^2``, ``|r|`` or ``max(r, 0)``."""

    SQUARED = "squared"
    ABS = "abs"
    HINGE = "hinge"


class Sense(Enum):
    """Relation of a residual row ``r`` in a constraint: ``r = 0`` or ``r <= 0``."""

    EQUAL_ZERO = "equal_zero"
    AT_MOST_ZERO = "at_most_zero"


@dataclass(frozen=True)
class Cost(Generic[StateT]):
    """``weight * sum_i penalty(r_i)``.

    Attributes:
        name: unique in its problem.
        residual: measured on the state.
        weight: > 0, cost per unit of the penalty.
        penalty: SQUARED, ABS or HINGE.
    """

    name: str
    residual: Residual[StateT]
    weight: float = 1.0
    penalty: Penalty = Penalty.SQUARED

    def measure(self, value: Float[np.ndarray, "m"]) -> float:
        """Return the cost of a residual value."""
        if self.penalty is Penalty.SQUARED:
            return float(self.weight * (value @ value))
        if self.penalty is Penalty.ABS:
            return float(self.weight * np.abs(value).sum())
        return float(self.weight * np.maximum(value, 0.0).sum())

    def linearize(self, state: StateT) -> AffineRows:
        """Return the residual's affine model at the state."""
        return linearize_residual(self.residual, state, self.name)


@dataclass(frozen=True)
class Constraint(Generic[StateT]):
    """Every row of the residual is zero, or at most zero, within ``tolerance``.

    Attributes:
        name: unique in its problem.
        residual: measured on the state.
        sense: EQUAL_ZERO or AT_MOST_ZERO.
        tolerance: largest violation of a row that counts as feasible [unit of the residual].
        scale: the residual is multiplied by this in the penalty, so that unlike units weigh alike.
        unit: of the residual, for messages.
        acceptable: largest violation at which a solve may end without feasibility; at least ``tolerance`` counts.
    """

    name: str
    residual: Residual[StateT]
    sense: Sense = Sense.AT_MOST_ZERO
    tolerance: float = 1e-4
    scale: float = 1.0
    unit: str = ""
    acceptable: float = 0.0

    def measure_violation(self, value: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
        """Return the violation of each row, >= 0."""
        return np.asarray(np.abs(value) if self.sense is Sense.EQUAL_ZERO else np.maximum(value, 0.0))

    def linearize(self, state: StateT) -> AffineRows:
        """Return the residual's affine model at the state."""
        return linearize_residual(self.residual, state, self.name)


@dataclass(frozen=True)
class Problem(Generic[StateT]):
    """Minimise the costs subject to the constraints and ``lower <= x <= upper``.

    Attributes:
        lower, upper: (T, n) bounds; equal where a variable is fixed.
        costs, constraints: with unique names.
        state: maps an iterate (T, n) to the state that all residuals share; called once per iterate.
        step_scale: (n,) largest step of a variable relative to the trust radius; ones if not given.
        smooth_state: maps an iterate to the part of the state that smooth residuals need; ``state`` if not given.
        mobility: (n,) metric in which corrections for the curvature of smooth constraints are least; ones if not given.
    """

    lower: Float[np.ndarray, "T n"]
    upper: Float[np.ndarray, "T n"]
    costs: tuple[Cost[StateT], ...]
    constraints: tuple[Constraint[StateT], ...]
    state: Callable[[Float[np.ndarray, "T n"]], StateT]
    step_scale: Float[np.ndarray, "n"] | None = None
    smooth_state: Callable[[Float[np.ndarray, "T n"]], StateT] | None = None
    mobility: Float[np.ndarray, "n"] | None = None

    def __post_init__(self) -> None:
        if self.lower.ndim != 2 or self.lower.shape != self.upper.shape:
            raise ProblemError(f"bounds must be two (T, n) arrays, got {self.lower.shape} and {self.upper.shape}")
        if np.isnan(self.lower).any() or np.isnan(self.upper).any():
            raise ProblemError("bounds contain NaN")
        if np.any(self.lower > self.upper):
            t, i = np.argwhere(self.lower > self.upper)[0]
            raise ProblemError(
                f"empty bounds at waypoint {t}, variable {i}: {self.lower[t, i]:.6g} > {self.upper[t, i]:.6g}"
            )
        names = [cost.name for cost in self.costs] + [constraint.name for constraint in self.constraints]
        if len(set(names)) != len(names):
            raise ProblemError(f"term names must differ, got {', '.join(sorted(names))}")
        for cost in self.costs:
            if not (np.isfinite(cost.weight) and cost.weight > 0.0):
                raise ProblemError(f"cost '{cost.name}' has weight {cost.weight}; give a positive finite number")
        self._refuse_unfit_expressions()

    def _refuse_unfit_expressions(self) -> None:
        """Refuse expressions that do not fit the waypoints, and terms of them that are not convex."""
        n_waypoints, n = self.lower.shape
        terms: tuple[Cost[StateT] | Constraint[StateT], ...] = (*self.costs, *self.constraints)
        for term in terms:
            expression = term.residual
            if not isinstance(expression, ConvexExpression):
                continue
            if expression.n != n:
                raise ProblemError(f"'{term.name}' has {expression.n} variables, a waypoint has {n}")
            expression.at(n_waypoints)
            if expression.is_affine:
                continue
            if isinstance(term, Constraint) and term.sense is Sense.EQUAL_ZERO:
                raise ProblemError(
                    f"'{term.name}' requires a curved expression to be zero; only AT_MOST_ZERO is convex"
                )
            if isinstance(term, Cost) and term.penalty is not Penalty.HINGE and not expression.is_nonnegative:
                raise ProblemError(
                    f"cost '{term.name}': {term.penalty.name} of an expression that may be negative is not convex; "
                    "Penalty.HINGE counts it from zero up"
                )
