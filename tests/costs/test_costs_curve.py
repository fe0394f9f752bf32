"""The executed curve and its time law."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.curve import Curve, TimeLaw


def random_curve(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 7))
    knots = np.cumsum(rng.uniform(0.1, 2.0, count))
    return Curve(knots, rng.normal(size=(count, 3)), rng.normal(size=(count, 3)))


@given(seed=st.integers(0, 10_000))
def test_curve_passes_through_its_knots_with_their_tangents(seed):
    curve = random_curve(seed)
    np.testing.assert_allclose(curve(curve.knots), curve.positions, atol=1e-12)
    np.testing.assert_allclose(curve(curve.knots, order=1), curve.tangents, atol=1e-10)


@given(seed=st.integers(0, 10_000))
def test_curve_and_its_first_derivative_are_continuous_at_knots(seed):
    curve = random_curve(seed)
    inner, eps = curve.knots[1:-1], 1e-9
    for order in (0, 1):
        np.testing.assert_allclose(curve(inner - eps, order), curve(inner + eps, order), atol=1e-5)


@given(seed=st.integers(0, 10_000))
def test_derivatives_agree_with_differences(seed):
    curve = random_curve(seed)
    step = 1e-5
    inside = np.concatenate(
        [np.linspace(a, b, 7)[1:-1] for a, b in zip(curve.knots[:-1], curve.knots[1:], strict=True)]
    )
    for order in (0, 1):
        difference = (curve(inside + step, order) - curve(inside - step, order)) / (2.0 * step)
        np.testing.assert_allclose(curve(inside, order + 1), difference, rtol=1e-4, atol=1e-4)


def test_a_cubic_is_reproduced_exactly():
    s = np.array([0.0, 0.5, 2.0])
    curve = Curve(s, (s**3 - 2.0 * s)[:, None], (3.0 * s**2 - 2.0)[:, None])
    at = np.linspace(0.0, 2.0, 31)
    np.testing.assert_allclose(curve(at)[:, 0], at**3 - 2.0 * at, atol=1e-12)
    np.testing.assert_allclose(curve(at, 2)[:, 0], 6.0 * at, atol=1e-10)


def test_outside_its_knots_the_curve_stays_at_its_ends():
    curve = random_curve(0)
    np.testing.assert_array_equal(curve(np.array([-9.0]))[0], curve.positions[0])
    np.testing.assert_allclose(curve(np.array([99.0]))[0], curve.positions[-1], atol=1e-12)


@pytest.mark.parametrize(
    ("knots", "tangents", "message"),
    [
        (np.array([0.0, 0.0]), np.zeros((2, 1)), "strictly increasing"),
        (np.array([0.0]), np.zeros((1, 1)), "at least two knots"),
        (np.array([0.0, 1.0]), np.zeros((3, 1)), "same length"),
    ],
)
def test_ill_posed_curves_are_refused(knots, tangents, message):
    with pytest.raises(ValueError, match=message):
        Curve(knots, np.zeros((len(knots), 1)), tangents)


def test_knots_of_a_stretch_are_found_in_spite_of_rounding():
    curve = random_curve(3)
    n = len(curve.knots)
    for first in range(n):
        for last in range(first, n):
            off = 1e-12
            assert curve.find_knots(curve.knots[first] + off, curve.knots[last] - off) == slice(first, last + 1)
    between = 0.5 * (curve.knots[0] + curve.knots[1])
    assert curve.find_knots(between, curve.knots[-1]) == slice(1, n)


def test_an_unknown_order_is_refused():
    with pytest.raises(ValueError, match="order must be 0, 1 or 2, got 3"):
        random_curve(0)(np.array([0.5]), order=3)


def test_time_law_by_hand():
    # one second of acceleration 2, two seconds at speed 2, one second of braking: s = 0, 1, 5, 6
    law = TimeLaw(np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 1.0, 5.0, 6.0]), np.array([0.0, 2.0, 2.0, 0.0]))
    path, speed, acceleration = law.at(np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.5, 4.0, 9.0]))
    np.testing.assert_allclose(path, [0.0, 0.0, 0.25, 1.0, 3.0, 5.75, 6.0, 6.0])
    np.testing.assert_allclose(speed, [0.0, 0.0, 1.0, 2.0, 2.0, 1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(acceleration, [2.0, 2.0, 2.0, 0.0, 0.0, -2.0, -2.0, -2.0])


def test_a_part_of_a_curve_is_the_curve_there():
    curve = random_curve(3)
    part = curve.cut(slice(1, len(curve.knots) - 1))
    s = np.linspace(part.knots[0], part.knots[-1], 40)
    np.testing.assert_allclose(part(s), curve(s))
    np.testing.assert_allclose(part(s, 1), curve(s, 1))


def test_a_part_of_a_law_from_rest_to_rest_takes_as_long_as_in_the_whole():
    path, speed = np.array([0.0, 1.0, 2.0, 4.0, 5.0]), np.array([0.0, 1.0, 0.0, 2.0, 0.0])
    law = TimeLaw.accelerated(path, speed)
    part = law.cut(2.0, 5.0)
    np.testing.assert_allclose(part.times, law.times[2:] - law.times[2])
    np.testing.assert_allclose(part.at(part.times)[0], [2.0, 4.0, 5.0])
    assert law.cut(1.0, 5.0) is None  # it moves there
    assert law.cut(0.0, 4.5) is None  # no point of its grid
    assert law.cut(2.0, 6.0) is None
