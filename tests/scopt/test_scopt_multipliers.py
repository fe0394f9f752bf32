"""Multipliers at an iterate: known by hand, and the sensitivity of the optimum to what the rows ask for."""

import cvxpy
import numpy as np
import pytest
from quadratic_terms import Affine, Function, identity_state

from scopt import Constraint, Cost, Problem, Sense, Settings, SolverError, TrustRegionSQP
from scopt.multipliers import compute_multipliers

FREE = np.full((1, 2), 1e3)


def problem_of(costs, constraints, lower=-FREE, upper=FREE):
    return Problem(lower, upper, tuple(costs), tuple(constraints), identity_state)


def test_a_parabola_leaning_on_a_row_and_on_a_bound_is_held_by_its_slope():
    # (x - 3)^2 at x <= 1 has the slope -4, 2 (y + 1)^2 at y >= 0.5 the slope 6
    costs = [Cost("x", Affine([[1.0, 0.0]], 3.0)), Cost("y", Affine([[0.0, 1.0]], -1.0), weight=2.0)]
    at_most_one = Constraint("x at most 1", Affine([[1.0, 0.0]], 1.0))
    problem = problem_of(costs, [at_most_one], lower=np.array([[-1e3, 0.5]]))
    result = compute_multipliers(problem, np.array([[1.0, 0.5]]), mu=100.0)
    assert result.constraints["x at most 1"] == pytest.approx([4.0], abs=1e-5)
    np.testing.assert_allclose(result.lower, [[0.0, 6.0]], atol=1e-5)
    np.testing.assert_allclose(result.upper, 0.0, atol=1e-5)
    assert result.rows["x at most 1"].value == pytest.approx([0.0])


def test_a_row_that_cannot_be_kept_has_all_its_weight_and_the_sign_says_which_way_it_is_off():
    # x = 2 against x <= 1: held at x = 1 from both sides, the equation's row is negative there
    equation = Constraint("x is 2", Affine([[1.0, 0.0]], 2.0), Sense.EQUAL_ZERO, scale=0.5)
    bounded = problem_of([], [equation], upper=np.array([[1.0, 1e3]]))
    result = compute_multipliers(bounded, np.array([[1.0, 0.0]]), mu=10.0)
    assert result.constraints["x is 2"] == pytest.approx([-5.0], abs=1e-5)
    np.testing.assert_allclose(result.upper, [[5.0, 0.0]], atol=1e-5)


def test_without_costs_two_rows_that_exclude_each_other_share_their_weight_and_the_third_has_none():
    rows = [
        Constraint("at least 1", Affine([[-1.0, 0.0]], -1.0)),
        Constraint("at most 0", Affine([[1.0, 0.0]], 0.0)),
        Constraint("far", Affine([[0.0, 1.0]], 5.0)),
    ]
    result = compute_multipliers(problem_of([], rows), np.array([[0.5, 0.0]]), mu=1.0)
    assert result.constraints["at least 1"] == pytest.approx([1.0], abs=1e-5)
    assert result.constraints["at most 0"] == pytest.approx([1.0], abs=1e-5)
    assert result.constraints["far"] == pytest.approx([0.0], abs=1e-5)


def test_a_bound_beyond_the_box_does_not_count():
    cost = Cost("far", Affine([[1.0, 0.0]], 9.0))
    problem = problem_of([cost], [], upper=np.array([[1.0, 1e3]]))
    for x, is_held in ((1.0, True), (0.5, False)):
        result = compute_multipliers(problem, np.array([[x, 0.0]]), mu=1.0, radius=0.1)
        assert bool(result.upper[0, 0] > 1.0) is is_held


def test_a_fixed_variable_has_no_multiplier():
    fixed = np.array([[1.0, 0.0]])
    held = Constraint("x at most 0", Affine([[1.0, 0.0]], 0.0))
    result = compute_multipliers(problem_of([], [held], lower=fixed, upper=fixed), fixed, mu=1.0)
    assert not result.upper.any()
    assert not result.lower.any()
    assert result.rows["x at most 0"].value == pytest.approx([1.0])


