"""Quadratic programs in a box, for a few dozen variables and a thousand solutions per second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import piqp
from jaxtyping import Bool, Float
from scipy.linalg.lapack import dposv

TOLERANCE = 1e-9  # of PIQP, and of the polished solution relative to the largest entry of the linear term (or to 1)

MAX_EXCHANGES = 6  # of variables at their bounds, before the answer of PIQP is taken as it is


class BoxQPError(ValueError):
    """Error for a program without a solution: an empty box, or a matrix that is not positive definite."""


@dataclass(frozen=True)
class BoxSolution:
    """Minimiser of a quadratic function in a box.

    Attributes:
        x: (n,) the minimiser.
        is_bound: (n,) whether a variable is at its bound and pushes against it.
        is_polished: whether the optimality conditions hold to rounding; otherwise to the tolerance of PIQP.
    """

    x: Float[np.ndarray, "n"]
    is_bound: Bool[np.ndarray, "n"]
    is_polished: bool


def solve_box_qp(
    P: Float[np.ndarray, "n n"],
    c: Float[np.ndarray, "n"],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
) -> BoxSolution:
    """Minimise ``1/2 x' P x + c' x`` subject to ``lower <= x <= upper``.

    The unbounded minimiser is tried first; one Cholesky factorisation gives it, and it is the answer in most control
    cycles.  Else PIQP's dense solver says which variables are at their bounds, and one more factorisation of the others
    makes the answer exact.

    Args:
        P: symmetric and positive definite.
        c: linear term.
        lower, upper: bounds; infinite where there is none.

    Raises:
        BoxQPError: the box is empty, P is not positive definite, a number is not finite, or PIQP fails.
    """
    if not (lower <= upper).all():
        worst = int(np.argmax(np.where(np.isnan(lower - upper), np.inf, lower - upper)))
        raise BoxQPError(f"lower[{worst}] {lower[worst]:g} is above upper[{worst}] {upper[worst]:g}")
    free = _solve(P, -c)
    if not np.isfinite(free).all():
        raise BoxQPError("P or c is not finite")
    if (lower <= free).all() and (free <= upper).all():
        return BoxSolution(free, np.zeros(len(c), dtype=bool), True)
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = TOLERANCE
    solver.settings.eps_duality_gap_abs = solver.settings.eps_duality_gap_rel = TOLERANCE
    solver.setup(P, c, x_l=lower, x_u=upper)
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        raise BoxQPError(f"PIQP ended with {status.name}; is P positive definite and well scaled?")
    result = solver.result
    below, above = result.z_bl > result.x - lower, result.z_bu > upper - result.x
    polished = _polish(P, c, lower, upper, below, above)
    return polished or BoxSolution(np.clip(result.x, lower, upper), below | above, False)


def _polish(
    P: np.ndarray, c: np.ndarray, lower: np.ndarray, upper: np.ndarray, below: np.ndarray, above: np.ndarray
) -> BoxSolution | None:
    """Return the exact minimiser for nearly the right variables at their bounds; None if it is not found soon.

    Variables that violate a bound are put there, and those that do not push against theirs are released (Hintermueller,
    Ito and Kunisch, SIAM J. Optim. 2003).

    Args:
        P, c, lower, upper: the program.
        below, above: variables that are thought to be at their lower, upper bound.
    """
    largest = TOLERANCE * max(1.0, float(np.abs(c).max()))
    for _ in range(MAX_EXCHANGES):
        x = np.where(below, lower, np.where(above, upper, 0.0))
        moves = np.flatnonzero(~(below | above))
        if len(moves):
            x[moves] = _solve(P[np.ix_(moves, moves)], -(c + P @ x)[moves])
        gradient = P @ x + c
        too_low, too_high = x < lower, x > upper
        pulls_up, pulls_down = below & (gradient < -largest), above & (gradient > largest)
        if not (too_low | too_high | pulls_up | pulls_down).any():
            return BoxSolution(x, below | above, True)
        below, above = (below & ~pulls_up) | too_low, (above & ~pulls_down) | too_high
    return None


def _solve(P: np.ndarray, b: np.ndarray) -> Float[np.ndarray, "n"]:
    _, x, info = dposv(P, b)
    if info != 0:
        raise BoxQPError("P is not positive definite; do the tasks determine every coordinate?")
    return np.asarray(x)
