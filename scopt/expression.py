"""Terms written as CVXPY expressions of one waypoint, which enter the convex subproblem as they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from scopt.affine import AffineRows
from scopt.errors import ProblemError
from scopt.finite_difference import Differences
from scopt.qp.cones import Cone, read_cones
from scopt.residual import Residual, StateT

Expression: TypeAlias = Any  # cvxpy has no types, and is imported only where expressions are used


@dataclass(frozen=True)
class ConicForm:
    """``t >= f(q)`` for every entry of a convex ``f``: ``by_q q + by_t t + by_more y + s = b``, ``s`` in the cones.

    Attributes:
        by_q: (r, n).
        by_t: (r, k).
        by_more: (r, a) of further variables.
        b: (r,).
        cones: of the rows, in their order.
    """

    by_q: sparse.csr_array
    by_t: sparse.csr_array
    by_more: sparse.csr_array
    b: Float[np.ndarray, "r"]
    cones: tuple[Cone, ...]


class ConvexExpression(Residual[StateT]):
    """A convex expression of single waypoints, ``k`` rows a waypoint.

    An affine expression becomes rows like those of any residual.  Any other enters the convex subproblem as it is, not
    linearised, and the subproblem then goes to Clarabel: as a cost with ``Penalty.HINGE`` (or any penalty if it is
    nonnegative), as a constraint with ``Sense.AT_MOST_ZERO``.

        Cost("effort", ConvexExpression(n, lambda q: cvxpy.norm1(q[3:6] - rest)), weight=2.0, penalty=Penalty.HINGE)
        Constraint("near", ConvexExpression(n, lambda q: cvxpy.norm(q[:2]) <= 0.3, waypoints=[-1]))
    """

    def __init__(
        self,
        n: int,
        expression: Callable[[Expression], Expression],
        waypoints: Sequence[int] | Int[np.ndarray, "S"] | None = None,
    ) -> None:
        """
        Args:
            n: variables of a waypoint.
            expression: of a waypoint's variables (n,); a scalar, an array, or an inequality, which means left minus
                right.
            waypoints: indices, negative ones from the end; all if not given.

        Raises:
            ProblemError: the expression is not convex by CVXPY's rules, or has other variables.
        """
        self.n, self.waypoints = n, None if waypoints is None else np.asarray(waypoints, dtype=int)
        self._expression = expression
        q = _cvxpy().Variable(n, name="q")
        rows = _flatten(expression(q))
        _refuse_unfit(rows, q)
        self.is_affine, self.is_nonnegative = bool(rows.is_affine()), bool(rows.is_nonneg())
        self.form = _derive_conic_form(rows, q)

    def at(self, n_waypoints: int) -> Int[np.ndarray, "S"]:
        """Return the indices of its waypoints in a trajectory.

        Raises:
            ProblemError: a waypoint lies outside.
        """
        if self.waypoints is None:
            return np.arange(n_waypoints)
        outside = self.waypoints[(self.waypoints < -n_waypoints) | (self.waypoints >= n_waypoints)]
        if len(outside):
            raise ProblemError(f"waypoint {outside[0]} of an expression lies outside the {n_waypoints} of the problem")
        return self.waypoints % n_waypoints

    def measure(self, x: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "m"]:
        """Return the expression's entries, waypoint by waypoint; NaN outside its domain."""
        with np.errstate(all="ignore"):
            rows = [self._evaluate(x[waypoint]) for waypoint in self.at(len(x))]
        return np.concatenate(rows) if rows else np.zeros(0)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        return self.measure(read_iterate(state))

    def linearize(self, state: StateT) -> AffineRows:
        x = read_iterate(state)
        if not self.is_affine:  # convex: at a kink the mean of both sides is as good a slope as any
            return Differences(self.measure, x, type(self).__name__).linearize(warns=False)
        waypoints = self.at(len(x))
        blocks = np.tile(self._slope, (len(waypoints), 1))[:, None]
        return AffineRows.from_blocks(self.measure(x), np.repeat(waypoints, len(self._slope)), blocks, len(x))

    @cached_property
    def _slope(self) -> Float[np.ndarray, "k n"]:
        """Derivative of an affine expression."""
        at_zero = self._evaluate(np.zeros(self.n))
        return np.stack([self._evaluate(unit) - at_zero for unit in np.eye(self.n)], axis=1)

    def _evaluate(self, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "k"]:
        return np.asarray(_flatten(self._expression(_cvxpy().Constant(q))).value, dtype=float)


def read_iterate(state: Any) -> Float[np.ndarray, "T n"]:
    """Return the iterate of a state: the state itself, or its ``x``.

    Raises:
        ProblemError: the state has neither.
    """
    x = state if isinstance(state, np.ndarray) else getattr(state, "x", None)
    if not isinstance(x, np.ndarray):
        raise ProblemError(
            f"expressions need a state that is the iterate (T, n) or has it as `x`; {type(state).__name__} has not"
        )
    return x


def _cvxpy() -> Any:
    import cvxpy  # takes 0.7 s

    return cvxpy


def _flatten(expression: Expression) -> Expression:
    """Flatten an expression, or the left minus the right side of an inequality.

    Raises:
        ProblemError: it is neither.
    """
    cvxpy = _cvxpy()
    if isinstance(expression, cvxpy.constraints.Inequality):
        expression = expression.args[0] - expression.args[1]
    if not isinstance(expression, cvxpy.Expression):
        raise ProblemError(
            f"an expression must be a CVXPY expression or an inequality of two, got {type(expression).__name__}"
        )
    return cvxpy.reshape(expression, (expression.size,), order="C")


def _refuse_unfit(rows: Expression, q: Expression) -> None:
    foreign = [v.name() for v in (*rows.variables(), *rows.parameters()) if v.id != q.id]
    if foreign:
        raise ProblemError(f"an expression must be of the waypoint's variables alone, not of {', '.join(foreign)}")
    if not rows.variables():
        raise ProblemError(f"the expression {_shorten(rows)} does not depend on the waypoint")
    if rows.is_complex():
        raise ProblemError(f"the expression {_shorten(rows)} is complex")
    if not rows.is_convex():
        what = "concave" if rows.is_concave() else "not convex"
        raise ProblemError(
            f"the expression {_shorten(rows)} is {what} by CVXPY's rules (dcp.stanford.edu); write it as a convex "
            "one, or as a Residual, which is linearised"
        )


def _shorten(rows: Expression) -> str:
    text = str(rows.args[0])
    return text if len(text) <= 80 else text[:77] + "..."


def _derive_conic_form(rows: Expression, q: Expression) -> ConicForm:
    """Derive the form in which CVXPY hands ``rows <= t`` to Clarabel."""
    cvxpy = _cvxpy()
    t = cvxpy.Variable(rows.size)
    data, _, _ = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum(t)), [rows <= t]).get_problem_data(cvxpy.CLARABEL)
    matrix = sparse.csc_array(data["A"])
    first = data["param_prob"].var_id_to_col
    of_q = np.arange(first[q.id], first[q.id] + q.size)
    of_t = np.arange(first[t.id], first[t.id] + t.size)
    of_more = np.setdiff1d(np.arange(matrix.shape[1]), np.concatenate([of_q, of_t]))
    by_q, by_t, by_more = (sparse.csr_array(matrix[:, columns]) for columns in (of_q, of_t, of_more))
    return ConicForm(by_q, by_t, by_more, np.asarray(data["b"], dtype=float), read_cones(data["dims"]))
