"""The optimiser on problems with known answers: its steps, its boxes and the status it ends with."""

import itertools

import numpy as np
import pytest
from clocks import CountingClock
from quadratic_terms import Affine, Function, identity_state

from scopt import Constraint, Cost, Penalty, Problem, ProblemError, Sense, Settings, Status, TrustRegionSQP
from scopt.qp import BACKENDS, QPSolution, QPStatus

FREE = np.full((1, 2), 1e3)


def solve(costs, constraints, x0, lower=-FREE, upper=FREE, **settings):
    problem = Problem(lower, upper, tuple(costs), tuple(constraints), identity_state)
    options = {
        "trust_radius": 1.0,
        "min_improvement": 1e-10,
        "min_improvement_fraction": 0.0,
        "min_improvement_feasible": 0.0,
        "max_iterations": 400,
    }
    return TrustRegionSQP(Settings(**(options | settings))).solve(problem, np.atleast_2d(np.asarray(x0, dtype=float)))


@pytest.mark.parametrize("qp", ["piqp", "clarabel", "cvxpy"])
def test_separable_quadratic_program_reaches_its_minimum(qp):
    # minimise (x - 3)^2 + 2 (y + 1)^2 with x <= 2: x = 2, y = -1
    costs = [Cost("x", Affine([[1.0, 0.0]], 3.0)), Cost("y", Affine([[0.0, 1.0]], -1.0), weight=2.0)]
    result = solve(costs, [Constraint("limit", Affine([[1.0, 0.0]], 2.0))], [0.0, 0.0], qp=qp)
    assert result.status is Status.CONVERGED
    np.testing.assert_allclose(result.x, [[2.0, -1.0]], atol=1e-4)


def test_l1_costs_are_measured_and_minimised():
    # |x - 1| + |x + 1| + max(y, 0): any x in [-1, 1] costs 2, any y <= 0 costs nothing
    costs = [
        Cost("abs", Affine([[1.0, 0.0], [1.0, 0.0]], [1.0, -1.0]), penalty=Penalty.ABS),
        Cost("hinge", Affine([[0.0, 1.0]], 0.0), penalty=Penalty.HINGE),
    ]
    result = solve(costs, [], [4.0, 3.0])
    assert result.cost["abs"] == pytest.approx(2.0, abs=1e-4)
    assert result.cost["hinge"] == pytest.approx(0.0, abs=1e-4)


def test_hock_schittkowski_1_rosenbrock():
    f = Function(lambda x: [10 * (x[1] - x[0] ** 2), 1 - x[0]], lambda x: [[-20 * x[0], 10.0], [-1.0, 0.0]])
    result = solve([Cost("f", f)], [], [-2.0, 1.0], lower=np.array([[-1e3, -1.5]]))
    np.testing.assert_allclose(result.x, [[1.0, 1.0]], atol=1e-3)
    assert result.cost["f"] == pytest.approx(0.0, abs=1e-6)


def test_hock_schittkowski_3_ends_on_its_bound():
    costs = [
        Cost("linear", Affine([[0.0, 1.0]], 0.0), penalty=Penalty.ABS),  # y >= 0 makes |y| = y
        Cost("difference", Affine([[-1.0, 1.0]], 0.0), weight=1e-5),
    ]
    result = solve(costs, [], [10.0, 1.0], lower=np.array([[-1e3, 0.0]]), trust_radius=5.0)
    np.testing.assert_allclose(result.x, [[0.0, 0.0]], atol=1e-2)  # x1 is worth 1e-5 of its square
    assert sum(result.cost.values()) == pytest.approx(0.0, abs=1e-6)


def test_hock_schittkowski_6_on_a_parabola():
    constraint = Function(lambda x: 10 * (x[1] - x[0] ** 2), lambda x: [[-20 * x[0], 10.0]])
    result = solve(
        [Cost("f", Affine([[-1.0, 0.0]], -1.0))],
        [Constraint("parabola", constraint, Sense.EQUAL_ZERO)],
        [-1.2, 1.0],
    )
    assert result.is_feasible
    np.testing.assert_allclose(result.x, [[1.0, 1.0]], atol=2e-3)
    assert result.cost["f"] == pytest.approx(0.0, abs=1e-6)


