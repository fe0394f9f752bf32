"""Small linear programs, solved one after the other, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from service.verify import LinearProgram


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_programs_in_a_row_have_the_least_costs_that_each_has_by_another_solver(seed: int) -> None:
    """Equalities and upper bounds; some have no solution, and a column changes on the way."""
    rng = np.random.default_rng(seed)
    n, n_equal, n_bound = 8, 3, 4
    rows, cost = rng.normal(size=(n_equal + n_bound, n)), rng.uniform(0.1, 1.0, n)
    most = np.where(rng.uniform(size=n) < 0.5, 1.0, np.inf)
    program = LinearProgram(cost, rows, most)
    for number in range(6):
        if number == 3:
            rows[:, 2] = rng.normal(size=len(rows))
            program.change_column(2, rows[:, 2])
        wanted, bounds = 0.5 * rng.normal(size=n_equal), rng.uniform(-0.2, 1.0, n_bound)
        x = program.solve(np.append(wanted, np.full(n_bound, -np.inf)), np.append(wanted, bounds))
        limits = [(0.0, None if np.isinf(upper) else upper) for upper in most]
        known = linprog(cost, rows[n_equal:], bounds, rows[:n_equal], wanted, limits, method="highs")
        assert (x is None) == (known.x is None)
        if x is not None:
            np.testing.assert_allclose(rows[:n_equal] @ x, wanted, atol=1e-6)
            assert np.all(rows[n_equal:] @ x <= bounds + 1e-6)
            assert cost @ x == pytest.approx(known.fun, abs=1e-6)
