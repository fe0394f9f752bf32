"""The rule of termination: why a solve ends early, and which promises of the model are too small."""

from dataclasses import replace

import numpy as np
import pytest

from scopt import Status
from scopt.iterate import Iterate
from scopt.termination import Termination

INFINITY = float("inf")
RULE = Termination(
    min_improvement=1e-4,
    min_improvement_fraction=1e-3,
    min_improvement_feasible=0.02,
    acceptable_steps=2,
    patience=INFINITY,
    max_iterations=5,
    time_limit_s=10.0,
)


def iterate(excess, is_acceptable=False):
    """An iterate of which only the violations matter."""
    x = np.zeros((1, 1))
    return Iterate(x, x, {}, {}, 0.0, 0.0, excess, is_acceptable)


FEASIBLE, INFEASIBLE, ACCEPTABLE = iterate(1.0, True), iterate(1.1), iterate(1.1, True)


def decide(rule, *iterates, elapsed_s=0.0, is_cancelled=False):
    """The decision after trial steps that led to these iterates; before the first one if there is only one."""
    progress = rule.init()
    for trial in iterates[1:]:
        progress = rule.step(progress, trial)
    return rule.terminate(progress, iterates[-1], elapsed_s, is_cancelled=is_cancelled)


def test_a_solve_goes_on_before_the_first_trial_step():
    for start in (FEASIBLE, INFEASIBLE, ACCEPTABLE):
        assert decide(RULE, start) is None


def test_cancelling_comes_before_the_time_limit_and_both_before_all_else():
    steps = [ACCEPTABLE] * 9
    assert decide(RULE, *steps, elapsed_s=11.0, is_cancelled=True) is Status.CANCELLED
    assert decide(RULE, *steps, elapsed_s=11.0) is Status.TIME_LIMIT
    assert decide(RULE, *steps, elapsed_s=10.0) is Status.ACCEPTABLE


def test_the_iteration_limit_counts_trial_steps():
    assert decide(RULE, *[INFEASIBLE] * 5) is None  # the start and four steps
    assert decide(RULE, *[INFEASIBLE] * 6) is Status.ITERATION_LIMIT
    assert decide(replace(RULE, max_iterations=0), INFEASIBLE) is Status.ITERATION_LIMIT


def test_acceptable_iterates_end_a_solve_only_in_a_row():
    assert decide(RULE, INFEASIBLE, ACCEPTABLE) is None
    assert decide(RULE, INFEASIBLE, ACCEPTABLE, INFEASIBLE, ACCEPTABLE) is None
    assert decide(RULE, INFEASIBLE, ACCEPTABLE, FEASIBLE, ACCEPTABLE) is None
    assert decide(RULE, INFEASIBLE, ACCEPTABLE, ACCEPTABLE) is Status.ACCEPTABLE


def test_feasible_iterates_are_not_counted_as_acceptable():
    assert decide(RULE, FEASIBLE, FEASIBLE, FEASIBLE, FEASIBLE) is None


def test_patience_ends_a_solve_whose_violation_fell_by_less_than_a_tenth():
    rule = replace(RULE, patience=2.0)

    def after(*excesses):
        return decide(rule, INFEASIBLE, *map(iterate, excesses))

    assert after(20.0, 20.0) is None  # too few steps to tell
    assert after(20.0, 19.0, 18.1) is Status.STALLED
    assert after(20.0, 19.0, 18.0) is None
    assert after(90.0, 20.0, 19.0, 18.1) is Status.STALLED  # compared with two steps ago, not with the first
    assert after(10.0, 10.0, 1.0) is None
    assert after(1.0, 1.0, 1.0) is None  # feasible iterates need not improve


def test_without_patience_a_solve_may_stand_still():
    assert decide(replace(RULE, max_iterations=50), *[INFEASIBLE] * 40) is None


@pytest.mark.parametrize(
    ("promised", "merit", "place", "is_negligible"),
    [
        (0.99e-4, 0.0, INFEASIBLE, True),  # absolute limit
        (1.01e-4, 0.0, INFEASIBLE, False),
        (0.99e-3, 1.0, INFEASIBLE, True),  # fraction of the merit
        (1.01e-3, 1.0, INFEASIBLE, False),
        (1.01e-3, -1.0, INFEASIBLE, False),
        (0.99e-3, -1.0, INFEASIBLE, True),
        (0.0199, 1.0, FEASIBLE, True),  # a larger one once feasible
        (0.0201, 1.0, FEASIBLE, False),
    ],
)
def test_the_middle_loop_ends_when_the_model_promises_too_little(promised, merit, place, is_negligible):
    assert RULE.is_negligible(promised, merit, place) is is_negligible


def test_after_a_rejected_step_a_small_gain_is_searched_for_only_while_infeasible():
    assert RULE.is_not_worth_searching(0.099, 1.0, FEASIBLE)
    assert not RULE.is_not_worth_searching(0.101, 1.0, FEASIBLE)
    assert not RULE.is_not_worth_searching(0.001, 1.0, INFEASIBLE)


def test_a_rejected_step_ends_a_solve_whose_violations_are_acceptable():
    assert RULE.terminate_rejected(ACCEPTABLE) is Status.ACCEPTABLE
    assert RULE.terminate_rejected(FEASIBLE) is None
    assert RULE.terminate_rejected(INFEASIBLE) is None