def test_hock_schittkowski_7_finds_the_constrained_optimum():
    # min log(1 + x1^2) - x2 s.t. (1 + x1^2)^2 + x2^2 = 4; optimum (0, sqrt 3).  log1p(x^2) enters as a square.
    root = Function(
        lambda x: np.sqrt(np.log1p(x[0] ** 2)),
        lambda x: [[x[0] / ((1 + x[0] ** 2) * max(np.sqrt(np.log1p(x[0] ** 2)), 1e-9)), 0.0]],
    )
    costs = [Cost("log", root), Cost("down", Affine([[0.0, -1.0]], -10.0), penalty=Penalty.ABS)]
    circle = Function(
        lambda x: (1 + x[0] ** 2) ** 2 + x[1] ** 2 - 4, lambda x: [[4 * x[0] * (1 + x[0] ** 2), 2 * x[1]]]
    )
    result = solve(costs, [Constraint("circle", circle, Sense.EQUAL_ZERO)], [2.0, 2.0], lower=-FREE, upper=FREE / 1e2)
    assert result.is_feasible
    np.testing.assert_allclose(result.x, [[0.0, np.sqrt(3.0)]], atol=2e-3)
    assert sum(result.cost.values()) - 10.0 == pytest.approx(-np.sqrt(3.0), abs=1e-4)  # |x2 - 10| is 10 - x2


def test_contradicting_constraints_are_stalled_not_converged():
    constraints = [
        Constraint("at most -1", Affine([[1.0, 0.0]], -1.0)),
        Constraint("at least +1", Affine([[-1.0, 0.0]], -1.0)),
    ]
    result = solve([Cost("f", Affine([[1.0, 0.0]], 0.0))], constraints, [0.0, 0.0])
    assert result.status is Status.STALLED
    assert not result.is_feasible
    assert max(result.violation.values()) >= 1.0 - 1e-6
    assert "largest violation" in result.message


def test_cancelled_and_timed_out_solves_say_so_and_keep_their_iterate():
    problem = Problem(-FREE, FREE, (Cost("f", Affine([[1.0, 0.0]], 3.0)),), (), identity_state)
    seen = []
    result = TrustRegionSQP(Settings(trust_radius=0.1)).solve(
        problem, np.zeros((1, 2)), on_iteration=lambda i, x: seen.append((i, x)), should_stop=lambda: len(seen) >= 3
    )
    assert result.status is Status.CANCELLED
    assert len(result.history) == len(seen) == 3
    np.testing.assert_array_equal(result.x, seen[-1][1])
    timed = TrustRegionSQP(Settings(time_limit_s=5.5, trust_radius=0.1), CountingClock(1.0)).solve(
        problem, np.zeros((1, 2)), on_iteration=lambda i, x: seen.append((i, x))
    )
    assert timed.status is Status.TIME_LIMIT
    np.testing.assert_array_equal(timed.x, seen[-1][1])
    assert 0 < len(timed.history) <= 5


def test_merit_never_rises_while_the_penalty_stands():
    constraint = Function(lambda x: 10 * (x[1] - x[0] ** 2), lambda x: [[-20 * x[0], 10.0]])
    result = solve([Cost("f", Affine([[-1.0, 0.0]], -1.0))], [Constraint("c", constraint, Sense.EQUAL_ZERO)], [-1.2, 1])
    accepted = [i for i in result.history if i.is_accepted]
    assert len(accepted) >= 3
    for before, after in itertools.pairwise(accepted):
        if before.penalty == after.penalty:
            assert after.merit <= before.merit + 1e-12
    for step in result.history:
        assert step.model_merit < step.merit


def minimise_well(**settings):
    """Minimise an arctangent squared, whose linear model promises more than long steps bring."""
    well = Function(lambda x: 3.0 * np.arctan(2.0 * x[0]), lambda x: [[6.0 / (1.0 + 4.0 * x[0] ** 2), 0.0]])
    return solve([Cost("well", well), Cost("slope", Affine([[0.3, 0.0]], 0.0))], [], [1.3, 0.0], **settings)


