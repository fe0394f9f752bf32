"""Multipliers of constraint rows and bounds at an iterate, in the convex model of the l1 penalty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from scopt.affine import AffineRows
from scopt.convex_model import ConvexModel, assemble, convexify
from scopt.errors import SolverError
from scopt.problem import Penalty, Problem
from scopt.qp import select_backend
from scopt.residual import StateT


@dataclass(frozen=True)
class Multipliers:
    """Rise of the modelled merit per unit by which a row or a bound is tightened.

    A violated row has its whole weight ``mu * scale``, a row that is kept with ease has zero, and rows in between keep
    the violated ones from improving.

    Attributes:
        rows: per constraint, its rows linearised at the iterate.
        constraints: per constraint, (m,) one multiplier for each row; >= 0 of AT_MOST_ZERO, signed of EQUAL_ZERO.
        lower, upper: (T, n) of the problem's bounds, >= 0; zero for variables that are fixed.
    """

    rows: Mapping[str, AffineRows]
    constraints: Mapping[str, Float[np.ndarray, "m"]]
    lower: Float[np.ndarray, "T n"]
    upper: Float[np.ndarray, "T n"]


def compute_multipliers(
    problem: Problem[StateT], x: Float[np.ndarray, "T n"], mu: float, radius: float = 1e-2, qp: str = "clarabel"
) -> Multipliers:
    """Compute multipliers at an iterate from one quadratic program in a small box around it.

    Args:
        problem: without costs, the multipliers show the constraints' conflict alone.
        x: (T, n) within the bounds: a local minimum of the merit, or near one.
        mu: l1 penalty.
        radius: of the box, times ``problem.step_scale`` [variable units].
        qp: a back end that returns multipliers.

    Raises:
        SolverError: the back end fails or returns no multipliers.
    """
    model = convexify(problem, problem.state(x), mu, is_affine=True)
    is_free = (problem.upper > problem.lower).ravel()
    subproblem = assemble(model, is_free)
    scale = np.ones(x.shape[1]) if problem.step_scale is None else problem.step_scale
    box = np.tile(radius * scale, len(x))
    to_lower, to_upper = (problem.lower - x).ravel(), (problem.upper - x).ravel()
    program = subproblem.bound_steps(np.maximum(to_lower, -box), np.minimum(to_upper, box))
    lower, upper = np.zeros(len(box)), np.zeros(len(box))
    of_rows = np.zeros(len(program.h))
    if program.c.size:  # back ends crash on a program without variables
        solution = select_backend(qp)(program)
        if not solution.is_usable or solution.multipliers is None:
            raise SolverError(f"QP back end '{qp}' gave no multipliers ({solution.status.value})")
        of_rows[subproblem.row_order] = solution.multipliers.rows
        lower[is_free] = solution.multipliers.lower[subproblem.step_index]
        upper[is_free] = solution.multipliers.upper[subproblem.step_index]
    return Multipliers(
        {name: model.select_constraint(name) for name in model.constraint_rows},
        _split_by_constraint(model, of_rows),
        # Other multipliers on the box's sides belong to the box, not to the problem's bounds.
        np.where(to_lower >= -box, lower, 0.0).reshape(x.shape),
        np.where(to_upper <= box, upper, 0.0).reshape(x.shape),
    )


def _split_by_constraint(model: ConvexModel, of_rows: Float[np.ndarray, "M"]) -> dict[str, Float[np.ndarray, "m"]]:
    """Return multipliers by name, given those of the hinge, absolute and negated absolute rows."""
    n_hinge, n_absolute = len(model.hinge.weight), len(model.absolute.weight)
    above, below = of_rows[n_hinge : n_hinge + n_absolute], of_rows[n_hinge + n_absolute :]
    of_kind = {Penalty.HINGE: of_rows[:n_hinge], Penalty.ABS: above - below}
    return {name: of_kind[kind][rows] for name, (kind, rows) in model.constraint_rows.items()}
