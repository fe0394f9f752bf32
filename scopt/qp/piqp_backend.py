"""PIQP (Schwan et al., CDC 2023): proximal interior point with a multistage factorisation, for the loop."""

from __future__ import annotations

import piqp
from scipy import sparse

from scopt.errors import SolverError
from scopt.qp.program import QPSolution, QPStatus, QuadraticProgram

DUALITY_GAP = 1e-5  # of the objective, absolute and relative; PIQP's own 1e-8 costs two iterations of eleven

_STATUS = {
    piqp.PIQP_SOLVED: QPStatus.SOLVED,
    piqp.PIQP_MAX_ITER_REACHED: QPStatus.FAILED,
    piqp.PIQP_PRIMAL_INFEASIBLE: QPStatus.INFEASIBLE,
    piqp.PIQP_DUAL_INFEASIBLE: QPStatus.FAILED,
    piqp.PIQP_NUMERICS: QPStatus.FAILED,
    piqp.PIQP_UNSOLVED: QPStatus.FAILED,
    piqp.PIQP_INVALID_SETTINGS: QPStatus.FAILED,
}


def solve_piqp(program: QuadraticProgram, tolerance: float = 1e-6) -> QPSolution:
    """Solve with PIQP's ``sparse_multistage`` factorisation; fast when variables and rows come in stage order.

    Raises:
        SolverError: PIQP answered with a status that is not mapped.
    """
    solver = piqp.SparseSolver()
    settings = solver.settings
    settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    settings.eps_abs = tolerance
    settings.eps_rel = tolerance
    settings.eps_duality_gap_abs = DUALITY_GAP
    settings.eps_duality_gap_rel = DUALITY_GAP
    solver.setup(
        sparse.csc_matrix(program.P),
        program.c,
        None,
        None,
        sparse.csc_matrix(program.G),
        None,
        program.h,
        program.lower,
        program.upper,
    )
    status = solver.solve()
    if status not in _STATUS:
        raise SolverError(f"PIQP answered with an unknown status {status!r}")
    return QPSolution(solver.result.x.copy(), _STATUS[status])