def test_steps_are_taken_exactly_when_they_bring_a_quarter_of_what_the_model_promised():
    history = minimise_well(trust_radius=2.0).history
    brought = [(i.merit - i.trial_merit) / (i.merit - i.model_merit) for i in history]
    assert any(0.0 < ratio < 0.25 for ratio in brought), "the problem must try the rule"
    assert [i.is_accepted for i in history] == [ratio >= 0.25 for ratio in brought]


def test_the_box_follows_the_steps_that_were_taken_and_rejected():
    history = minimise_well(trust_radius=50.0).history
    rejected = [(i, j) for i, j in itertools.pairwise(history) if not i.is_accepted]
    accepted = [(i, j) for i, j in itertools.pairwise(history) if i.is_accepted]
    assert history[1].trust_radius < 0.3 * 50.0  # the first step went not nearly as far as the box
    for before, after in rejected:
        assert after.trust_radius <= 0.3 * before.trust_radius
    factors = {round(after.trust_radius / before.trust_radius, 9) for before, after in accepted}
    assert factors == {1.0, 1.5}


def test_a_box_that_has_shrunk_is_reopened_when_the_penalty_rises():
    # The first penalty is too weak against the cost; the bent constraint shrinks the box before it rises.
    costs = [Cost("pull", Affine([[1.0, 0.0], [0.0, 1.0]], [3.0, 0.0]), weight=30.0)]
    bent = Function(lambda x: np.abs(np.sin(9.0 * x[0])) + x[0], lambda x: [[9.0 * np.cos(9.0 * x[0]) + 1.0, 0.0]])
    result = solve(costs, [Constraint("bent", bent)], [2.0, 1.0], trust_radius=1.0, is_corrected=False)
    raises = [(i, j) for i, j in itertools.pairwise(result.history) if j.penalty > i.penalty]
    assert any(before.trust_radius < 0.05 for before, _ in raises), "the problem must try the rule"
    assert all(after.trust_radius >= 0.1 for _, after in raises)


def test_a_solve_ends_where_violations_are_acceptable():
    # x <= -1 and x >= 1 cannot both hold; off by 1 each is acceptable.
    constraints = [
        Constraint("low", Affine([[1.0, 0.0]], -1.0), acceptable=1.1),
        Constraint("high", Affine([[-1.0, 0.0]], -1.0), acceptable=1.1),
    ]
    result = solve([Cost("f", Affine([[0.0, 1.0]], 0.0))], constraints, [0.05, 50.0], acceptable_steps=2)
    assert result.status is Status.ACCEPTABLE
    assert len(result.history) == 2


def test_a_solve_without_progress_ends_where_patience_does():
    constraints = [Constraint("low", Affine([[1.0, 0.0]], -1.0)), Constraint("high", Affine([[-1.0, 0.0]], -1.0))]
    cost = Cost("f", Affine([[0.0, 1.0]], 0.0))
    result = solve([cost], constraints, [0.0, 50.0], patience=3)
    assert result.status is Status.STALLED
    assert len(result.history) == 4
    assert len(solve([cost], constraints, [0.0, 50.0]).history) > 4


def curved_constraint(**changes):
    """An arctangent to be zero: from 1.3 the first long step goes too far and is rejected."""
    curve = Function(lambda x: 3.0 * np.arctan(2.0 * x[0]), lambda x: [[6.0 / (1.0 + 4.0 * x[0] ** 2), 0.0]])
    return Constraint("curve", curve, Sense.EQUAL_ZERO, **changes)


def test_a_rejected_step_ends_a_solve_whose_violations_are_acceptable():
    result = solve([], [curved_constraint(acceptable=4.0)], [1.3, 0.0], trust_radius=50.0, is_corrected=False)
    assert result.status is Status.ACCEPTABLE
    assert [i.is_accepted for i in result.history] == [False]
    np.testing.assert_array_equal(result.x, [[1.3, 0.0]])