@pytest.mark.parametrize("seed", range(4))
def test_a_multiplier_is_how_fast_the_optimal_merit_grows_with_its_row(seed):
    rng = np.random.default_rng(seed)
    n, penalty, step = 4, 3.0, 1e-4
    A, b, C, d = rng.normal(size=(3, n)), rng.normal(size=3), rng.normal(size=(3, n)), rng.normal(size=3)
    goal = rng.normal(size=n)
    x, shift = cvxpy.Variable(n), cvxpy.Parameter(6)
    l1 = cvxpy.sum(cvxpy.pos(A @ x - b + shift[:3])) + cvxpy.sum(cvxpy.abs(C @ x - d + shift[3:]))
    reference = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(x - goal) + penalty * l1), [x >= -2.0, x <= 2.0])

    def merit(rows):
        shift.value = rows
        return reference.solve(solver=cvxpy.CLARABEL)

    merit(np.zeros(6))
    best = np.clip(x.value, -2.0, 2.0)[None]
    constraints = [Constraint("hinge", Affine(A, b)), Constraint("equal", Affine(C, d), Sense.EQUAL_ZERO)]
    bounds = np.full((1, n), 2.0)
    problem = problem_of([Cost("goal", Affine(np.eye(n), goal))], constraints, -bounds, bounds)
    result = compute_multipliers(problem, best, penalty)
    slopes = [(merit(row) - merit(-row)) / (2 * step) for row in step * np.eye(6)]
    joined = np.concatenate([result.constraints["hinge"], result.constraints["equal"]])
    np.testing.assert_allclose(joined, slopes, atol=5e-3)


def test_where_the_violation_is_least_the_forces_of_the_rows_are_in_balance():
    # inside the disc of radius 1 and beyond the line x + y = 2 at once; least in all on the disc's edge, where the
    # line's gradient (-1, -1) meets 1 / sqrt 2 of the disc's (sqrt 2, sqrt 2)
    disc = Function(lambda x: x @ x - 1.0, lambda x: 2.0 * x[None])
    problem = problem_of([], [Constraint("disc", disc), Constraint("line", Affine([[-1.0, -1.0]], -2.0))])
    visited = []
    TrustRegionSQP(Settings(min_improvement=1e-9, min_improvement_fraction=0.0)).solve(
        problem, np.array([[2.0, 0.3]]), on_iteration=lambda record, x: visited.append(x)
    )
    np.testing.assert_allclose(visited[-1], np.full((1, 2), np.sqrt(0.5)), atol=1e-3)
    result = compute_multipliers(problem, visited[-1], mu=1.0, radius=1e-2)
    assert result.constraints["line"] == pytest.approx([1.0], abs=1e-4)
    assert result.constraints["disc"] == pytest.approx([np.sqrt(0.5)], abs=5e-3)


@pytest.mark.parametrize("name", ["clarabel", "cvxpy"])
def test_back_ends_that_hand_multipliers_over_agree(name):
    rng = np.random.default_rng(5)
    rows = [Constraint("rows", Affine(rng.normal(size=(4, 3)), rng.normal(size=4)))]
    problem = problem_of(
        [Cost("goal", Affine(np.eye(3), rng.normal(size=3)))], rows, np.full((1, 3), -1), np.ones((1, 3))
    )
    x = np.array([[0.3, -0.2, 1.0]])
    reference = compute_multipliers(problem, x, 2.0, radius=0.5)
    result = compute_multipliers(problem, x, 2.0, radius=0.5, qp=name)
    np.testing.assert_allclose(result.constraints["rows"], reference.constraints["rows"], atol=1e-5)
    np.testing.assert_allclose(result.upper, reference.upper, atol=1e-5)


def test_a_back_end_without_multipliers_is_refused():
    problem = problem_of([Cost("x", Affine([[1.0, 0.0]], 3.0))], [])
    with pytest.raises(SolverError, match="QP back end 'piqp' gave no multipliers"):
        compute_multipliers(problem, np.zeros((1, 2)), 1.0, qp="piqp")


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("apart", "is_bound"), [(0.0, True), (0.25, True), (0.5, True), (0.75, False)])
def test_a_bound_counts_up_to_the_side_of_the_box(side, apart, is_bound):
    # (x - 9)^2, or its mirror image, pushes towards the bound; beyond a box of 0.5 the box holds x instead
    cost = Cost("far", Affine([[1.0, 0.0]], 9.0 * side))
    bounds = {"upper": np.array([[1.0, 1e3]])} if side > 0.0 else {"lower": np.array([[-1.0, -1e3]])}
    x = np.array([[side * (1.0 - apart), 0.0]])
    result = compute_multipliers(problem_of([cost], [], **bounds), x, mu=1.0, radius=0.5)
    towards, away = (result.upper, result.lower) if side > 0.0 else (result.lower, result.upper)
    # the slope of the cost where x is held: 2 (9 - 1)
    assert towards[0, 0] == pytest.approx(16.0 if is_bound else 0.0, abs=1e-4)
    np.testing.assert_allclose(away, 0.0, atol=1e-4)
