"""The convex model of a problem around one iterate, and its quadratic program in stage order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse

from scopt.affine import AffineRows, WeightedRows, store_columns
from scopt.exact_terms import ExactTerm, add_exact_terms
from scopt.expression import ConvexExpression, read_iterate
from scopt.hessian import HessianSum, make_hessian
from scopt.problem import Penalty, Problem, Sense
from scopt.qp import QuadraticProgram
from scopt.residual import Residual


@dataclass(frozen=True)
class ConvexModel:
    """``sum w r^2 + sum w |r| + sum w max(r, 0)`` of affine rows ``r(dx)`` over all waypoints.

    Attributes:
        squared, absolute, hinge: rows by penalty; constraint rows stand among the latter two, weighted by mu.
        constraint_rows: where each constraint's rows stand.
        n_waypoints, n: shape of the iterate.
        exact: convex expressions, which are in the merit as they are.
        hessian: (F, F) of the squared rows in the free variables, if it is known.
    """

    squared: WeightedRows
    absolute: WeightedRows
    hinge: WeightedRows
    constraint_rows: Mapping[str, tuple[Penalty, slice]]
    n_waypoints: int
    n: int
    exact: tuple[ExactTerm, ...] = ()
    hessian: sparse.csc_array | None = None

    def merit(self, dx: Float[np.ndarray, "N"]) -> float:
        """Return the modelled merit after a step ``dx``."""
        squared = self.squared.rows.at(dx)
        return float(
            self.squared.weight @ squared**2
            + self.absolute.weight @ np.abs(self.absolute.rows.at(dx))
            + self.hinge.weight @ np.maximum(self.hinge.rows.at(dx), 0.0)
            + sum(term.merit(dx) for term in self.exact)
        )

    def select_constraint(self, name: str) -> AffineRows:
        """Return a constraint's rows."""
        kind, rows = self.constraint_rows[name]
        return (self.absolute if kind is Penalty.ABS else self.hinge).rows.slice_rows(rows.start, rows.stop)


def convexify(
    problem: Problem[Any], state: Any, mu: float, hessians: HessianSum | None = None, *, is_affine: bool = False
) -> ConvexModel:
    """Linearise every term of the problem at ``state``; constraints enter as l1 penalties of weight ``mu``.

    Args:
        hessians: keeps what does not change from iterate to iterate of one solve.
        is_affine: whether convex expressions are linearised, too; else they stay as they are.
    """
    n_waypoints, n = problem.lower.shape
    parts: Mapping[Penalty, list[WeightedRows]] = {kind: [] for kind in Penalty}
    exact: list[ExactTerm] = []
    for cost in problem.costs:
        if _is_exact(cost.residual) and not is_affine:
            exact.append(ExactTerm(cost.residual, cost.penalty, cost.weight, read_iterate(state)))
            continue
        rows = cost.linearize(state)
        parts[cost.penalty].append(WeightedRows(rows, np.full(len(rows.value), cost.weight)))
    constraint_rows: dict[str, tuple[Penalty, slice]] = {}
    for constraint in problem.constraints:
        if _is_exact(constraint.residual) and not is_affine:
            weight = mu * constraint.scale
            exact.append(ExactTerm(constraint.residual, Penalty.HINGE, weight, read_iterate(state)))
            continue
        rows = constraint.linearize(state)
        kind = Penalty.ABS if constraint.sense is Sense.EQUAL_ZERO else Penalty.HINGE
        start = sum(len(part.weight) for part in parts[kind])
        constraint_rows[constraint.name] = (kind, slice(start, start + len(rows.value)))
        parts[kind].append(WeightedRows(rows, np.full(len(rows.value), mu * constraint.scale)))
    stacked = {kind: WeightedRows.stack(parts[kind], n_waypoints * n) for kind in Penalty}
    affine = stacked[Penalty.SQUARED], stacked[Penalty.ABS], stacked[Penalty.HINGE]
    hessian = None if hessians is None else hessians.of(parts[Penalty.SQUARED])
    return ConvexModel(*affine, constraint_rows, n_waypoints, n, tuple(exact), hessian)


def _is_exact(residual: Residual[Any]) -> TypeGuard[ConvexExpression[Any]]:
    """Return whether a residual enters the model as it is."""
    return isinstance(residual, ConvexExpression) and not residual.is_affine


