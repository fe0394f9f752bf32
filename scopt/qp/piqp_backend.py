"""Default QP back end, PIQP: proximal interior point, sparse or multistage (Schwan et al., CDC 2023)."""

from __future__ import annotations

import piqp

from scopt.affine import store_matrix
from scopt.errors import SolverError
from scopt.qp.program import QPSolution, QPStatus, QuadraticProgram

TOLERANCE = 1e-6  # absolute and relative
DUALITY_GAP = 1e-5  # of the objective, absolute and relative; PIQP's own 1e-8 costs two iterations of eleven

# The multistage factorisation treats a stage, slacks included, as dense: best for few rows of many joints (Atlas: three
# quarters of the other's time), worst where slacks outnumber joints (2,000 boxes: 23 times the other's).
MOST_ROWS = 0.7  # per variable
FEW_ENTRIES = 3000  # of both matrices; below it the sparse factorisation has less to set up
COUPLED = 8  # entries of the Hessian per variable from which stages are dense all the same: single poses of many joints
SCALINGS = 2  # of the data; PIQP's own ten take a third of the set-up and save no iteration

_STATUS = {
    piqp.PIQP_SOLVED: QPStatus.SOLVED,
    piqp.PIQP_MAX_ITER_REACHED: QPStatus.FAILED,
    piqp.PIQP_PRIMAL_INFEASIBLE: QPStatus.INFEASIBLE,
    piqp.PIQP_DUAL_INFEASIBLE: QPStatus.FAILED,
    piqp.PIQP_NUMERICS: QPStatus.FAILED,
    piqp.PIQP_UNSOLVED: QPStatus.FAILED,
    piqp.PIQP_INVALID_SETTINGS: QPStatus.FAILED,
}


def solve_piqp(program: QuadraticProgram) -> QPSolution:
    """Solve with PIQP's factorisation that suits the program; variables and rows are expected in stage order.

    Raises:
        SolverError: PIQP answered with a status that is not mapped.
    """
    solver = piqp.SparseSolver()
    settings = solver.settings
    size = len(program.c)
    is_small = program.G.nnz + program.P.nnz < FEW_ENTRIES and program.P.nnz < COUPLED * size
    is_sparse = is_small or len(program.h) > MOST_ROWS * size
    settings.kkt_solver = piqp.KKTSolver.sparse_ldlt if is_sparse else piqp.KKTSolver.sparse_multistage
    settings.preconditioner_iter = SCALINGS
    settings.eps_abs = settings.eps_rel = TOLERANCE
    settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = DUALITY_GAP
    solver.setup(
        store_matrix(program.P),
        program.c,
        None if program.E is None else store_matrix(program.E),
        program.f,
        store_matrix(program.G),
        None,
        program.h,
        program.lower,
        program.upper,
    )
    status = solver.solve()
    if status not in _STATUS:
        raise SolverError(f"PIQP answered with an unknown status {status!r}")
    return QPSolution(solver.result.x.copy(), _STATUS[status])
