"""Quadratic programs in a box, for a few dozen variables and a thousand solutions per second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg.lapack import dposv

TOLERANCE = 1e-9  # of the gradient, relative to the largest entry of the linear term (or to 1)
MAX_ITERATIONS = 100
DECREASE, SHRINK, SMALLEST_STEP = 0.1, 0.5, 1e-12


class BoxQPError(ValueError):
    """Error for a program without a solution: an empty box, or a matrix that is not positive definite."""


@dataclass(frozen=True)
class BoxSolution:
    """Minimiser of a quadratic function in a box.

    Attributes:
        x: (n,) the minimiser.
        is_bound: (n,) whether a variable is at its bound and pushes against it.
        iterations: number of factorisations.
    """

    x: Float[np.ndarray, "n"]
    is_bound: Bool[np.ndarray, "n"]
    iterations: int


def solve_box_qp(
    P: Float[np.ndarray, "n n"],
    c: Float[np.ndarray, "n"],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    x0: Float[np.ndarray, "n"] | None = None,
) -> BoxSolution:
    """Minimise ``1/2 x' P x + c' x`` subject to ``lower <= x <= upper``.

    The unbounded minimiser is tried first; it is the answer in most control cycles.  Otherwise projected Newton steps:
    variables that push against their bound are held, the others take a Newton step whose projection decreases the
    function (Bertsekas 1982; Tassa et al., ICRA 2014, II.B).  The active set settles after finitely many steps.

    Args:
        P: symmetric and positive definite.
        c: linear term.
        lower, upper: bounds; infinite where there is none.
        x0: start, for instance the solution of the cycle before; clipped to the box.

    Raises:
        BoxQPError: the box is empty, P is not positive definite, or the steps do not converge.
    """
    if not np.all(lower <= upper):
        worst = int(np.argmax(np.where(np.isnan(lower - upper), np.inf, lower - upper)))
        raise BoxQPError(f"lower[{worst}] {lower[worst]:g} is above upper[{worst}] {upper[worst]:g}")
    free = _solve(P, -c)
    if np.all(lower <= free) and np.all(free <= upper):
        return BoxSolution(free, np.zeros(len(c), dtype=bool), 1)
    x = np.clip(free if x0 is None else x0, lower, upper)
    largest = TOLERANCE * max(1.0, float(np.abs(c).max()))
    for iteration in range(2, MAX_ITERATIONS):
        gradient = P @ x + c
        is_bound = ((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0))
        moves = np.flatnonzero(~is_bound)
        if not len(moves) or np.abs(gradient[moves]).max() <= largest:
            return BoxSolution(x, is_bound, iteration - 1)
        step = np.zeros_like(x)
        step[moves] = _solve(P[np.ix_(moves, moves)], -gradient[moves])
        x = _search_line(P, c, (lower, upper), x, gradient, step)
    raise BoxQPError(f"no solution after {MAX_ITERATIONS} steps; is P positive definite and well scaled?")


def _search_line(
    P: np.ndarray,
    c: np.ndarray,
    box: tuple[np.ndarray, np.ndarray],
    x: np.ndarray,
    gradient: np.ndarray,
    step: np.ndarray,
) -> Float[np.ndarray, "n"]:
    """Return the first point on the projected step that decreases the function enough."""
    length = 1.0
    while length > SMALLEST_STEP:
        trial = np.clip(x + length * step, *box)
        change = trial - x
        if change @ (gradient + 0.5 * (P @ change)) <= DECREASE * (gradient @ change):
            return np.asarray(trial)
        length *= SHRINK
    return np.asarray(trial)


def _solve(P: np.ndarray, b: np.ndarray) -> Float[np.ndarray, "n"]:
    _, x, info = dposv(P, b)
    if info != 0:
        raise BoxQPError("P is not positive definite; do the tasks determine every coordinate?")
    return np.asarray(x)
