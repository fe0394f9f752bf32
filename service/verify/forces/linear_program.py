"""Small linear programs that are solved many times over."""

from __future__ import annotations

import highspy
import numpy as np
from jaxtyping import Float

_MISSED = 1e-6  # by which rows may miss their bounds, relative to the largest finite one
_OPTIONS = (
    ("output_flag", False),
    ("threads", 1),
    ("presolve", "off"),
    ("solver", "simplex"),
    ("simplex_strategy", 1),  # dual: the last prices stay feasible while only the rows' bounds change
    ("primal_feasibility_tolerance", 1e-9),
    ("dual_feasibility_tolerance", 1e-9),
)


class LinearProgram:
    """Least ``cost . x`` for ``low <= rows x <= high`` and ``0 <= x <= most``, from one ``low, high`` to the next.

    Each is solved from the basis of the one before.
    """

    def __init__(
        self,
        cost: Float[np.ndarray, "n"],
        rows: Float[np.ndarray, "m n"],
        most: Float[np.ndarray, "n"] | float = np.inf,
    ) -> None:
        count, n_rows = len(cost), len(rows)
        self._rows = np.array(rows)
        program = highspy.HighsLp()
        program.num_col_, program.num_row_ = count, n_rows
        program.col_cost_ = np.asarray(cost, dtype=float)
        program.col_lower_, program.col_upper_ = np.zeros(count), np.broadcast_to(np.asarray(most, float), count).copy()
        program.row_lower_, program.row_upper_ = np.full(n_rows, -highspy.kHighsInf), np.full(n_rows, highspy.kHighsInf)
        matrix = program.a_matrix_
        matrix.format_ = highspy.MatrixFormat.kColwise
        matrix.start_ = n_rows * np.arange(count + 1, dtype=np.int32)
        matrix.index_ = np.tile(np.arange(n_rows, dtype=np.int32), count)
        matrix.value_ = self._rows.T.ravel()
        self._solver = highspy.Highs()
        for name, value in _OPTIONS:
            self._solver.setOptionValue(name, value)
        self._solver.passModel(program)

    def change_column(self, column: int, values: Float[np.ndarray, "m"]) -> None:
        """Give a variable other coefficients."""
        self._rows[:, column] = values
        for row, value in enumerate(values.tolist()):
            self._solver.changeCoeff(row, column, value)

    def solve(
        self, low: Float[np.ndarray, "m"], high: Float[np.ndarray, "m"] | None = None
    ) -> Float[np.ndarray, "n"] | None:
        """Return x; None where no x is within the bounds.  Without ``high`` rows are equal to ``low``."""
        high = low if high is None else high
        solver = self._solver
        for row, ends in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
            solver.changeRowBounds(row, *ends)
        finite = np.abs(np.concatenate([low, high]))
        allowed = _MISSED * max(1.0, float(finite[np.isfinite(finite)].max(initial=0.0)))
        for _ in range(2):
            if solver.run() == highspy.HighsStatus.kError:
                solver.setOptionValue("threads", 0)  # a process has one pool of threads: take it as it is
                solver.run()
            status = solver.getModelStatus()
            if status == highspy.HighsModelStatus.kOptimal:
                x = np.maximum(np.array(solver.getSolution().col_value), 0.0)
                made = self._rows @ x
                if max(float((low - made).max(initial=0.0)), float((made - high).max(initial=0.0))) <= allowed:
                    return np.asarray(x)
            if status == highspy.HighsModelStatus.kInfeasible:
                return None
            solver.clearSolver()  # a start from the last basis may be at fault
        return None
