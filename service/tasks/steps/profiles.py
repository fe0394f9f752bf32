"""Straight lines of configurations over time: polynomials of degree 3 and 5 that rest at both ends."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from service.verify import Profile, evaluate_profile

PEAK_SPEED = {"cubic": 1.5, "quintic": 1.875}  # of the share of the way per share of the time
PEAK_ACCELERATION = {"cubic": 6.0, "quintic": 10.0 / np.sqrt(3.0)}
RAMP_SHARE = 1e-5  # of the time, on which the path parameter of a cubic starts
GRID = 800  # of the time law of a quintic


def find_least_duration(
    profile: Profile,
    step: Float[np.ndarray, "n"],
    velocity: Float[np.ndarray, "n"],
    acceleration: Float[np.ndarray, "n"],
) -> float:
    """Return the shortest time in which joints do a step within their limits of speed and acceleration [s]."""
    size = np.abs(step)
    by_speed = PEAK_SPEED[profile] * (size / velocity).max(initial=0.0)
    by_acceleration = np.sqrt(PEAK_ACCELERATION[profile] * (size / acceleration).max(initial=0.0))
    return float(max(by_speed, by_acceleration, 1e-2)) * (1.0 + 1e-4)


def make_profile(
    profile: Profile, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], duration_s: float
) -> tuple[Curve, TimeLaw]:
    """Return curve and time law of a straight line that is done in a time.

    The curve is the polynomial of degree 3 of its path parameter.  With a parameter that runs evenly it is the cubic
    profile; for that of degree 5 the parameter runs so that the share of the way is its.
    """
    knots = np.linspace(0.0, 1.0, 9)
    share, slope = evaluate_profile("cubic", knots), 6.0 * knots * (1.0 - knots)
    step = last - first
    curve = Curve(knots, first + np.outer(share, step), np.outer(slope, step))
    if profile == "cubic":
        path = np.array([0.0, RAMP_SHARE, 1.0 - RAMP_SHARE, 1.0])
        law = TimeLaw.accelerated(path, np.array([0.0, 1.0, 1.0, 0.0]))
    else:
        time = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, GRID + 1))
        path = _invert_cubic(evaluate_profile(profile, time))
        # Rates from the derivative of both polynomials; both vanish at the ends.
        inner = time[1:-1]
        rate = 30.0 * inner**2 * (1.0 - inner) ** 2 / (6.0 * path[1:-1] * (1.0 - path[1:-1]))
        law = TimeLaw.accelerated(path, np.concatenate([[0.0], rate, [0.0]]))
    scale = duration_s / law.times[-1]
    return curve, TimeLaw(law.times * scale, law.path, law.speed / scale)


def _invert_cubic(share: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the parameters at which 3 u^2 - 2 u^3 has given values from 0 to 1."""
    return np.asarray(0.5 - np.sin(np.arcsin(1.0 - 2.0 * share) / 3.0))