def test_patience_follows_the_iterate_and_not_rejected_steps():
    # 3.6 before both steps, 4.3 at the rejected one, 3.3 at the end: less than a tenth below 3.6.
    stuck = Constraint("stuck", Affine([[0.0, 0.0]], -3.3), tolerance=1.0)
    constraints = [curved_constraint(tolerance=1.0), stuck]
    result = solve([], constraints, [1.3, 0.0], trust_radius=50.0, is_corrected=False, patience=1)
    assert [i.is_accepted for i in result.history] == [False, True]
    assert result.status is Status.STALLED


def test_a_feasible_solve_ends_after_a_rejected_step_when_little_is_to_be_gained():
    well = Function(lambda x: 3.0 * np.arctan(2.0 * x[0]), lambda x: [[6.0 / (1.0 + 4.0 * x[0] ** 2), 0.0]])
    costs = [Cost("well", well), Cost("constant", Affine([[0.0, 0.0]], 16.0))]
    result = solve(costs, [], [1.3, 0.0], trust_radius=50.0, min_improvement_feasible=0.02)
    assert result.status is Status.CONVERGED
    assert [i.is_accepted for i in result.history] == [False]


def test_the_result_is_the_best_iterate_and_not_the_last_one_tried():
    result = minimise_well(trust_radius=50.0, max_iterations=1)
    assert result.history[0].trial_merit > result.history[0].merit
    np.testing.assert_array_equal(result.x, [[1.3, 0.0]])


def test_the_time_of_a_model_counts_for_its_first_trial_step():
    history = minimise_well(trust_radius=2.0).history
    assert [i.convexify_s > 0.0 for i in history] == [True, *(i.is_accepted for i in history[:-1])]


def test_the_iteration_limit_ends_a_solve():
    result = minimise_well(max_iterations=3)
    assert result.status is Status.ITERATION_LIMIT
    assert len(result.history) == 3


def test_a_solve_without_any_solved_subproblem_says_so(monkeypatch):
    def fail(program):
        return QPSolution(np.full(len(program.c), np.nan), QPStatus.FAILED)

    monkeypatch.setitem(BACKENDS, "piqp", fail)
    monkeypatch.setitem(BACKENDS, "clarabel", fail)
    result = solve([Cost("f", Affine([[1.0, 0.0]], 0.0))], [Constraint("c", Affine([[1.0, 0.0]], 0.0))], [1.0, 0.0])
    assert result.status is Status.SUBPROBLEM_FAILED
    assert not result.history


def test_default_settings_accept_a_quarter_of_the_promise_and_shrink_below_the_step():
    solver = TrustRegionSQP()
    assert not solver.trust_region.accept(promised=1.0, actual=0.2)
    assert solver.trust_region.step(1.0, 0.1, is_accepted=False) < 0.1


def test_bounds_that_fix_variables_are_kept_exactly():
    lower, upper = np.full((3, 2), -5.0), np.full((3, 2), 5.0)
    lower[0] = upper[0] = [1.0, 2.0]
    smooth = Affine(np.kron(np.array([[-1, 1, 0], [0, -1, 1]]), np.eye(2)), np.zeros(4))
    end = Affine(np.eye(6)[4:], [3.0, 4.0])
    problem = Problem(
        lower, upper, (Cost("smooth", smooth),), (Constraint("end", end, Sense.EQUAL_ZERO),), identity_state
    )
    result = TrustRegionSQP(Settings(min_improvement_feasible=0.0, min_improvement=1e-9)).solve(
        problem, np.zeros((3, 2))
    )
    np.testing.assert_array_equal(result.x[0], [1.0, 2.0])
    np.testing.assert_allclose(result.x[1:], [[2.0, 3.0], [3.0, 4.0]], atol=1e-3)


