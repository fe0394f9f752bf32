"""Bounds of polynomials, and the curves that trajectories of other planners make."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly
from small_robots import robot_of

from costs.curve import PolynomialCurve, differentiate, evaluate_polynomials
from costs.scene import Scene
from service.replay.exchange.interpolation import make_curve, make_even_law
from service.verify import Motion, VerifyError, verify
from service.verify.curves.bounds import Rates, position_range
from service.verify.curves.polynomials import bound_range, restrict
from service.verify.limits import measure_timed_peaks


def _points(seed: int, count: int = 5, n: int = 2) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.05, 0.8, count)), *(rng.normal(size=(count, n)) for _ in range(3))


@given(seed=st.integers(0, 10_000), kind=st.sampled_from(["cubic", "quintic"]))
def test_the_curve_is_scipys_polynomial_with_the_same_derivatives(seed: int, kind: str) -> None:
    s, q, v, a = _points(seed)
    curve = make_curve(s, q, v, a, kind)
    given_values = np.stack([q, v, a] if kind == "quintic" else [q, v], axis=1)
    reference = BPoly.from_derivatives(s, given_values)
    at = np.linspace(s[0], s[-1], 301)[:-1]
    for order in (0, 1, 2):
        np.testing.assert_allclose(curve(at, order), reference(at, nu=order), atol=1e-7 * 10.0**order)
    assert curve.measure_position_error() < 1e-12  # type: ignore[attr-defined]
    assert np.abs(curve.measure_slope_jumps()).max() < 1e-9  # type: ignore[attr-defined]


@given(seed=st.integers(0, 10_000), kind=st.sampled_from(["linear", "cubic", "quintic", "spline"]))
@settings(max_examples=40)
def test_bounds_hold_at_every_pose_and_are_close(seed: int, kind: str) -> None:
    s, q, v, a = _points(seed)
    curve = make_curve(s, q, v, a, kind)
    low, high = position_range(curve)
    peaks = measure_timed_peaks(curve, make_even_law(s))
    rates = Rates(curve, None)
    for k in range(len(s) - 1):
        u = np.linspace(0.0, s[k + 1] - s[k], 2001)[:, None]
        rows = curve.coefficients()[:, k][:, None]
        values = [evaluate_polynomials(differentiate(rows, order), u) for order in range(3)]
        scale = 1e-9 * (1.0 + np.abs(values[2]).max())
        assert np.all(low[k] <= values[0].min(axis=0) + scale)
        assert np.all(high[k] >= values[0].max(axis=0) - scale)
        np.testing.assert_allclose(high[k], values[0].max(axis=0), atol=1e-5 * (1.0 + np.abs(values[2]).max()))
        for peak, value in ((peaks.speed[k], values[1]), (peaks.acceleration[k], values[2])):
            largest = np.abs(value).max(axis=0)
            assert np.all(peak >= largest - scale)
            np.testing.assert_allclose(peak, largest, rtol=1e-4, atol=1e-3)
        ends = np.sort(np.random.default_rng(seed).uniform(s[k], s[k + 1], 2))
        over = rates.over(ends[:1], ends[1:])
        inside = (u[:, 0] + s[k] >= ends[0]) & (u[:, 0] + s[k] <= ends[1])
        if np.any(inside):
            assert np.all(over.speed[0] >= np.abs(values[1][inside]).max(axis=0) - scale)
            assert np.all(over.bend[0] >= np.abs(values[2][inside]).max(axis=0) - scale)


def test_a_polynomial_restricted_to_an_interval_is_the_same_polynomial() -> None:
    rows = np.random.default_rng(3).normal(size=(6, 2, 3))
    inside = restrict(rows, np.array([0.3, 0.1]), np.array([0.7, 0.4]))
    np.testing.assert_allclose(
        evaluate_polynomials(inside, np.full((2, 1), 0.2)),
        evaluate_polynomials(rows, np.array([[0.5], [0.3]])),
        atol=1e-12,
    )


def test_the_largest_value_of_a_known_quintic_is_found() -> None:
    rows = np.zeros((6, 1, 1))
    rows[[1, 5], 0, 0] = 5.0, -1.0  # 5 u - u^5 is 4 at u = 1
    low, high = bound_range(rows, np.array([1.5]))
    assert high[0, 0] == pytest.approx(4.0, abs=1e-8)
    assert high[0, 0] >= 4.0 - 1e-12
    assert low[0, 0] == pytest.approx(7.5 - 1.5**5, abs=1e-8)


def test_polynomials_that_do_not_meet_the_points_are_refused() -> None:
    import pinocchio as pin

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint0")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    s, q = np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [0.5]])
    good = make_curve(s, q, None, None, "spline")
    pieces = good.coefficients().copy()
    pieces[0, 1] += 1e-3
    lie = PolynomialCurve(s, q, good.tangents, pieces)
    with pytest.raises(VerifyError, match=r"miss the positions at its knots by 0\.001"):
        verify(Motion(robot_of(model, []), Scene(), lie, make_even_law(s)))
    uneven = make_even_law(s)
    uneven.speed[1] = 2.0
    with pytest.raises(VerifyError):
        verify(Motion(robot_of(model, []), Scene(), good, uneven))


def test_a_corner_is_named_with_its_joint_and_time() -> None:
    import pinocchio as pin

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint0")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    s, q = np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [0.5]])
    curve = make_curve(s, q, None, None, "linear")
    certificate = verify(Motion(robot_of(model, []), Scene(), curve, make_even_law(s)))
    jump = next(check for check in certificate.failed() if check.name == "limits.jump")
    assert (jump.value, jump.where.time_s, jump.where.names) == (1.5, 1.0, ("joint0",))
