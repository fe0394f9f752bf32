"""Quadratic programs and their solvers, selectable by name."""

from __future__ import annotations

from scopt.errors import SolverError
from scopt.qp.clarabel_backend import solve_clarabel
from scopt.qp.cones import ConicProgram
from scopt.qp.cvxpy_backend import solve_cvxpy
from scopt.qp.piqp_backend import solve_piqp
from scopt.qp.program import QPBackend, QPMultipliers, QPSolution, QPStatus, QuadraticProgram

BACKENDS: dict[str, QPBackend] = {"piqp": solve_piqp, "clarabel": solve_clarabel, "cvxpy": solve_cvxpy}


def select_backend(name: str) -> QPBackend:
    """Return the back end with a name.

    Raises:
        SolverError: the name is unknown.
    """
    if name not in BACKENDS:
        raise SolverError(f"unknown QP back end '{name}'; expected one of {', '.join(BACKENDS)}")
    return BACKENDS[name]


__all__ = [
    "BACKENDS",
    "ConicProgram",
    "QPBackend",
    "QPMultipliers",
    "QPSolution",
    "QPStatus",
    "QuadraticProgram",
    "select_backend",
    "solve_clarabel",
]