@dataclass(frozen=True)
class Subproblem:
    """Quadratic program of a convex model, whose bounds follow the trust box.

    Attributes:
        program: over the free step variables and one slack per l1 row, in stage order.
        step_index: (F,) where each free step variable stands in the program.
        is_free: (N,) which step variables are in the program; the others do not move.
        row_order: (M,) where each row of the program stands among the hinge, absolute and negated absolute rows.
        soften: returns the same with penalties in place of equalities; None where it has none.
    """

    program: QuadraticProgram
    step_index: Int[np.ndarray, "F"]
    is_free: Bool[np.ndarray, "N"]
    row_order: Int[np.ndarray, "M"]
    soften: Callable[[], Subproblem] | None = None

    def bound_steps(self, lower: Float[np.ndarray, "N"], upper: Float[np.ndarray, "N"]) -> QuadraticProgram:
        """Return the program with the step bounds ``lower <= dx <= upper``."""
        low, high = self.program.lower.copy(), self.program.upper.copy()
        low[self.step_index], high[self.step_index] = lower[self.is_free], upper[self.is_free]
        return replace(self.program, lower=low, upper=high)

    def extract_step(self, solution: Float[np.ndarray, "M"]) -> Float[np.ndarray, "N"]:
        """Return the step ``dx`` of a solution of the program."""
        dx = np.zeros(len(self.is_free))
        dx[self.is_free] = solution[self.step_index]
        return dx


def assemble(
    model: ConvexModel, is_free: Bool[np.ndarray, "N"], is_hard: Bool[np.ndarray, "A"] | None = None
) -> Subproblem:
    """Write the model as a quadratic program in stage order.

    A stage holds as many consecutive waypoints as the longest row spans intervals, so that every row couples two
    neighbouring stages at most; each l1 row has one slack, placed in its last stage.

    Args:
        is_free: (N,) which step variables may move.
        is_hard: (A,) absolute rows that become equalities, which saves two rows and a slack each; the minimum is
            the same if their penalty would keep them at zero.
    """
    if is_hard is not None and is_hard.any():
        soft = replace(model, absolute=_select_rows(model.absolute, ~is_hard))
        subproblem = assemble(soft, is_free)
        E, f = _make_equalities(_select_rows(model.absolute, is_hard), subproblem)
        program = replace(subproblem.program, E=E, f=f) if len(f) else subproblem.program
        return replace(subproblem, program=program, soften=lambda: assemble(model, is_free))
    spans = [_find_span(part.rows.jacobian, model.n) for part in (model.squared, model.absolute, model.hinge)]
    longest = max(1, *(int((last - first).max(initial=0)) for first, last in spans))
    stage_of_waypoint = np.arange(model.n_waypoints) // longest
    stage_of_step = np.repeat(stage_of_waypoint, model.n)[is_free]
    n_steps = len(stage_of_step)
    l1 = [model.hinge, model.absolute]
    stage_of_slack = np.concatenate([stage_of_waypoint[spans[2][1]], stage_of_waypoint[spans[1][1]]])

    stages = np.concatenate([stage_of_step, stage_of_slack])
    is_step = np.arange(len(stages)) < n_steps
    # Within a stage the slacks come first: eliminated early, they fill in less.
    order = np.lexsort((np.arange(len(stages)), is_step, stages))
    total = len(stages)
    position = np.empty(total, dtype=np.int64)
    position[order] = np.arange(total)

    column = np.full(len(is_free), -1, dtype=np.int64)
    column[is_free] = position[:n_steps]
    slack = position[n_steps:]
    c = np.zeros(total)
    c[position[:n_steps]] = _make_gradient(model.squared)[is_free]
    hessian = make_hessian(model.squared, is_free) if model.hessian is None else model.hessian
    P = _spread(hessian, position[:n_steps], total)
    c[slack] = np.concatenate([part.weight for part in l1])

    n_hinge = len(model.hinge.weight)
    # Rows: hinge, absolute, negated absolute; each J dx - slack.
    slack_of_row = np.concatenate([slack, slack[n_hinge:]])
    by_stage = np.argsort(np.concatenate([stage_of_slack, stage_of_slack[n_hinge:]]), kind="stable")
    row_at = np.empty(len(by_stage), dtype=np.int64)
    row_at[by_stage] = np.arange(len(by_stage))
    G = _make_rows(model, column, row_at, slack_of_row, total)
    lower, upper = np.full(total, -np.inf), np.full(total, np.inf)
    lower[slack] = 0.0
    program = QuadraticProgram(P, c, G, _stack_bounds(model)[by_stage], lower, upper)
    if model.exact:
        program = add_exact_terms(program, model.exact, column)
    return Subproblem(program, position[:n_steps], is_free, by_stage)


def drop_idle_rows(model: ConvexModel, lower: Float[np.ndarray, "N"], upper: Float[np.ndarray, "N"]) -> ConvexModel:
    """Return the model without the hinge rows that are at most zero after every step within bounds.

    Within them the merit is the same.  Rows of a constraint no longer stand where ``constraint_rows`` has them.
    """
    rows = model.hinge.rows
    jacobian = rows.jacobian
    slope, column = jacobian.data, jacobian.indices
    rise = np.concatenate([[0.0], np.cumsum(slope * np.where(slope > 0.0, upper[column], lower[column]))])
    is_idle = rows.value + np.diff(rise[jacobian.indptr]) <= 0.0
    return replace(model, hinge=_select_rows(model.hinge, ~is_idle)) if is_idle.any() else model


