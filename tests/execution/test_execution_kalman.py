"""Steady-state Kalman filters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from service.errors import ExecutionError
from service.execution.sensing.estimator import make_pelvis_filter
from service.execution.sensing.kalman import make_steady_filter, solve_riccati


@given(seed=st.integers(0, 100_000))
def test_the_covariance_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    A, C = rng.normal(size=(n, n)), rng.normal(size=(m, n))
    root, sensor = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    Q, R = root @ root.T + 0.1 * np.eye(n), sensor @ sensor.T + 0.1 * np.eye(m)
    np.testing.assert_allclose(solve_riccati(A, C, Q, R), solve_discrete_are(A.T, C.T, Q, R), rtol=1e-6, atol=1e-6)


def test_the_gain_of_a_scalar_random_walk_is_the_golden_ratio():
    # P = P + 1 - P^2 / (P + 1) with Q = R = 1 gives P^2 = P + 1; K = P / (P + 1) = 1 / P.
    one = np.eye(1)
    kalman = make_steady_filter(one, np.zeros((1, 1)), one, one, one)
    assert kalman.gain[0, 0] == pytest.approx(2.0 / (1.0 + np.sqrt(5.0)), abs=1e-12)


def test_the_gain_is_the_one_that_the_full_filter_converges_to():
    period, spread = 1e-3, (0.5, 1e-3, 2e-2)
    kalman = make_pelvis_filter(period, *spread)
    A, C, B = kalman.A, kalman.C, kalman.B
    Q, R = spread[0] ** 2 * B @ B.T, np.diag([spread[1] ** 2, spread[2] ** 2])
    P = np.eye(2)
    for _ in range(5000):
        predicted = A @ P @ A.T + Q
        gain = predicted @ C.T @ np.linalg.inv(C @ predicted @ C.T + R)
        P = (np.eye(2) - gain @ C) @ predicted
    np.testing.assert_allclose(kalman.gain, gain, rtol=1e-6)


def test_the_error_on_a_random_walk_has_the_predicted_spread_and_is_below_that_of_the_sensor():
    period, spread = 1e-2, (2.0, 5e-3, 0.1)
    kalman = make_pelvis_filter(period, *spread)
    rng = np.random.default_rng(0)
    axes = 200
    truth, estimate, errors = np.zeros((2, axes)), np.zeros((2, axes)), []
    for step in range(600):
        measured_push = rng.normal(size=(1, axes))
        truth = kalman.A @ truth + kalman.B @ (measured_push + spread[0] * rng.normal(size=(1, axes)))
        z = truth + np.array([[spread[1]], [spread[2]]]) * rng.normal(size=(2, axes))
        estimate = kalman.step(estimate, measured_push, z)
        if step > 200:
            errors.append(estimate - truth)
    R = np.diag([spread[1] ** 2, spread[2] ** 2])
    P = solve_riccati(kalman.A, kalman.C, spread[0] ** 2 * kalman.B @ kalman.B.T, R)
    after = (np.eye(2) - kalman.gain @ kalman.C) @ P
    seen = np.std(np.concatenate(errors, axis=1), axis=1)
    np.testing.assert_allclose(seen, np.sqrt(np.diag(after)), rtol=0.05)
    assert seen[0] < 0.5 * spread[1]


def test_another_gain_estimates_worse():
    period, spread = 1e-2, (2.0, 5e-3, 0.1)
    kalman = make_pelvis_filter(period, *spread)
    A, C = kalman.A, kalman.C
    Q, R = spread[0] ** 2 * kalman.B @ kalman.B.T, np.diag([spread[1] ** 2, spread[2] ** 2])

    def spread_with(gain):
        P, keep = np.zeros((2, 2)), np.eye(2) - gain @ C
        for _ in range(5000):
            P = keep @ (A @ P @ A.T + Q) @ keep.T + gain @ R @ gain.T
        return np.trace(P / np.diag([1.0, 400.0]).max())

    best = spread_with(kalman.gain)
    for factor in (0.5, 0.8, 1.25):
        assert spread_with(factor * kalman.gain) > best


def test_a_growing_state_that_nothing_measures_has_no_gain():
    with pytest.raises(ExecutionError, match="does not converge"):
        solve_riccati(np.diag([2.0, 0.5]), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))
