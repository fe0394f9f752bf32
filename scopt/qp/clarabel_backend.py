"""Fall-back QP back end and conic solver, Clarabel: interior point (Goulart and Chen, 2024)."""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from scopt.errors import SolverError
from scopt.qp.cones import Cone, ConicProgram
from scopt.qp.program import QPMultipliers, QPSolution, QPStatus, QuadraticProgram

_STATUS = {
    "Solved": QPStatus.SOLVED,
    "AlmostSolved": QPStatus.INACCURATE,
    "PrimalInfeasible": QPStatus.INFEASIBLE,
    "AlmostPrimalInfeasible": QPStatus.INFEASIBLE,
    "DualInfeasible": QPStatus.FAILED,
    "AlmostDualInfeasible": QPStatus.FAILED,
    "MaxIterations": QPStatus.FAILED,
    "MaxTime": QPStatus.FAILED,
    "NumericalError": QPStatus.FAILED,
    "InsufficientProgress": QPStatus.FAILED,
    "CallbackTerminated": QPStatus.FAILED,
    "Unsolved": QPStatus.FAILED,
}


def solve_clarabel(program: QuadraticProgram) -> QPSolution:
    """Solve a quadratic or conic program with Clarabel at its default tolerances (1e-8).

    Raises:
        SolverError: Clarabel answered with a status that is not mapped.
    """
    has_lower, has_upper = np.isfinite(program.lower), np.isfinite(program.upper)
    identity = sparse.eye_array(len(program.c), format="csc")
    rows = sparse.vstack([program.G, identity[has_upper], -identity[has_lower]], format="csc")
    bounds = np.concatenate([program.h, program.upper[has_upper], -program.lower[has_lower]])
    cones = [clarabel.NonnegativeConeT(len(bounds))]
    if isinstance(program, ConicProgram):
        rows = sparse.vstack([rows, program.A], format="csc")
        bounds = np.concatenate([bounds, program.b])
        cones += [_make_cone(cone) for cone in program.cones]
    if program.E is not None and program.f is not None:
        rows = sparse.vstack([rows, program.E], format="csc")
        bounds = np.concatenate([bounds, program.f])
        cones.append(clarabel.ZeroConeT(len(program.f)))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(program.P, format="csc")),
        program.c,
        sparse.csc_matrix(rows),
        bounds,
        cones,
        settings,
    )
    solution = solver.solve()
    status = str(solution.status)
    if status not in _STATUS:
        raise SolverError(f"Clarabel answered with an unknown status {status!r}")
    parts = np.cumsum([len(program.h), has_upper.sum(), has_lower.sum()])
    of_rows, of_upper, of_lower, _ = np.split(np.asarray(solution.z), parts)
    multipliers = QPMultipliers.of_parts(of_rows, of_lower, of_upper, has_lower, has_upper)
    return QPSolution(np.asarray(solution.x), _STATUS[status], multipliers)


def _make_cone(cone: Cone) -> object:
    """Make Clarabel's cone."""
    make = getattr(clarabel, cone.kind.value)
    return make() if cone.parameter is None else make(cone.parameter)
