"""Second-order correction: a step is bent so that smooth constraints end where their linear model said they would."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from scopt.affine import AffineRows
from scopt.convex_model import ConvexModel
from scopt.problem import Constraint, Penalty, Problem, Sense

ROUNDS = 2  # each leaves of the error what the correction's own curvature makes
NEGLIGIBLE = 1e-9  # errors below it are left [unit of the residual]
DAMPING = 1e-9  # of the normal equations, for rows that depend on one another
MOST = 0.5  # a correction longer than this share of the step is no small correction


@dataclass(frozen=True)
class Correction:
    """The least change of a step that takes the curvature out of smooth constraints.

    Nocedal and Wright, Numerical Optimization, 2006, eq. 15.36: ``-A^T (A A^T)^-1 (c(x + p) - (c + A p))``, in a metric
    in which the variables of ``Problem.mobility`` move readily.  Planted feet are such constraints: without it their
    curvature makes the merit refuse every long step (the Maratos effect).  Rows are solved waypoint by waypoint.

    Attributes:
        problem: whose constraints these are.
        x: (T, n) the iterate.
        smooth: the constraints that are corrected.
        rows: (m,) their rows in the model.
        is_equal: (m,) whether a row is to be zero; else at most zero.
        place: (m,) where each row stands in the (T, K) rows of all waypoints.
        moved: (T, n, K) how the variables follow the rows, ``M J^T``.
        normal: (T, K, K) ``J M J^T``.
    """

    problem: Problem[Any]
    x: Float[np.ndarray, "T n"]
    smooth: tuple[Constraint[Any], ...]
    rows: AffineRows
    is_equal: Bool[np.ndarray, "m"]
    place: Int[np.ndarray, "m"]
    moved: Float[np.ndarray, "T n K"]
    normal: Float[np.ndarray, "T K K"]

    @staticmethod
    def of(problem: Problem[Any], x: Float[np.ndarray, "T n"], model: ConvexModel) -> Correction | None:
        """The correction of steps from ``x``; None where no constraint is smooth."""
        smooth = tuple(c for c in problem.constraints if c.residual.is_smooth and c.name in model.constraint_rows)
        if not smooth:
            return None
        parts = [_rows_of(model, constraint.name) for constraint in smooth]
        rows = AffineRows.stack(parts)
        is_equal = np.repeat([c.sense is Sense.EQUAL_ZERO for c in smooth], [len(part.value) for part in parts])
        place, jacobian = _by_waypoint(rows, *x.shape)
        mobility = np.ones(x.shape[1]) if problem.mobility is None else problem.mobility
        mobility = np.where(problem.upper > problem.lower, mobility, 0.0)
        moved = mobility[:, :, None] * jacobian.transpose(0, 2, 1)
        return Correction(problem, x, smooth, rows, is_equal, place, moved, jacobian @ moved)

    def __call__(self, dx: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
        """The step ``dx`` bent, or as it is where the least change would not be small."""
        problem, bent = self.problem, dx.reshape(self.x.shape)
        measure = problem.state if problem.smooth_state is None else problem.smooth_state
        promised = self.rows.at(dx)
        allowed = np.maximum(promised, 0.0)
        most = MOST * float(np.abs(dx).max(initial=0.0))
        for _ in range(ROUNDS):
            state = measure(np.clip(self.x + bent, problem.lower, problem.upper))
            value = np.concatenate([constraint.residual.value(state) for constraint in self.smooth])
            error = np.where(self.is_equal, value - promised, np.maximum(value - allowed, 0.0))
            if np.abs(error).max() < NEGLIGIBLE:
                break
            change = self._least_change(error)
            if not np.abs(change).max() <= most:  # nor is a change that is no number
                return dx
            bent = bent - change
        return bent.ravel()

    def _least_change(self, error: Float[np.ndarray, "m"]) -> Float[np.ndarray, "T n"]:
        """The least change that the linear model answers with ``error``; rows without one are left free."""
        normal = self.normal
        wanted = np.zeros(normal.shape[0] * normal.shape[1])
        wanted[self.place] = error
        wanted = wanted.reshape(normal.shape[:2])
        is_off = (np.abs(wanted) >= NEGLIGIBLE).astype(float)
        system = normal * is_off[:, :, None] * is_off[:, None, :]
        diagonal = np.arange(normal.shape[1])
        system[:, diagonal, diagonal] += DAMPING + 1.0 - is_off
        multiplier = np.linalg.solve(system, (wanted * is_off)[:, :, None])
        return np.asarray((self.moved @ multiplier)[:, :, 0])


def _rows_of(model: ConvexModel, name: str) -> AffineRows:
    kind, rows = model.constraint_rows[name]
    return (model.absolute if kind is Penalty.ABS else model.hinge).rows.part(rows.start, rows.stop)


def _by_waypoint(
    rows: AffineRows, n_waypoints: int, n: int
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "T K n"]]:
    """Rows sorted to the waypoint they touch: where each stands, and the Jacobians (those of their first waypoint)."""
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
