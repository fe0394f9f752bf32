"""Quadratic programs and the solvers that solve them, each selectable by name."""

from __future__ import annotations

from scopt.errors import SolverError
from scopt.qp.clarabel_backend import solve_clarabel
from scopt.qp.cones import ConicProgram
from scopt.qp.cvxpy_backend import solve_cvxpy
from scopt.qp.piqp_backend import solve_piqp
from scopt.qp.program import QPBackend, QPMultipliers, QPSolution, QPStatus, QuadraticProgram

BACKENDS: dict[str, QPBackend] = {"piqp": solve_piqp, "clarabel": solve_clarabel, "cvxpy": solve_cvxpy}


def backend(name: str) -> QPBackend:
    """The back end of that name.

    Raises:
        SolverError: no back end has that name.
    """
    if name not in BACKENDS:
        raise SolverError(f"unknown QP back end '{name}'; there are {', '.join(BACKENDS)}")
    return BACKENDS[name]


__all__ = [
    "BACKENDS",
    "ConicProgram",
    "QPBackend",
    "QPMultipliers",
    "QPSolution",
    "QPStatus",
    "QuadraticProgram",
    "backend",
    "solve_clarabel",
]
