"""Filters of single signals: low-pass, and PID with a filtered derivative and anti-windup.

Each step is a function of the earlier state and the new sample; signals are arrays of any shape, element by element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.errors import ExecutionError


def low_pass(previous: np.ndarray | None, sample: np.ndarray, share: float) -> np.ndarray:
    """Return ``y_k = (1 - a) x_k + a y_(k-1)``, with ``a = share`` (Franklin 2016, 2.1.2.2).

    Args:
        previous: output of the step before; None for the first sample, which is then returned.
        sample: input.
        share: of the previous output, 0 (no filter) to below 1.
    """
    return np.asarray(sample if previous is None else (1.0 - share) * sample + share * previous)


def find_share(cutoff_hz: float, period_s: float) -> float:
    """Return the share of the previous output with which ``low_pass`` has a cut-off frequency.

    The share ``exp(-2 pi f T)`` samples the step response of a first-order filter exactly.

    Raises:
        ExecutionError: a value that is not positive.
    """
    if not (cutoff_hz > 0.0 and period_s > 0.0):
        raise ExecutionError(f"cutoff_hz {cutoff_hz:g} and period_s {period_s:g}; expected positive numbers")
    return float(np.exp(-2.0 * np.pi * cutoff_hz * period_s))


@dataclass(frozen=True)
class PidGains:
    """Gains of a PID control of one or several signals (Franklin 2016, 2.1.3.1).

    Attributes:
        kp: output per error.
        ki: output per integral of the error [1/s].
        kd: output per derivative of the error [s].
        limit: largest absolute output.
        cutoff_hz: of the low-pass filter of the derivative.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    limit: float = np.inf
    cutoff_hz: float = 20.0

    def __post_init__(self) -> None:
        if min(self.kp, self.ki, self.kd) < 0.0 or not self.limit > 0.0:
            raise ExecutionError(
                f"gains kp {self.kp:g}, ki {self.ki:g}, kd {self.kd:g} and limit {self.limit:g}; expected gains of 0 "
                "or more and a positive limit"
            )


@dataclass(frozen=True)
class PidState:
    """State of a PID control between two steps.

    Attributes:
        integral: share of the output that the integral holds.
        error: last error; None before the first step.
        derivative: filtered derivative of the error [1/s].
    """

    integral: np.ndarray
    error: np.ndarray | None
    derivative: np.ndarray

    @staticmethod
    def zero(shape: tuple[int, ...] = ()) -> PidState:
        """Return the state before the first step."""
        return PidState(np.zeros(shape), None, np.zeros(shape))


def step_pid(gains: PidGains, state: PidState, error: np.ndarray, period_s: float) -> tuple[np.ndarray, PidState]:
    """Return the output of a PID control at a new error, and the state after it.

    The derivative is filtered.  Anti-windup: where the output is at its limit, the integral does not grow further in
    that direction (conditional integration; Astrom and Hagglund 1995, 3.5).
    """
    error = np.asarray(error, dtype=float)
    slope = np.zeros_like(error) if state.error is None else (error - state.error) / period_s
    derivative = low_pass(state.derivative, slope, find_share(gains.cutoff_hz, period_s))
    step = gains.ki * error * period_s
    wanted = gains.kp * error + state.integral + step + gains.kd * derivative
    is_winding = (np.abs(wanted) > gains.limit) & (step * wanted > 0.0)
    integral = state.integral + np.where(is_winding, 0.0, step)
    output = np.clip(gains.kp * error + integral + gains.kd * derivative, -gains.limit, gains.limit)
    return output, PidState(integral, error, derivative)
