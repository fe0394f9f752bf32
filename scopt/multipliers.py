"""What holds an iterate where it is: the multipliers of constraint rows and bounds in the l1 penalty's convex model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from scopt.affine import AffineRows
from scopt.convex_model import ConvexModel, assemble, convexify
from scopt.errors import SolverError
from scopt.problem import Penalty, Problem
from scopt.qp import backend
from scopt.residual import StateT


@dataclass(frozen=True)
class Multipliers:
    """How much the modelled merit would rise for each unit by which a row or a bound were tightened.

    A row of a constraint that cannot be kept has its whole weight ``penalty * scale``, one that is kept with ease has
    zero, and what stands between holds the violated rows from getting better.

    Attributes:
        rows: per constraint, its rows linearised at the iterate.
        constraints: per constraint, (m,) one multiplier for each row; >= 0 of AT_MOST_ZERO, signed of EQUAL_ZERO.
        lower, upper: (T, n) of the problem's bounds, >= 0; zero for variables that are fixed.
    """

    rows: Mapping[str, AffineRows]
    constraints: Mapping[str, Float[np.ndarray, "m"]]
    lower: Float[np.ndarray, "T n"]
    upper: Float[np.ndarray, "T n"]


def multipliers(
    problem: Problem[StateT], x: Float[np.ndarray, "T n"], penalty: float, radius: float = 1e-2, qp: str = "clarabel"
) -> Multipliers:
    """Multipliers at an iterate, from one quadratic program in a small box around it.

    Args:
        problem: without costs, what is measured is how the constraints stand against each other alone.
        x: (T, n) within the bounds: a local minimum of the merit, or near one.
        penalty: mu of the l1 penalty.
        radius: of the box, times ``problem.step_scale`` [variable units]; what lies beyond it does not count.
        qp: a back end that hands its multipliers over.

    Raises:
        SolverError: the back end fails, or hands over no multipliers.
    """
    model = convexify(problem, problem.state(x), penalty, is_affine=True)
    is_free = (problem.upper > problem.lower).ravel()
    subproblem = assemble(model, is_free)
    scale = np.ones(x.shape[1]) if problem.step_scale is None else problem.step_scale
    box = np.tile(radius * scale, len(x))
    to_lower, to_upper = (problem.lower - x).ravel(), (problem.upper - x).ravel()
    program = subproblem.within(np.maximum(to_lower, -box), np.minimum(to_upper, box))
    lower, upper = np.zeros(len(box)), np.zeros(len(box))
    of_rows = np.zeros(len(program.h))
    if program.c.size:  # back ends crash on a program without variables
        solution = backend(qp)(program)
        if not solution.is_usable or solution.multipliers is None:
            raise SolverError(f"QP back end '{qp}' gave no multipliers ({solution.status.value})")
        of_rows[subproblem.row_order] = solution.multipliers.rows
        lower[is_free] = solution.multipliers.lower[subproblem.step_index]
        upper[is_free] = solution.multipliers.upper[subproblem.step_index]
    return Multipliers(
        {name: _rows(model, kind, rows) for name, (kind, rows) in model.constraint_rows.items()},
        _by_constraint(model, of_rows),
        # The rest of what acts on the box's sides is the box's doing, not the problem's.
        np.where(to_lower >= -box, lower, 0.0).reshape(x.shape),
        np.where(to_upper <= box, upper, 0.0).reshape(x.shape),
    )


def _rows(model: ConvexModel, kind: Penalty, rows: slice) -> AffineRows:
    part = model.absolute if kind is Penalty.ABS else model.hinge
    return AffineRows(part.rows.value[rows], part.rows.jacobian[rows])


def _by_constraint(model: ConvexModel, of_rows: Float[np.ndarray, "M"]) -> dict[str, Float[np.ndarray, "m"]]:
    """Multipliers by name, from those of the hinge, absolute and negated absolute rows."""
    n_hinge, n_absolute = len(model.hinge.weight), len(model.absolute.weight)
    above, below = of_rows[n_hinge : n_hinge + n_absolute], of_rows[n_hinge + n_absolute :]
    of_kind = {Penalty.HINGE: of_rows[:n_hinge], Penalty.ABS: above - below}
    return {name: of_kind[kind][rows] for name, (kind, rows) in model.constraint_rows.items()}
