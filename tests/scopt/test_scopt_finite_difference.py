"""Derivatives by finite differences: right where the function is smooth, told where it is not."""

import warnings

import numpy as np
import pytest
from jacobian import check_jacobian
from quadratic_terms import identity_state

from scopt import (
    AffineRows,
    Cost,
    DerivativeError,
    DerivativeWarning,
    Problem,
    ProblemError,
    Residual,
    Settings,
    TrustRegionSQP,
    check_derivative,
)
from scopt.finite_difference import differentiate, group_waypoints

X = np.random.default_rng(3).normal(size=(6, 3))


class Counting:
    """A function that counts how often it was asked."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, x):
        self.calls += 1
        return self.function(x)


class OfFunction(Residual[np.ndarray]):
    """A residual of which only the value is written."""

    def __init__(self, function):
        self.function = function

    def value(self, state):
        return self.function(state)


SMOOTH = {
    "each waypoint": (lambda x: np.sin(x[:, 0] * x[:, 1]) + x[:, 2] ** 2, 1),
    "several rows a waypoint": (lambda x: np.exp(x).ravel(), 1),
    "velocities": (lambda x: (np.diff(x, axis=0) ** 2).ravel(), 2),
    "accelerations": (lambda x: np.diff(x, n=2, axis=0).ravel(), 3),
    "one waypoint": (lambda x: x[-1, :2] ** 3, 1),
    "the whole trajectory": (lambda x: np.array([np.sum(x**2), np.prod(x[:, 0])]), 6),
    "constants": (lambda x: np.ones(4), 0),
    "no rows": (lambda x: np.zeros(0), 0),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_functions_are_differentiated_with_few_values(name):
    function, n_groups = SMOOTH[name]
    if name not in ("constants", "no rows"):
        check_jacobian(OfFunction(function), identity_state, X)
    counting = Counting(function)
    rows = differentiate(counting, X, name)
    assert rows.jacobian.shape == (len(function(X)), X.size)
    assert counting.calls <= 3 + 2 * len(X) + 2 * 3 * n_groups


def test_a_flat_spot_and_strong_curvature_are_no_kinks():
    flat = differentiate(lambda x: 1e4 * (x[:, 0] - X[2, 0]) ** 2, X, "parabola")
    assert abs(flat.jacobian[2, 6]) < 1e-6
    differentiate(lambda x: np.cos(x).ravel(), np.zeros((4, 2)), "cosine")


@pytest.mark.parametrize(
    "function",
    [
        lambda x: np.abs(x[:, 0] - X[2, 0]),
        lambda x: np.maximum(x[:, 0] - X[2, 0], 0.0),
        lambda x: np.minimum(x[:, 0] - X[2, 0], 0.0),
    ],
    ids=["abs", "max", "min"],
)
def test_a_kink_is_told_with_its_row_waypoint_and_variable(function):
    with pytest.warns(DerivativeWarning, match=r"row 2 of 'fold' along waypoint 2, variable 0 ") as caught:
        differentiate(function, X, "fold")
    warning = caught[0].message
    assert (warning.term, warning.row, warning.waypoint, warning.variable) == ("fold", 2, 2, 0)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x[:, 0].astype(np.float32).astype(float),
        lambda x: x[:, 0] + 1e-7 * np.random.default_rng(x.view(np.uint64).ravel()).normal(size=len(x)),
        lambda x: np.round(x[:, 0], 5),
    ],
    ids=["single precision", "noise", "an inner iteration of five digits"],
)
def test_a_slope_that_depends_on_the_step_is_told(function):
    with pytest.warns(DerivativeWarning, match="of 'rough' along waypoint"):
        differentiate(function, X, "rough")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: np.where(np.arange(6) == 3, np.nan, x[:, 0]), "row 3 of 'term' is nan at the iterate"),
        (lambda x: np.where(x > X, np.inf, x)[:, 1], "row 0 of 'term' is inf beside the iterate at waypoint 0"),
        (
            lambda x: np.where((x[:, 1] != X[:, 1]) & (x[:, 0] == X[:, 0]), np.inf, x.sum(axis=1)),
            "row 0 of 'term' is inf beside the iterate at waypoint 0, variable 1",
        ),
        (lambda x: x[x[:, 0] > X[3, 0], 1], "rows come and go"),
        (lambda x: x, r"must be a vector \(m,\), got shape \(6, 3\)"),
    ],
)
def test_what_cannot_be_differentiated_is_refused_with_the_place(function, message):
    with pytest.raises(DerivativeError, match=message):
        differentiate(function, X, "term")


def test_a_state_that_cannot_be_moved_is_refused():
    with pytest.raises(DerivativeError, match=r"OfFunction.*str has not"):
        OfFunction(lambda state: np.zeros(1)).linearize("a state")


def test_waypoints_are_grouped_so_that_no_row_sees_two():
    rng = np.random.default_rng(0)
    for _ in range(50):
        touched = rng.random((8, 7)) < 0.2
        groups = group_waypoints(touched)
        moved = np.concatenate([group.waypoints for group in groups]) if groups else np.zeros(0, dtype=int)
        assert set(np.flatnonzero(touched.any(axis=0))) <= set(moved)
        for group in groups:
            assert touched[:, group.waypoints].sum(axis=1).max() <= 1
            for row, owner in enumerate(group.owner):
                assert owner == -1 if not touched[row, group.waypoints].any() else touched[row, owner]


def problem_of(cost):
    return Problem(np.full((4, 2), -5.0), np.full((4, 2), 5.0), (cost,), (), identity_state)


def test_the_optimiser_minimises_a_residual_of_which_only_the_value_is_written():
    target = np.array([1.0, -2.0])
    cost = Cost("near", OfFunction(lambda x: (np.sinh(x) - np.sinh(target)).ravel()))
    settings = Settings(trust_radius=1.0, min_improvement=1e-12, min_improvement_feasible=0.0)
    result = TrustRegionSQP(settings).solve(problem_of(cost), np.zeros((4, 2)))
    np.testing.assert_allclose(result.x, np.tile(target, (4, 1)), atol=1e-5)


def test_messages_of_a_solve_speak_of_the_term_by_its_name():
    fold = Cost("my fold", OfFunction(lambda x: np.abs(x[:, 0])))
    with pytest.warns(DerivativeWarning, match="'my fold'"):
        TrustRegionSQP(Settings(max_iterations=1)).solve(problem_of(fold), np.zeros((4, 2)))


def test_a_start_where_a_term_has_no_value_is_refused():
    root = Cost("root", OfFunction(lambda x: np.sqrt(x[:, 0])))
    with np.errstate(invalid="ignore"), pytest.raises(ProblemError, match="'root' has no finite value at x0"):
        TrustRegionSQP().solve(problem_of(root), np.full((4, 2), -1.0))


def test_a_step_into_where_a_term_has_no_value_is_not_taken():
    # log(x) = 0 from x = 4: the first full steps of Newton's method lead to x < 0
    log = Cost("log", OfFunction(lambda x: np.log(x[:, 0])))
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        settings = Settings(trust_radius=10.0, min_improvement=1e-12, min_improvement_feasible=0.0)
        result = TrustRegionSQP(settings).solve(problem_of(log), np.full((4, 2), 4.0))
    assert any(not np.isfinite(step.trial_merit) for step in result.history)
    np.testing.assert_allclose(result.x[:, 0], 1.0, atol=1e-4)


class Product(Residual[np.ndarray]):
    """Product of the first two variables, its derivative spoilt at will."""

    def __init__(self, spoil=lambda blocks: blocks, offset=0.0):
        self.spoil, self.offset = spoil, offset

    def value(self, state):
        return state[:, 0] * state[:, 1]

    def linearize(self, state):
        blocks = np.zeros((len(state), 1, 3))
        blocks[:, 0, 0], blocks[:, 0, 1] = state[:, 1], state[:, 0]
        rows = np.arange(len(state))
        return AffineRows.from_blocks(self.value(state) + self.offset, rows, self.spoil(blocks), len(state))


def test_a_right_derivative_passes_its_check():
    check = check_derivative(Product(), identity_state, X)
    assert check.is_right
    assert check.error < 1e-8
    assert "agree" in str(check)


def test_a_wrong_derivative_is_named_by_row_waypoint_and_variable():
    def spoil(blocks):
        blocks[4, 0, 2] += 0.5
        blocks[1, 0, 0] += 0.1
        return blocks

    check = check_derivative(Product(spoil), identity_state, X)
    assert not check.is_right
    assert (check.row, check.waypoint, check.variable, check.given) == (4, 4, 2, 0.5)
    assert abs(check.measured) < 1e-9
    assert "row 4 along waypoint 4, variable 2 is 0.5" in str(check)


@pytest.mark.parametrize(
    ("residual", "message"),
    [
        (Product(offset=0.5), "row 0 of 'Product' is"),
        (Product(lambda blocks: blocks[:, :, :2]), r"must have shape \(6, 18\).*got \(6, 12\)"),
    ],
)
def test_rows_that_contradict_their_value_or_shape_are_refused(residual, message):
    with pytest.raises(DerivativeError, match=message):
        check_derivative(residual, identity_state, X)
