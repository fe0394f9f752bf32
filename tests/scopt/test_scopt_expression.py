"""Terms written as CVXPY expressions: taken as they are, not linearised, and refused when they are not convex."""

import subprocess
import sys

import cvxpy
import numpy as np
import pytest
from quadratic_terms import Affine, Function, identity_state

from scopt import Constraint, ConvexExpression, Cost, Penalty, Problem, ProblemError, Sense, Settings, TrustRegionSQP
from scopt.multipliers import compute_multipliers

T, N = 4, 3
RNG = np.random.default_rng(7)
TARGET = RNG.normal(size=(T, N))
EXACT = {
    "trust_radius": 20.0,
    "min_improvement": 1e-9,
    "min_improvement_fraction": 0.0,
    "min_improvement_feasible": 0.0,
}


def solve(costs, constraints=(), bound=5.0, fixed=None, settings=None):
    lower, upper = np.full((T, N), -bound), np.full((T, N), bound)
    for waypoint, q in (fixed or {}).items():
        lower[waypoint] = upper[waypoint] = q
    problem = Problem(lower, upper, tuple(costs), tuple(constraints), identity_state)
    return TrustRegionSQP(Settings(**(EXACT | (settings or {})))).solve(problem, np.zeros((T, N)))


def near_target():
    return Cost("near", Affine(np.eye(T * N), TARGET.ravel()))


def reference(objective, constraints=lambda q: []):
    """What CVXPY makes of ``|q - TARGET|^2 + objective(q)`` over all waypoints."""
    q = cvxpy.Variable((T, N))
    wanted = cvxpy.sum_squares(q - TARGET) + objective(q)
    cvxpy.Problem(cvxpy.Minimize(wanted), [cvxpy.abs(q) <= 5.0, *constraints(q)]).solve(solver=cvxpy.CLARABEL)
    return q.value


EXPRESSIONS = {
    "linear cone": lambda q: cvxpy.norm1(q - 0.3),
    "second-order cone": lambda q: cvxpy.norm(q[:2] + 1.0),
    "quadratic form": lambda q: cvxpy.quad_form(q[:2] - 1.0, np.array([[2.0, 1.0], [1.0, 2.0]])),
    "exponential cone": lambda q: cvxpy.log_sum_exp(q) + cvxpy.exp(q[0] - 1.0) + 5.0,
    "power cone": lambda q: cvxpy.power(cvxpy.pos(q[0] + 2.0), 2.5),
    "semidefinite cone": lambda q: cvxpy.lambda_max(cvxpy.bmat([[q[0], q[1]], [q[1], q[2]]])) + 10.0,
    "equalities inside": lambda q: cvxpy.sum(cvxpy.huber(q, 0.2)),
    "entries": lambda q: cvxpy.square(q[1:] - 1.0),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_a_convex_problem_is_solved_in_one_step_as_cvxpy_solves_it(name):
    expression = EXPRESSIONS[name]
    result = solve([near_target(), Cost("own", ConvexExpression(N, expression), 0.7, Penalty.HINGE)])
    expected = reference(lambda q: 0.7 * sum(cvxpy.sum(expression(q[t])) for t in range(T)))
    np.testing.assert_allclose(result.x, expected, atol=2e-4)
    assert sum(step.is_accepted for step in result.history) == 1
    first = result.history[0]
    assert first.trial_merit == pytest.approx(first.model_merit, rel=1e-9)


def test_a_squared_expression_is_solved_as_cvxpy_solves_it():
    result = solve([near_target(), Cost("own", ConvexExpression(N, lambda q: cvxpy.norm(q - 1.0)), 0.5)])
    expected = reference(lambda q: 0.5 * cvxpy.sum_squares(q - 1.0))
    np.testing.assert_allclose(result.x, expected, atol=1e-4)
    assert result.cost["own"] == pytest.approx(0.5 * np.sum((result.x - 1.0) ** 2))


def test_a_convex_constraint_is_kept_at_its_waypoints_alone():
    disc = ConvexExpression(N, lambda q: cvxpy.norm(q) <= 0.5, waypoints=[1, -1])
    result = solve([near_target()], [Constraint("disc", disc)])
    expected = reference(lambda q: 0.0, lambda q: [cvxpy.norm(q[t]) <= 0.5 for t in (1, T - 1)])
    np.testing.assert_allclose(result.x, expected, atol=1e-4)
    np.testing.assert_allclose(result.x[[0, 2]], TARGET[[0, 2]], atol=1e-4)
    assert result.is_feasible
    assert result.violation["disc"] < 1e-4


def test_fixed_waypoints_and_bounds_are_kept():
    pinned = np.array([1.0, -0.5, 0.2])
    cost = Cost("own", ConvexExpression(N, lambda q: cvxpy.norm(q + 3.0)), 4.0, Penalty.HINGE)
    result = solve([near_target(), cost], bound=1.2, fixed={0: pinned})
    np.testing.assert_array_equal(result.x[0], pinned)
    q = cvxpy.Variable((T, N))
    total = cvxpy.sum_squares(q - TARGET) + 4.0 * sum(cvxpy.norm(q[t] + 3.0) for t in range(T))
    cvxpy.Problem(cvxpy.Minimize(total), [cvxpy.abs(q) <= 1.2, q[0] == pinned]).solve(solver=cvxpy.CLARABEL)
    np.testing.assert_allclose(result.x, q.value, atol=1e-4)


def test_an_expression_and_a_curved_constraint_are_solved_together():
    circle = Function(lambda x: x[:2] @ x[:2] - 1.0, lambda x: [[2 * x[0], 2 * x[1], *np.zeros(T * N - 2)]])
    box = Constraint("box", ConvexExpression(N, lambda q: cvxpy.norm_inf(q) <= 0.8))
    result = solve(
        [near_target()], [Constraint("circle", circle, Sense.EQUAL_ZERO), box], settings={"trust_radius": 0.5}
    )
    assert result.is_feasible, result.message
    assert np.linalg.norm(result.x[0, :2]) == pytest.approx(1.0, abs=1e-3)
    assert np.abs(result.x).max() <= 0.8 + 1e-4


def test_an_affine_expression_becomes_rows():
    limit = ConvexExpression(N, lambda q: q[:2] + 2.0 * q[2] <= 0.4, waypoints=[2])
    assert limit.is_affine
    rows = limit.linearize(TARGET)
    np.testing.assert_array_equal(rows.value, limit.value(TARGET))
    np.testing.assert_allclose(rows.value, TARGET[2, :2] + 2.0 * TARGET[2, 2] - 0.4)
    np.testing.assert_allclose(rows.jacobian.toarray()[:, 6:9], [[1.0, 0.0, 2.0], [0.0, 1.0, 2.0]], atol=1e-15)
    assert rows.jacobian.nnz == 4
    result = solve([near_target()], [Constraint("limit", limit)])
    expected = reference(lambda q: 0.0, lambda q: [q[2, :2] + 2.0 * q[2, 2] <= 0.4])
    np.testing.assert_allclose(result.x, expected, atol=1e-4)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (lambda q: cvxpy.sqrt(q[0]), "is concave by CVXPY"),
        (lambda q: q[0] * q[1], "is not convex"),
        (lambda q: cvxpy.norm(q) >= 1.0, "is concave"),
        (lambda q: cvxpy.norm(q - cvxpy.Variable(N, name="other")), "not of other"),
        (lambda q: cvxpy.norm(q - cvxpy.Parameter(N, name="given")), "not of given"),
        (lambda q: cvxpy.Constant(1.0), "does not depend on the waypoint"),
        (lambda q: 1.0, "got float"),
        (lambda q: q == 1.0, "got Equality"),
        (lambda q: q[0] * 1j, "is complex"),
    ],
)
def test_what_is_no_convex_expression_of_the_waypoint_is_refused(expression, message):
    with pytest.raises(ProblemError, match=message):
        ConvexExpression(N, expression)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"costs": [Cost("own", ConvexExpression(N + 1, cvxpy.norm1))]}, "'own' has 4 variables, a waypoint has 3"),
        ({"costs": [Cost("own", ConvexExpression(N, cvxpy.norm1, [4]))]}, "waypoint 4 .* outside the 4"),
        ({"costs": [Cost("own", ConvexExpression(N, lambda q: cvxpy.exp(q[0]) - 1.0))]}, "SQUARED of an expression"),
        (
            {"costs": [], "constraints": [Constraint("own", ConvexExpression(N, cvxpy.norm1), Sense.EQUAL_ZERO)]},
            "'own' requires a curved expression to be zero",
        ),
    ],
)
def test_terms_that_do_not_fit_their_problem_are_refused(terms, message):
    with pytest.raises(ProblemError, match=message):
        solve(**terms)


