"""The second-order correction of steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from quadratic_terms import Affine, Function, identity_state

from scopt import Constraint, Cost, Problem, Sense, Settings, TrustRegionSQP
from scopt.convex_model import convexify
from scopt.correction import Correction

WIDE = np.full((3, 2), 1e3)


def circles(radius=1.0, sense=Sense.EQUAL_ZERO, **changes):
    """Three waypoints on (or in) a circle about zero."""
    here = Function(lambda x: (x.reshape(3, 2) ** 2).sum(axis=1) - radius**2, _slopes)
    bounds = {"lower": -WIDE, "upper": WIDE} | changes
    return Problem(
        costs=(Cost("still", Affine(np.eye(6), np.zeros(6))),),
        constraints=(Constraint("circle", here, sense),),
        state=identity_state,
        **bounds,
    )


def _slopes(x):
    out = np.zeros((3, 6))
    for t in range(3):
        out[t, 2 * t : 2 * t + 2] = 2 * x[2 * t : 2 * t + 2]
    return out


def correction(problem, x):
    return Correction.of(problem, x, convexify(problem, problem.state(x), 10.0))


ON_CIRCLE = np.array([[1.0, 0.0], [0.0, 1.0], [np.sqrt(0.5), np.sqrt(0.5)]])


@given(st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6))
def test_a_corrected_step_ends_where_the_linear_model_said(steps):
    dx = np.array(steps)
    bend = correction(circles(), ON_CIRCLE)
    promised = _slopes(ON_CIRCLE.ravel()) @ dx

    def error(step):
        x = ON_CIRCLE + step.reshape(3, 2)
        return np.abs((x**2).sum(axis=1) - 1.0 - promised).max()

    bent = bend(dx)
    if not np.array_equal(bent, dx):
        assert error(bent) <= 0.25 * error(dx)


def test_the_correction_is_the_least_in_the_metric_of_mobility():
    # A tangential step leaves the circle by dy^2; only what may move brings it back.
    dx = np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    bent = correction(circles(), ON_CIRCLE)(dx)
    assert bent[0] == pytest.approx(-0.005, abs=1e-4)
    assert bent[1] == pytest.approx(0.1, abs=1e-12)
    held = correction(circles(mobility=np.array([0.0, 1.0])), ON_CIRCLE)(dx)
    np.testing.assert_array_equal(held[0], 0.0)


def test_fixed_waypoints_stay():
    lower, upper = -WIDE.copy(), WIDE.copy()
    lower[0] = upper[0] = ON_CIRCLE[0]
    bent = correction(circles(lower=lower, upper=upper), ON_CIRCLE)(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    np.testing.assert_array_equal(bent[:2], 0.0)
    assert bent[3] < 0.0


def test_inequalities_are_corrected_where_they_are_broken_only():
    # In a large circle nothing is broken; on the edge of a small one a tangential step is.
    dx = np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(correction(circles(2.0, Sense.AT_MOST_ZERO), ON_CIRCLE)(dx), dx)
    assert correction(circles(1.0, Sense.AT_MOST_ZERO), ON_CIRCLE)(dx)[0] < -0.004


def test_a_step_with_no_small_correction_is_left_alone():
    dx = np.array([-1.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(correction(circles(), ON_CIRCLE)(dx), dx)


def test_residuals_that_are_not_smooth_are_not_measured():
    class Rough(Function):
        is_smooth = False

    rough = Constraint("rough", Rough(lambda x: [x[0]], lambda x: [[1.0] + [0.0] * 5]))
    problem = Problem(-WIDE, WIDE, (), (rough,), identity_state)
    assert correction(problem, ON_CIRCLE) is None


def test_the_state_of_smooth_residuals_is_used_where_there_is_one():
    asked = []

    def smooth_state(x):
        asked.append(x.copy())
        return x

    problem = circles(smooth_state=smooth_state)
    correction(problem, ON_CIRCLE)(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    assert asked


def test_it_saves_steps_on_a_curved_constraint():
    # Hock and Schittkowski 6
    parabola = Function(lambda x: 10 * (x[1] - x[0] ** 2), lambda x: [[-20 * x[0], 10.0]])
    problem = Problem(
        np.full((1, 2), -10.0),
        np.full((1, 2), 10.0),
        (Cost("f", Affine([[-1.0, 0.0]], -1.0)),),
        (Constraint("parabola", parabola, Sense.EQUAL_ZERO),),
        identity_state,
    )
    steps = []
    for is_corrected in (True, False):
        settings = Settings(is_corrected=is_corrected, trust_radius=1.0, max_iterations=400)
        steps.append(len(TrustRegionSQP(settings).solve(problem, np.array([[-1.2, 1.0]])).history))
    assert steps[0] < steps[1]
