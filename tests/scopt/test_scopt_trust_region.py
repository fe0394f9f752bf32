"""The rule of the trust region: which steps are taken, and how the box changes."""

import math

import pytest

from scopt.trust_region import TrustRegion

RULE = TrustRegion(first_radius=2.0, min_radius=0.01, accept_ratio=0.25, shrink=0.3, expand=1.5)


def test_the_first_box_has_the_first_radius():
    assert RULE.init() == 2.0


@pytest.mark.parametrize(("actual", "is_accepted"), [(1.0, True), (0.25, True), (0.249, False), (0.0, False)])
def test_a_step_is_taken_when_it_brings_a_quarter_of_what_the_model_promised(actual, is_accepted):
    assert RULE.accept(promised=1.0, actual=actual) is is_accepted


def test_a_step_to_where_the_merit_rises_or_has_no_value_is_not_taken():
    assert not RULE.accept(promised=1.0, actual=-1e-9)
    assert not RULE.accept(promised=1.0, actual=math.nan)


def test_the_box_grows_only_when_the_accepted_step_filled_it():
    assert RULE.step(1.0, travel=1.0, is_accepted=True) == 1.5
    assert RULE.step(1.0, travel=0.91, is_accepted=True) == 1.5
    assert RULE.step(1.0, travel=0.9, is_accepted=True) == 1.0
    assert RULE.step(1.0, travel=0.1, is_accepted=True) == 1.0


def test_the_box_shrinks_below_the_rejected_step():
    assert RULE.step(1.0, travel=1.0, is_accepted=False) == 0.3
    assert RULE.step(1.0, travel=0.1, is_accepted=False) == pytest.approx(0.03)
    assert RULE.step(1.0, travel=1.0 + 1e-9, is_accepted=False) == 0.3  # a clipped step may exceed by rounding


def test_a_shrunken_box_is_reopened_to_a_tenth_of_the_first_radius_and_a_wide_one_stays():
    assert RULE.reopen(1e-3) == 0.2
    assert RULE.reopen(0.5) == 0.5


def test_a_box_below_the_least_radius_is_not_searched():
    assert RULE.terminate(0.0099)
    assert not RULE.terminate(0.01)
