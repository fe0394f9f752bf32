"""Second-order correction of steps, after which smooth constraints have the values their linear model promised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from scopt.affine import AffineRows
from scopt.convex_model import ConvexModel
from scopt.problem import Constraint, Problem, Sense

ROUNDS = 3  # each leaves of the error what the correction's own curvature makes
MOST_ROUNDS = 8  # including rounds in which variables meet their bounds
NEGLIGIBLE = 1e-9  # errors below it are left [unit of the residual]
DAMPING = 1e-9  # of the normal equations, for rows that depend on one another
MOST = 0.5  # share of the step; a longer correction is not made


@dataclass(frozen=True)
class Correction:
    """Least change of a step that removes the curvature of smooth constraints.

    Nocedal and Wright, Numerical Optimization, 2006, eq. 15.36: ``-A^T (A A^T)^-1 (c(x + p) - (c + A p))``, in the
    metric of ``Problem.mobility``.  Without it the curvature of planted feet makes the merit refuse every long step
    (the Maratos effect).  Rows are solved waypoint by waypoint.

    Attributes:
        x: (T, n) the iterate.
        smooth: the constraints that are corrected.
        rows: (m,) their rows in the model.
        is_equal: (m,) whether a row must be zero; else at most zero.
        place: (m,) where each row stands in the (T, K) rows of all waypoints.
        jacobian: (T, K, n) Jacobian of each waypoint's rows, zero for unused places.
        mobility: (T, n) the metric ``M``, zero for fixed variables.
    """

    problem: Problem[Any]
    x: Float[np.ndarray, "T n"]
    smooth: tuple[Constraint[Any], ...]
    rows: AffineRows
    is_equal: Bool[np.ndarray, "m"]
    place: Int[np.ndarray, "m"]
    jacobian: Float[np.ndarray, "T K n"]
    mobility: Float[np.ndarray, "T n"]

    @staticmethod
    def of(problem: Problem[Any], x: Float[np.ndarray, "T n"], model: ConvexModel) -> Correction | None:
        """Return the correction of steps from ``x``; None where no constraint is smooth."""
        smooth = tuple(c for c in problem.constraints if c.residual.is_smooth and c.name in model.constraint_rows)
        if not smooth:
            return None
        parts = [model.select_constraint(constraint.name) for constraint in smooth]
        rows = AffineRows.stack(parts)
        is_equal = np.repeat([c.sense is Sense.EQUAL_ZERO for c in smooth], [len(part.value) for part in parts])
        place, jacobian = _sort_by_waypoint(rows, *x.shape)
        mobility = np.ones(x.shape[1]) if problem.mobility is None else problem.mobility
        mobility = np.where(problem.upper > problem.lower, mobility, 0.0)
        return Correction(problem, x, smooth, rows, is_equal, place, jacobian, mobility)

    def __call__(self, dx: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
        """Return the corrected step, or ``dx`` itself where the correction would not be small."""
        problem = self.problem
        measure = problem.state if problem.smooth_state is None else problem.smooth_state
        lower, upper = problem.lower - self.x, problem.upper - self.x
        promised = self.rows.at(dx)
        allowed = np.maximum(promised, 0.0)
        most = MOST * float(np.abs(dx).max(initial=0.0))
        bent: Float[np.ndarray, "T n"] = np.clip(dx.reshape(self.x.shape), lower, upper)
        mobility = self.mobility
        rounds = 0
        for _ in range(MOST_ROUNDS):
            state = measure(self.x + bent)
            value = np.concatenate([constraint.residual.value(state) for constraint in self.smooth])
            error = np.where(self.is_equal, value - promised, np.maximum(value - allowed, 0.0))
            if np.abs(error).max() < NEGLIGIBLE:
                break
            change = self._least_change(error, mobility)
            if not np.abs(change).max() <= most:  # also true of NaN
                return dx
            wanted = bent - change
            bent = np.clip(wanted, lower, upper)
            is_free = bent == wanted
            mobility = np.where(is_free, mobility, 0.0)  # variables at their bounds cannot help
            rounds += int(is_free.all())
            if rounds == ROUNDS:
                break
        return np.asarray(bent.ravel())

    def _least_change(
        self, error: Float[np.ndarray, "m"], mobility: Float[np.ndarray, "T n"]
    ) -> Float[np.ndarray, "T n"]:
        """Return the least change that changes the linear model by ``error``; rows without an error are left free."""
        n_waypoints, most, _ = self.jacobian.shape
        wanted = np.zeros(n_waypoints * most)
        wanted[self.place] = error
        wanted = wanted.reshape(n_waypoints, most, 1)
        is_off = np.abs(wanted) >= NEGLIGIBLE
        jacobian = self.jacobian * is_off
        moved = mobility[:, :, None] * jacobian.transpose(0, 2, 1)
        system = jacobian @ moved
        diagonal = np.arange(most)
        system[:, diagonal, diagonal] += np.where(is_off[:, :, 0], DAMPING, 1.0)
        return np.asarray((moved @ np.linalg.solve(system, wanted * is_off))[:, :, 0])


def _sort_by_waypoint(
    rows: AffineRows, n_waypoints: int, n: int
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "T K n"]]:
    """Sort rows by the first waypoint they touch: return where each stands, and their Jacobians there."""
    jacobian = rows.jacobian
    counts = np.diff(jacobian.indptr)
    waypoint = np.zeros(len(counts), dtype=np.int64)
    waypoint[counts > 0] = np.minimum.reduceat(jacobian.indices, jacobian.indptr[:-1][counts > 0]) // n
    order = np.argsort(waypoint, kind="stable")
    per_waypoint = np.bincount(waypoint, minlength=n_waypoints)
    within = np.empty(len(counts), dtype=np.int64)
    within[order] = np.arange(len(counts)) - np.repeat(np.cumsum(per_waypoint) - per_waypoint, per_waypoint)
    most = int(per_waypoint.max())
    place = waypoint * most + within
    blocks = np.zeros((n_waypoints * most, n))
    row = np.repeat(np.arange(len(counts)), counts)
    own = jacobian.indices // n == waypoint[row]
    blocks[place[row[own]], (jacobian.indices % n)[own]] = jacobian.data[own]
    return place, blocks.reshape(n_waypoints, most, n)