def test_an_expression_needs_a_state_with_an_iterate():
    problem = Problem(
        -np.ones((T, N)), np.ones((T, N)), (Cost("own", ConvexExpression(N, cvxpy.norm1)),), (), lambda x: "a state"
    )
    with pytest.raises(ProblemError, match="str has not"):
        TrustRegionSQP().solve(problem, np.zeros((T, N)))


def test_outside_its_domain_an_expression_has_no_value():
    barrier = ConvexExpression(N, lambda q: -cvxpy.log(q[0]), [0])
    assert not np.isfinite(barrier.value(-np.ones((T, N)))).any()
    with pytest.raises(ProblemError, match="'own' has no finite value at x0"):
        solve([Cost("own", barrier, penalty=Penalty.HINGE)])


def test_cvxpy_is_not_loaded_by_those_who_write_no_expression():
    code = (
        "import sys, numpy as np, scopt\n"
        "class R(scopt.Residual):\n"
        "    def value(self, state):\n"
        "        return state.ravel() - 1.0\n"
        "p = scopt.Problem(-np.ones((2, 2)), np.ones((2, 2)), (scopt.Cost('r', R()),), (), lambda x: x)\n"
        "assert scopt.TrustRegionSQP().solve(p, np.zeros((2, 2))).history\n"
        "sys.exit('cvxpy' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_expression_that_holds_an_iterate_has_its_multiplier():
    # |q - TARGET|^2 with |q_1| <= 0.5: at the minimum the multiplier balances the cost's slope
    disc = Constraint("disc", ConvexExpression(N, lambda q: cvxpy.norm(q) - 0.5, waypoints=[1]))
    cost = near_target()
    problem = Problem(np.full((T, N), -5.0), np.full((T, N), 5.0), (cost,), (disc,), identity_state)
    x = solve([cost], [disc]).x
    found = compute_multipliers(problem, x, mu=10.0)
    expected = 2.0 * np.linalg.norm(TARGET[1] - x[1])
    np.testing.assert_allclose(found.constraints["disc"], [expected], rtol=1e-3)


def test_the_linearisation_of_a_curved_expression_at_its_kink_is_a_subgradient():
    rows = ConvexExpression(N, cvxpy.norm1, [1]).linearize(np.zeros((T, N)))
    assert np.abs(rows.jacobian.toarray()).max() <= 1.0
