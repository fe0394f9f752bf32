"""The rule of the penalty: its growth, and how the outer loop ends."""

from scopt import Status
from scopt.penalty_schedule import PenaltySchedule

RULE = PenaltySchedule(first=10.0, factor=3.0, max_raises=2)


def test_the_penalty_starts_at_its_first_value_and_grows_by_its_factor():
    level = RULE.init()
    assert (level.mu, level.n_raises) == (10.0, 0)
    level = RULE.step(RULE.step(level))
    assert (level.mu, level.n_raises) == (90.0, 2)


def test_a_feasible_iterate_ends_the_outer_loop_as_converged_at_any_level():
    for level in (RULE.init(), RULE.step(RULE.step(RULE.init()))):
        assert RULE.terminate(level, is_feasible=True) is Status.CONVERGED


def test_an_infeasible_iterate_ends_it_as_stalled_only_when_no_raise_is_left():
    level = RULE.init()
    for _ in range(RULE.max_raises):
        assert RULE.terminate(level, is_feasible=False) is None
        level = RULE.step(level)
    assert RULE.terminate(level, is_feasible=False) is Status.STALLED


def test_without_raises_the_first_level_is_the_last():
    rule = PenaltySchedule(10.0, 3.0, max_raises=0)
    assert rule.terminate(rule.init(), is_feasible=False) is Status.STALLED