@pytest.mark.parametrize("qp", ["piqp", "clarabel", "cvxpy"])
def test_a_problem_without_a_free_variable_is_judged_not_solved(qp):
    # A goal that names every joint leaves nothing to choose; PIQP's multistage factorisation crashes on nothing.
    fixed = np.ones((1, 2))
    cost, wrong = Cost("x", Affine([[1.0, 0.0]], 3.0)), Constraint("limit", Affine([[1.0, 0.0]], 0.0))
    result = solve([cost], [], fixed, lower=fixed, upper=fixed, qp=qp)
    assert result.status is Status.CONVERGED
    assert not solve([cost], [wrong], fixed, lower=fixed, upper=fixed, qp=qp).is_feasible
    np.testing.assert_array_equal(result.x, fixed)


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        (np.zeros((2, 2)), np.zeros((3, 2)), "two \\(T, n\\) arrays"),
        (np.array([[np.nan]]), np.array([[1.0]]), "NaN"),
        (np.array([[0.0, 2.0]]), np.array([[0.0, 1.0]]), "waypoint 0, variable 1: 2 > 1"),
    ],
)
def test_ill_posed_bounds_are_refused(lower, upper, message):
    with pytest.raises(ProblemError, match=message):
        Problem(lower, upper, (), (), identity_state)


def test_a_start_with_nan_is_refused():
    problem = Problem(-FREE, FREE, (), (), identity_state)
    with pytest.raises(ProblemError, match="x0 must be finite"):
        TrustRegionSQP().solve(problem, np.array([[np.nan, 0.0]]))


def watch_programs(monkeypatch, fails):
    """Record for every program whether it has equalities; it is not solved where ``fails`` says so of its number."""
    back_end, has_equalities = BACKENDS["piqp"], []

    def solve_or_fail(program):
        has_equalities.append(program.E is not None)
        failed = QPSolution(np.full(len(program.c), np.nan), QPStatus.FAILED)
        return failed if fails(len(has_equalities), program) else back_end(program)

    monkeypatch.setitem(BACKENDS, "piqp", solve_or_fail)
    return has_equalities


@pytest.mark.parametrize("is_solved", [True, False])
def test_equalities_become_penalties_only_where_they_have_no_solution(monkeypatch, is_solved):
    # a smooth equation that is met at the start stays an equality: on x + y = 1, (y - 2)^2 is least at x = -1
    line = Function(lambda x: x.sum() - 1.0, lambda x: np.ones((1, 2)))
    costs, rows = [Cost("y", Affine([[0.0, 1.0]], 2.0))], [Constraint("line", line, Sense.EQUAL_ZERO)]
    has_equalities = watch_programs(monkeypatch, lambda _, program: program.E is not None and not is_solved)
    result = solve(costs, rows, [1.0, 0.0])
    np.testing.assert_allclose(result.x, [[-1.0, 2.0]], atol=1e-4)
    steps = len(has_equalities) if is_solved else len(has_equalities) // 2
    assert steps >= len(result.history) > 0
    assert has_equalities == ([True] if is_solved else [True, False]) * steps


def test_only_a_solve_that_stalls_on_a_failed_subproblem_blames_it(monkeypatch):
    rows = [Constraint("low", Affine([[1.0, 0.0]], 0.0)), Constraint("high", Affine([[-1.0, 0.0]], -1.0))]
    monkeypatch.setitem(BACKENDS, "clarabel", lambda program: QPSolution(program.c * np.nan, QPStatus.FAILED))
    # the first fails and the next ones do not: contradictory rows stall the solve
    watch_programs(monkeypatch, lambda number, _: number == 1)
    assert solve([], rows, [0.5, 3.0]).status is Status.STALLED
    monkeypatch.undo()
    # none is solved, and somebody ends the solve while it tries smaller boxes
    monkeypatch.setitem(BACKENDS, "clarabel", lambda program: QPSolution(program.c * np.nan, QPStatus.FAILED))
    numbers = watch_programs(monkeypatch, lambda *_: True)
    problem = Problem(-FREE, FREE, (), tuple(rows), identity_state)
    result = TrustRegionSQP().solve(problem, np.array([[0.5, 3.0]]), should_stop=lambda: len(numbers) == 2)
    assert result.status is Status.CANCELLED
