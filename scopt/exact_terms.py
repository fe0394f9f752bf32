"""Convex expressions in a convex model and in its subproblem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from scopt.expression import ConvexExpression
from scopt.problem import Penalty
from scopt.qp import ConicProgram, QuadraticProgram
from scopt.qp.cones import Cone


@dataclass(frozen=True)
class ExactTerm:
    """``weight * sum penalty(f)`` of a convex expression ``f``, as it is.

    Attributes:
        expression: not affine; nonnegative unless the penalty is HINGE.
        penalty: HINGE for constraints.
        weight: of every row.
        x: (T, n) the iterate.
    """

    expression: ConvexExpression[Any]
    penalty: Penalty
    weight: float
    x: Float[np.ndarray, "T n"]

    def merit(self, dx: Float[np.ndarray, "N"]) -> float:
        """Return the term's merit after a step ``dx``."""
        above = np.maximum(self.expression.measure(self.x + dx.reshape(self.x.shape)), 0.0)
        return self.weight * float(above @ above if self.penalty is Penalty.SQUARED else above.sum())


def add_exact_terms(
    program: QuadraticProgram,
    terms: Sequence[ExactTerm],
    column: Int[np.ndarray, "N"],
) -> ConicProgram:
    """Add the terms to a program; its new variables come last.

    Every row of a term has a variable ``t >= max(f(x + dx), 0)``, which stands for ``f`` in the objective.

    Args:
        program: program of the affine rows.
        terms: convex terms at the same iterate.
        column: (N,) place of each step variable in the program, -1 for fixed ones.
    """
    parts = [_Part.of(term, column, len(program.c)) for term in terms]
    n_new = sum(len(part.linear) for part in parts)
    P = sparse.block_diag([program.P, *(sparse.diags_array(part.squared) for part in parts)], format="csc")
    G = sparse.hstack([program.G, sparse.csc_array((len(program.h), n_new))], format="csc")
    by_old = sparse.vstack([part.by_old for part in parts])
    by_new = sparse.block_diag([part.by_new for part in parts])
    return ConicProgram(
        P=sparse.csc_array(P),
        c=np.concatenate([program.c, *(part.linear for part in parts)]),
        G=sparse.csc_array(G),
        h=program.h,
        lower=np.concatenate([program.lower, *(part.lower for part in parts)]),
        upper=np.concatenate([program.upper, np.full(n_new, np.inf)]),
        A=sparse.csc_array(sparse.hstack([by_old, by_new], format="csc")),
        b=np.concatenate([part.b for part in parts]),
        cones=tuple(cone for part in parts for cone in part.cones),
    )


@dataclass(frozen=True)
class _Part:
    """Rows and variables that one term adds to a program.

    Attributes:
        by_old: (r, M) its rows in the program's variables.
        by_new: (r, a) in its own.
        b: (r,) their right-hand sides.
        cones: of the rows.
        linear, squared: (a,) of its variables in the objective.
        lower: (a,) bounds of its variables.
    """

    by_old: sparse.csr_array
    by_new: sparse.csr_array
    b: Float[np.ndarray, "r"]
    cones: tuple[Cone, ...]
    linear: Float[np.ndarray, "a"]
    squared: Float[np.ndarray, "a"]
    lower: Float[np.ndarray, "a"]

    @staticmethod
    def of(term: ExactTerm, column: Int[np.ndarray, "N"], n_old: int) -> _Part:
        form, x = term.expression.form, term.x
        waypoints = term.expression.at(len(x))
        each = sparse.eye_array(len(waypoints))
        by_x = sparse.csr_array(sparse.kron(each, form.by_q, format="csr"))
        variables = (waypoints[:, None] * x.shape[1] + np.arange(x.shape[1])).ravel()
        moving = np.flatnonzero(column[variables] >= 0)
        to_old = (np.ones(len(moving)), (moving, column[variables[moving]]))
        # the rows' variables t and y, each waypoint's behind the other's
        by_new = sparse.kron(each, sparse.hstack([form.by_t, form.by_more]), format="csr")
        n_t, n_y = form.by_t.shape[1], form.by_more.shape[1]
        is_squared = term.penalty is Penalty.SQUARED

        def of_new(of_t: float, of_y: float) -> np.ndarray:
            return np.tile(np.concatenate([np.full(n_t, of_t), np.full(n_y, of_y)]), len(waypoints))

        return _Part(
            by_old=sparse.csr_array(by_x @ sparse.csr_array(to_old, shape=(len(variables), n_old))),
            by_new=sparse.csr_array(by_new),
            b=np.tile(form.b, len(waypoints)) - by_x @ x.ravel()[variables],
            cones=form.cones * len(waypoints),
            linear=of_new(0.0 if is_squared else term.weight, 0.0),
            squared=of_new(2.0 * term.weight if is_squared else 0.0, 0.0),
            lower=of_new(0.0, -np.inf),
        )
