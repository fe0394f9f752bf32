"""Quadratic programs in a box."""

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.execution.box_qp import BoxQPError, solve_box_qp


def random_program(seed, n=36):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(n + 10, n)) * 10.0 ** rng.uniform(-1, 1.5, size=(n + 10, 1))
    centre, size = rng.normal(size=n), rng.uniform(0.01, 1.0, n) * 10.0 ** rng.uniform(-2, 1)
    lower, upper = centre - size, centre + size
    free = rng.random(n) < 0.2
    return rows.T @ rows + 5e-3 * np.eye(n), rng.normal(size=n) * 50.0, np.where(free, -np.inf, lower), upper


@pytest.mark.parametrize("seed", range(12))
def test_the_solution_agrees_with_cvxpy(seed):
    P, c, lower, upper = random_program(seed)
    x = cp.Variable(len(c))
    bounded = np.isfinite(lower)
    problem = cp.Problem(
        cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(P)) + c @ x), [x[bounded] >= lower[bounded], x <= upper]
    )
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    own = solve_box_qp(P, c, lower, upper).x
    assert 0.5 * own @ P @ own + c @ own <= problem.value + 1e-8 * (1.0 + abs(problem.value))
    np.testing.assert_allclose(own, x.value, atol=1e-5 * (1.0 + np.abs(own).max()))


@given(seed=st.integers(0, 100_000))
def test_the_solution_is_in_the_box_and_no_coordinate_alone_improves_it(seed):
    P, c, lower, upper = random_program(seed)
    solution = solve_box_qp(P, c, lower, upper)
    x, gradient = solution.x, P @ solution.x + c
    assert np.all(lower <= x)
    assert np.all(x <= upper)
    slack = (1e-7 if solution.is_polished else 1e-4) * np.abs(c).max()
    assert np.all(gradient[x < upper] >= -slack)
    assert np.all(gradient[x > lower] <= slack)
    assert np.all(((x == lower) | (x == upper))[solution.is_bound])


def test_nearly_all_solutions_are_exact():
    assert np.mean([solve_box_qp(*random_program(seed)).is_polished for seed in range(200)]) > 0.95


def test_without_active_bounds_the_solution_is_that_of_the_linear_system():
    P, c, _, _ = random_program(0)
    wide = solve_box_qp(P, c, np.full(36, -1e9), np.full(36, 1e9))
    np.testing.assert_allclose(P @ wide.x, -c, atol=1e-8)
    assert wide.is_polished
    assert not wide.is_bound.any()


def test_a_point_box_has_its_point_as_solution():
    P, c, _, _ = random_program(3)
    point = np.linspace(-1.0, 1.0, 36)
    np.testing.assert_array_equal(solve_box_qp(P, c, point, point).x, point)


@pytest.mark.parametrize("bad", [np.nan, 2.0])
def test_an_empty_box_is_refused_with_its_index(bad):
    lower = np.zeros(3)
    lower[1] = bad
    with pytest.raises(BoxQPError, match=r"lower\[1\]"):
        solve_box_qp(np.eye(3), np.zeros(3), lower, np.ones(3))


def test_a_singular_matrix_is_refused():
    with pytest.raises(BoxQPError, match="not positive definite"):
        solve_box_qp(np.diag([1.0, 0.0]), np.ones(2), -np.ones(2), np.ones(2))


def test_a_linear_term_that_is_not_finite_is_refused():
    with pytest.raises(BoxQPError):
        solve_box_qp(np.eye(2), np.array([np.nan, 0.0]), -np.ones(2), np.ones(2))
