"""Low-pass filter and PID control of single signals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from service.errors import ExecutionError
from service.execution.sensing.filters import PidGains, PidState, find_share, low_pass, step_pid


def run_pid(gains, errors, period=0.01):
    state, outputs = PidState.zero(), []
    for error in errors:
        output, state = step_pid(gains, state, np.asarray(error), period)
        outputs.append(float(output))
    return np.array(outputs), state


def test_step_response_of_the_low_pass_is_one_minus_a_power_of_its_share():
    y, outputs = np.zeros(()), []
    for _ in range(6):
        y = low_pass(y, np.ones(()), 0.75)
        outputs.append(float(y))
    np.testing.assert_allclose(outputs, 1.0 - 0.75 ** np.arange(1, 7), atol=1e-15)


def test_low_pass_is_the_filter_of_its_difference_equation():
    x = np.random.default_rng(0).normal(size=(50, 3))
    y, outputs = np.zeros(3), []
    for sample in x:
        y = low_pass(y, sample, 0.6)
        outputs.append(y)
    np.testing.assert_allclose(outputs, lfilter([0.4], [1.0, -0.6], x, axis=0), atol=1e-12)


def test_low_pass_starts_at_its_first_sample():
    assert low_pass(None, np.array([3.0]), 0.99) == [3.0]


def test_low_pass_reaches_63_percent_of_a_step_after_its_time_constant():
    cutoff, period = 5.0, 1e-4
    steps = round(1.0 / (2.0 * np.pi * cutoff) / period)
    y = np.zeros(())
    for _ in range(steps):
        y = low_pass(y, np.ones(()), find_share(cutoff, period))
    assert float(y) == pytest.approx(1.0 - np.exp(-1.0), abs=2e-3)


def test_low_pass_halves_the_power_at_its_cutoff():
    cutoff, period = 5.0, 1e-4
    time = np.arange(0.0, 2.0, period)
    share = find_share(cutoff, period)
    y = lfilter([1.0 - share], [1.0, -share], np.sin(2.0 * np.pi * cutoff * time))
    assert np.abs(y[len(y) // 2 :]).max() == pytest.approx(np.sqrt(0.5), rel=1e-2)


@pytest.mark.parametrize(("cutoff", "period"), [(0.0, 1e-3), (10.0, 0.0), (np.nan, 1e-3)])
def test_a_cutoff_or_period_that_is_not_positive_is_refused(cutoff, period):
    with pytest.raises(ExecutionError, match="expected positive numbers"):
        find_share(cutoff, period)


def test_a_proportional_control_multiplies_the_error():
    outputs, _ = run_pid(PidGains(kp=3.0), [1.0, -2.0, 0.5])
    np.testing.assert_allclose(outputs, [3.0, -6.0, 1.5], atol=1e-15)


def test_the_integral_of_a_constant_error_grows_linearly():
    outputs, _ = run_pid(PidGains(kp=0.0, ki=2.0), np.ones(5), period=0.1)
    np.testing.assert_allclose(outputs, 0.2 * np.arange(1, 6), atol=1e-15)


def test_the_filtered_derivative_of_a_ramp_rises_to_its_slope():
    period, cutoff = 0.01, 10.0
    outputs, _ = run_pid(PidGains(kp=0.0, kd=1.0, cutoff_hz=cutoff), 3.0 * period * np.arange(60), period)
    share = find_share(cutoff, period)
    np.testing.assert_allclose(outputs, 3.0 * (1.0 - share ** np.arange(60)), atol=1e-12)


def test_the_first_error_gives_no_derivative_kick():
    outputs, _ = run_pid(PidGains(kp=0.0, kd=1.0), [5.0, 5.0])
    np.testing.assert_array_equal(outputs, [0.0, 0.0])


def test_noise_in_the_error_is_damped_in_the_derivative():
    noise = 1e-3 * np.random.default_rng(1).choice([-1.0, 1.0], size=400)
    plain = np.abs(np.diff(noise) / 0.01).std()
    outputs, _ = run_pid(PidGains(kp=0.0, kd=1.0, cutoff_hz=1.0), noise)
    assert outputs.std() < 0.2 * plain


def test_the_integral_does_not_wind_up_while_the_output_is_at_its_limit():
    gains = PidGains(kp=1.0, ki=10.0, limit=2.0)
    held, state = run_pid(gains, 5.0 * np.ones(300))
    np.testing.assert_array_equal(held, 2.0)
    assert state.integral == 0.0
    output, _ = step_pid(gains, state, np.asarray(-0.1), 0.01)
    assert float(output) < 0.0  # with an integral of 150 the output would stay at its limit for a long time


def test_an_integral_at_the_limit_may_shrink():
    gains = PidGains(kp=0.0, ki=1.0, limit=0.05)
    _, state = run_pid(gains, np.ones(100))
    assert float(state.integral) == pytest.approx(0.05, abs=0.011)
    _, after = step_pid(gains, state, np.asarray(-1.0), 0.01)
    assert float(after.integral) < float(state.integral)


def test_a_loop_with_an_integral_has_no_steady_error_under_a_constant_load():
    gains = PidGains(kp=4.0, ki=3.0, kd=0.3, limit=50.0)
    position, speed, state = 0.0, 0.0, PidState.zero()
    for _ in range(6000):
        force, state = step_pid(gains, state, np.asarray(1.0 - position), 2e-3)
        speed += 2e-3 * (float(force) - 2.0 - 3.0 * speed)  # a load of 2 N
        position += 2e-3 * speed
    assert position == pytest.approx(1.0, abs=1e-3)


def test_negative_gains_are_refused():
    with pytest.raises(ExecutionError, match="kp -1"):
        PidGains(kp=-1.0)