def _select_rows(rows: WeightedRows, these: Bool[np.ndarray, "m"]) -> WeightedRows:
    return WeightedRows(rows.rows.select_rows(these), rows.weight[these])


def _make_equalities(rows: WeightedRows, subproblem: Subproblem) -> tuple[sparse.csc_array, Float[np.ndarray, "Q"]]:
    """Return the rows at zero in the program's variables, without those that no free variable moves."""
    jacobian = rows.rows.jacobian.tocoo()
    column = np.full(len(subproblem.is_free), -1, dtype=np.int64)
    column[subproblem.is_free] = subproblem.step_index
    row, col = jacobian.coords[0], column[jacobian.coords[1]]
    kept = col >= 0
    moving, index = np.unique(row[kept], return_inverse=True)
    E = _sort_columns(jacobian.data[kept], index, col[kept], (len(moving), len(subproblem.program.c)))
    return E, -rows.rows.value[moving]


def _stack_bounds(model: ConvexModel) -> np.ndarray:
    """Stack the right-hand sides of the hinge, absolute and negated absolute rows."""
    return np.concatenate([-model.hinge.rows.value, -model.absolute.rows.value, model.absolute.rows.value])


def _find_span(jacobian: sparse.csr_array, n: int) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """Return the first and last waypoint each row touches; 0 for rows that touch none."""
    counts = np.diff(jacobian.indptr)
    first, last = np.zeros(len(counts), dtype=np.int64), np.zeros(len(counts), dtype=np.int64)
    filled = counts > 0
    if filled.any():
        starts = jacobian.indptr[:-1][filled]
        first[filled] = np.minimum.reduceat(jacobian.indices, starts)
        last[filled] = np.maximum.reduceat(jacobian.indices, starts)
    return first // n, last // n


def _make_gradient(squared: WeightedRows) -> Float[np.ndarray, "N"]:
    return np.asarray(2.0 * (squared.rows.jacobian.T @ (squared.weight * squared.rows.value)))


def _spread(hessian: sparse.csc_array, position: Int[np.ndarray, "F"], total: int) -> sparse.csc_array:
    """Place a Hessian of step variables among all variables; ``position`` rises, so that the indices stay sorted."""
    indptr = np.zeros(total + 1, dtype=np.int32)
    indptr[position + 1] = np.diff(hessian.indptr)
    np.cumsum(indptr, out=indptr)
    indices = position[hessian.indices].astype(np.int32)
    return store_columns((hessian.data.copy(), indices, indptr), (total, total))  # solvers take what may be written


def _make_rows(
    model: ConvexModel,
    column: Int[np.ndarray, "N"],
    row_at: Int[np.ndarray, "M"],
    slack_of_row: Int[np.ndarray, "M"],
    total: int,
) -> sparse.csc_array:
    """Return ``J dx - slack`` of hinge, absolute and negated absolute rows, each at its row of the program."""
    hinge, absolute = model.hinge.rows.jacobian, model.absolute.rows.jacobian
    n_hinge, n_absolute = hinge.shape[0], absolute.shape[0]
    of_hinge = np.repeat(np.arange(n_hinge), np.diff(hinge.indptr))
    of_absolute = np.repeat(n_hinge + np.arange(n_absolute), np.diff(absolute.indptr))
    row = np.concatenate([of_hinge, of_absolute, of_absolute + n_absolute])
    col = column[np.concatenate([hinge.indices, absolute.indices, absolute.indices])]
    data = np.concatenate([hinge.data, absolute.data, -absolute.data])
    keep = col >= 0
    row = row_at[np.concatenate([row[keep], np.arange(len(row_at))])]
    col = np.concatenate([col[keep], slack_of_row])
    data = np.concatenate([data[keep], np.full(len(row_at), -1.0)])
    return _sort_columns(data, row, col, (len(row_at), total))


def _sort_columns(
    data: Float[np.ndarray, "E"], row: Int[np.ndarray, "E"], column: Int[np.ndarray, "E"], shape: tuple[int, int]
) -> sparse.csc_array:
    """Return the array of these entries, column by column with rising rows; those at the same place are added."""
    at = column * shape[0] + row
    order = np.argsort(at, kind="stable")
    if len(at) and not np.diff(at[order]).all():
        return sparse.csc_array((data, (row, column)), shape=shape)
    indptr = np.zeros(shape[1] + 1, dtype=np.int32)
    np.cumsum(np.bincount(column, minlength=shape[1]), out=indptr[1:])
    return store_columns((data[order], row[order].astype(np.int32), indptr), shape)
