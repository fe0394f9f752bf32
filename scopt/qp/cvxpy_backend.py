"""Reference QP back end, CVXPY: slow, and independent of this package's assembly of solver inputs."""

from __future__ import annotations

import numpy as np

from scopt.errors import SolverError
from scopt.qp.program import QPMultipliers, QPSolution, QPStatus, QuadraticProgram


def solve_cvxpy(program: QuadraticProgram) -> QPSolution:
    """Solve with CVXPY and the solver it prefers for QPs among those installed (Clarabel).

    Raises:
        SolverError: CVXPY answered with a status that is not mapped.
    """
    import cvxpy  # takes 0.7 s to import and is the reference only

    status_of = {
        cvxpy.OPTIMAL: QPStatus.SOLVED,
        cvxpy.OPTIMAL_INACCURATE: QPStatus.INACCURATE,
        cvxpy.INFEASIBLE: QPStatus.INFEASIBLE,
        cvxpy.INFEASIBLE_INACCURATE: QPStatus.INFEASIBLE,
        cvxpy.UNBOUNDED: QPStatus.FAILED,
        cvxpy.UNBOUNDED_INACCURATE: QPStatus.FAILED,
        cvxpy.SOLVER_ERROR: QPStatus.FAILED,
        cvxpy.USER_LIMIT: QPStatus.FAILED,
        "infeasible_or_unbounded": QPStatus.FAILED,
    }
    n = len(program.c)
    x = cvxpy.Variable(n)
    has_lower, has_upper = np.isfinite(program.lower), np.isfinite(program.upper)
    constraints = [
        program.G @ x <= program.h,
        x[has_lower] >= program.lower[has_lower],
        x[has_upper] <= program.upper[has_upper],
    ]
    if program.E is not None:
        constraints.append(program.E @ x == program.f)
    objective = 0.5 * cvxpy.quad_form(x, cvxpy.psd_wrap(program.P)) + program.c @ x
    problem = cvxpy.Problem(cvxpy.Minimize(objective), [c for c in constraints if c.size])
    try:
        problem.solve(solver=cvxpy.CLARABEL)
    except cvxpy.SolverError:
        return QPSolution(np.full(n, np.nan), QPStatus.FAILED)
    if problem.status not in status_of:
        raise SolverError(f"CVXPY answered with an unknown status {problem.status!r}")
    if x.value is None:
        return QPSolution(np.full(n, np.nan), status_of[problem.status])
    rows, lower, upper = (np.zeros(0) if c.dual_value is None else np.asarray(c.dual_value) for c in constraints[:3])
    multipliers = QPMultipliers.of_parts(rows, lower, upper, has_lower, has_upper)
    return QPSolution(np.asarray(x.value), status_of[problem.status], multipliers)
