"""The measurements of an iterate: costs, violations, and which of them count as feasible or acceptable."""

import numpy as np
import pytest
from quadratic_terms import Affine, Function, identity_state

from scopt import Constraint, Cost, Problem, ProblemError, Sense
from scopt.iterate import measure, measure_start

WIDE = np.full((1, 2), 10.0)


def at_most(name, column, tolerance=1e-2, **changes):
    """One of the two variables is at most zero."""
    return Constraint(name, Affine(np.eye(2)[column], 0.0), tolerance=tolerance, **changes)


def iterate_at(x, *constraints, costs=()):
    return measure(Problem(-WIDE, WIDE, tuple(costs), constraints, identity_state), np.array([x], dtype=float))


def test_feasible_ends_exactly_at_the_tolerance():
    assert iterate_at([0.01, 0.0], at_most("a", 0)).is_feasible
    assert not iterate_at([0.0101, 0.0], at_most("a", 0)).is_feasible
    assert not iterate_at([0.05, 0.0], at_most("a", 0)).is_feasible
    assert not iterate_at([-0.0101, 0.0], at_most("a", 0, sense=Sense.EQUAL_ZERO)).is_feasible


def test_the_excess_is_the_largest_of_all_constraints_relative_to_their_tolerances():
    first, last = at_most("a", 0), at_most("b", 1, tolerance=1.0)
    assert iterate_at([0.03, 0.5], first, last).excess == pytest.approx(3.0)
    assert iterate_at([0.03, 0.5], last, first).excess == pytest.approx(3.0)


@pytest.mark.parametrize("order", [1, -1])
def test_every_constraint_must_be_acceptable_whatever_their_order(order):
    constraints = (at_most("a", 0, acceptable=0.1), at_most("b", 1, acceptable=0.2))[::order]
    assert iterate_at([0.09, 0.19], *constraints).is_acceptable
    assert not iterate_at([0.11, 0.0], *constraints).is_acceptable
    assert not iterate_at([0.0, 0.21], *constraints).is_acceptable


def test_the_tolerance_is_acceptable_where_nothing_larger_is_given():
    assert iterate_at([0.01, 0.0], at_most("a", 0)).is_acceptable
    assert not iterate_at([0.02, 0.0], at_most("a", 0)).is_acceptable


def test_acceptable_only_excludes_feasible_iterates():
    constraint = at_most("a", 0, acceptable=0.1)
    assert iterate_at([0.05, 0.0], constraint).is_acceptable_only
    assert not iterate_at([0.005, 0.0], constraint).is_acceptable_only
    assert not iterate_at([0.5, 0.0], constraint).is_acceptable_only


def test_the_merit_weighs_scaled_violations_with_the_penalty():
    cost = Cost("c", Affine([[1.0, 0.0]], 0.0), weight=3.0)
    here = iterate_at([2.0, 1.0], at_most("a", 0, scale=0.5), at_most("b", 1), costs=[cost])
    assert here.cost == {"c": 12.0}
    assert here.violation == {"a": 2.0, "b": 1.0}
    assert here.merit(10.0) == 12.0 + 10.0 * (0.5 * 2.0 + 1.0)


def test_the_better_iterate_is_the_cheaper_of_two_feasible_ones_else_the_less_violated():
    cost = Cost("c", Affine([[0.0, 1.0]], 0.0))
    cheap, dear = (iterate_at([0.0, y], at_most("a", 0), costs=[cost]) for y in (1.0, 2.0))
    near, far = (iterate_at([x, 0.0], at_most("a", 0), costs=[cost]) for x in (1.0, 2.0))
    assert cheap.is_better_than(dear)
    assert not dear.is_better_than(cheap)
    assert dear.is_better_than(near)
    assert near.is_better_than(far)
    assert not near.is_better_than(dear)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_where_a_term_has_no_finite_value_the_iterate_is_never_feasible(value):
    nowhere = Function(lambda x: value, lambda x: [[0.0, 0.0]])
    for here in (
        iterate_at([0.0, 0.0], Constraint("a", nowhere)),
        iterate_at([0.0, 0.0], costs=[Cost("a", nowhere)]),
    ):
        assert here.excess == np.inf
        assert not here.is_feasible
    with pytest.raises(ProblemError, match="'a' has no finite value at x0"):
        measure_start(Problem(-WIDE, WIDE, (), (Constraint("a", nowhere),), identity_state), np.zeros((1, 2)))


def test_an_iterate_is_clipped_into_the_bounds():
    np.testing.assert_array_equal(iterate_at([11.0, -30.0]).x, [[10.0, -10.0]])
