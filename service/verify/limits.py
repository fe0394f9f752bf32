"""Joint limits of the curve and of its timing: positions, speeds and accelerations exactly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, PolynomialCurve, TimeLaw, differentiate
from costs.robot import RobotModel
from service.verify.certificate import Basis, Check, Where
from service.verify.curves.polynomials import bound_range
from service.verify.motion import Motion, Phase, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_time, find_times
from service.verify.validation import check_law

# Errors of the rounded numbers that a difference of two samples is made of, in units of their last place.
_ROUNDINGS = 16.0
# Least time in which a joint reaches its acceleration limit, where its jerk is limited at all [s].
RISE_S = 0.1
# Over which a change of acceleration counts as jerk: that of a robot's set points [s].
JERK_WINDOW_S = 0.01
JERK_STEPS = 5  # between the beginnings of two windows that do not overlap
SPEED_JUMP = 1e-6  # of a joint between two polynomials that still counts as none [rad/s, m/s]


@dataclass(frozen=True)
class TimedPeaks:
    """Largest values on the cells between neighbouring grid points of the time law and knots.

    Attributes:
        s: (C,) path parameter where each cell begins.
        speed: (C, n) largest ``|dq/dt|``, exact.
        acceleration: (C, n) largest ``|d2q/dt2|``, exact.
    """

    s: Float[np.ndarray, "C"]
    speed: Float[np.ndarray, "C n"]
    acceleration: Float[np.ndarray, "C n"]


def measure_timed_peaks(curve: Curve, law: TimeLaw) -> TimedPeaks:
    """Return the peaks of speed and acceleration along the timed curve.

    Between two grid points ``d2s/dt2 = u`` is constant, so ``(ds/dt)^2`` is linear in s and the acceleration
    ``q' u + q'' (ds/dt)^2`` is a parabola in s for a cubic: ends and vertex hold its extremes.  The speed is extreme at
    ends and where the acceleration vanishes.  A cell knows its own second derivatives, so both sides of a knot count.

    Raises:
        VerifyError: when the law is inconsistent or does not run from the curve's first knot to its last.
    """
    check_law(curve, law)
    if isinstance(curve, PolynomialCurve):
        return _measure_polynomial_peaks(curve, law)
    moving = np.flatnonzero(np.diff(law.path) > 0.0)
    grid = np.unique(np.concatenate([law.path, curve.knots]))
    first, last = grid[:-1], grid[1:]
    owner = moving[np.clip(np.searchsorted(law.path[moving + 1], 0.5 * (first + last)), 0, len(moving) - 1)]
    square = law.speed**2
    share = law.shares[owner] ** 2
    u = share * 0.5 * (square[owner + 1] - square[owner]) / (law.path[owner + 1] - law.path[owner])
    x = np.maximum(share * square[owner] + 2.0 * u * (first - law.path[owner]), 0.0)
    piece = np.clip(np.searchsorted(curve.knots, 0.5 * (first + last), side="right") - 1, 0, len(curve.knots) - 2)
    _, c1, c2, c3 = curve.coefficients()[:, piece]
    v = (first - curve.knots[piece])[:, None]
    # q' = a0 + a1 w + a2 w^2 with w counted from the cell's beginning.
    a0, a1, a2 = c1 + 2.0 * c2 * v + 3.0 * c3 * v**2, 2.0 * c2 + 6.0 * c3 * v, 3.0 * c3
    width, gain, start = (last - first)[:, None], u[:, None], x[:, None]
    b0, b1, b2 = gain * a0 + a1 * start, 3.0 * gain * a1 + 2.0 * a2 * start, 5.0 * gain * a2

    def speed(w: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(a0 + w * (a1 + w * a2)) * np.sqrt(np.maximum(start + 2.0 * gain * w, 0.0)))

    turns = (np.clip(root, 0.0, width) for root in _roots(b0, b1, b2))
    fastest = np.maximum.reduce([speed(w) for w in (np.zeros_like(width), width, *turns)])
    return TimedPeaks(first, fastest, _parabola_peak(b0, b1, b2, width))


def _measure_polynomial_peaks(curve: PolynomialCurve, law: TimeLaw) -> TimedPeaks:
    """Return the peaks of a curve whose path parameter runs evenly in time; validation admits no other law."""
    steps, rate = np.diff(curve.knots), float(law.speed[0])
    peaks = []
    for order in (1, 2):
        low, high = bound_range(differentiate(curve.pieces, order), steps)
        peaks.append(np.maximum(-low, high) * rate**order)
    return TimedPeaks(curve.knots[:-1], peaks[0], peaks[1])


def measure_jerks(curve: Curve, law: TimeLaw) -> tuple[Float[np.ndarray, "W"], Float[np.ndarray, "W n"]]:
    """Return path parameters at which windows of ``JERK_WINDOW_S`` begin, and the joints' mean jerk over each.

    A mean counts steps of the acceleration as well; before and after the motion the robot rests [rad/s3, m/s3].
    """
    begins = np.arange(-JERK_STEPS, int(np.ceil((law.times[-1] - law.times[0]) / JERK_WINDOW_S * JERK_STEPS)) + 1)
    times = law.times[0] + JERK_WINDOW_S / JERK_STEPS * np.concatenate([begins, begins[-1] + 1 + np.arange(JERK_STEPS)])
    s, speed, gain = law.at(times)
    acceleration = curve(s, 1) * gain[:, None] + curve(s, 2) * speed[:, None] ** 2
    acceleration[(times < law.times[0]) | (times >= law.times[-1])] = 0.0
    change = acceleration[JERK_STEPS:] - acceleration[:-JERK_STEPS]
    return s[: len(change)], np.abs(change) / JERK_WINDOW_S


def measure_exported_speeds(curve: Curve, law: TimeLaw, s: Float[np.ndarray, "M"]) -> Float[np.ndarray, "M-1 n"]:
    """Return speeds between neighbouring exported samples, from their times and positions [rad/s, m/s].

    Differences within the rounding of the numbers count as 0; inf where a joint moves in no time.
    """
    q, times = curve(s), find_times(law, s)
    length, duration = np.abs(np.diff(q, axis=0)), np.diff(times)[:, None]
    last_place = np.finfo(float).eps * np.maximum(np.abs(q[1:]), np.abs(q[:-1]))
    # PoseSamples and times are as exact as the largest number that they were made of.
    slope = np.maximum(np.abs(curve(s[1:], 1)), np.abs(curve(s[:-1], 1)))
    last_place = last_place + slope * np.spacing(np.abs(s).max())
    length = np.maximum(length - _ROUNDINGS * last_place, 0.0)
    speeds = np.where(length > 0.0, np.inf, 0.0)
    blurred = duration + _ROUNDINGS * np.spacing(np.abs(times).max())
    np.divide(length, blurred, out=speeds, where=duration > 0.0)
    return np.asarray(speeds)


def check_positions(prepared: PreparedMotion, settings: VerifySettings) -> Iterator[Check]:
    """Check that the cubic stays within the joint position limits, exactly."""
    motion, robot, (low, high) = prepared.motion, prepared.motion.robot, prepared.range
    excess = np.maximum(robot.lower - low, high - robot.upper)
    piece, column = np.unravel_index(int(np.argmax(excess)), excess.shape)
    value = float(excess[piece, column])
    s = float(motion.curve.knots[piece])
    name = robot.joint_names[column]
    is_ok = value <= 1e-9
    text = (
        f"{name} comes nearest to its limits: {-value:.4f} rad left" if is_ok else f"{name} exceeds by {value:.4f} rad"
    )
    yield Check("limits.position", is_ok, value, 0.0, "rad", text, _at(motion, s, (name,)), Basis.PROOF)


def check_timing(prepared: PreparedMotion, settings: VerifySettings) -> Iterator[Check]:
    """Check speed and acceleration limits, on the curve and between samples, and rest at ends and contact changes."""
    motion, robot, law = prepared.motion, prepared.motion.robot, prepared.motion.law
    if law is None:
        return
    peaks = measure_timed_peaks(motion.curve, law)
    yield _limit_check(motion, "speed", peaks.speed / robot.velocity, peaks.s, settings)
    yield _limit_check(motion, "acceleration", peaks.acceleration / robot.acceleration, peaks.s, settings)
    if motion.jerk_scale is not None:
        s, jerks = measure_jerks(motion.curve, law)
        yield _limit_check(motion, "jerk", jerks * RISE_S / robot.acceleration, s, settings, motion.jerk_scale)
    if isinstance(motion.curve, PolynomialCurve):
        yield _jump_check(motion, motion.curve, law)
    if motion.samples is not None:
        ratio = measure_exported_speeds(motion.curve, law, motion.samples) / robot.velocity
        yield _limit_check(motion, "exported", ratio, motion.samples, settings)
    yield _rest_check(motion, law, prepared.phases, settings)


def _limit_check(
    motion: Motion,
    kind: str,
    ratio: Float[np.ndarray, "C n"],
    s: Float[np.ndarray, "S"],
    settings: VerifySettings,
    most: float = 1.0,
) -> Check:
    cell, column = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    value, name = float(ratio[cell, column]), motion.robot.joint_names[column]
    of = "speed limit between exported samples" if kind == "exported" else f"{kind} limit"
    text = f"{name} reaches {100.0 * value:.1f} % of its {of}"
    where = _at(motion, float(s[cell]), (name,))
    is_ok = value <= most * (1.0 + settings.limit_tolerance)
    basis = Basis.SAMPLES if kind == "jerk" else Basis.PROOF
    return Check(f"limits.{kind}", is_ok, value, most, "1", text, where, basis)


def _jump_check(motion: Motion, curve: PolynomialCurve, law: TimeLaw) -> Check:
    """Check that no speed jumps at a point between two polynomials, where no acceleration limit would hold."""
    jumps = np.abs(curve.measure_slope_jumps()) * law.speed[0]
    value, s, name = 0.0, float(curve.knots[0]), motion.robot.joint_names[0]
    if jumps.size:
        row, column = np.unravel_index(int(np.argmax(jumps)), jumps.shape)
        value, s, name = float(jumps[row, column]), float(curve.knots[row + 1]), motion.robot.joint_names[column]
    is_ok = value <= SPEED_JUMP
    text = "no speed jumps between two points"
    if not is_ok:
        text = f"the speed of {name} jumps by {value:.3g} rad/s at a point, so that no acceleration limit holds there"
    return Check("limits.jump", is_ok, value, SPEED_JUMP, "rad/s", text, _at(motion, s, (name,)), Basis.PROOF)


def place_rates(robot: RobotModel, rates: Mapping[str, float]) -> Float[np.ndarray, "n"]:
    """Return the rates of all coordinates, 0 for those that are not named [rad/s, m/s]."""
    return np.array([rates.get(name, 0.0) for name in robot.joint_names])


def _rest_check(motion: Motion, law: TimeLaw, phases: tuple[Phase, ...], settings: VerifySettings) -> Check:
    """Check that the robot has its rates at both ends, and stands still where the set of planted links changes."""
    ends = [float(motion.curve.knots[0]), float(motion.curve.knots[-1])]
    changes = [
        after.first
        for before, after in pairwise(phases)
        if {c.link for c in before.contacts} != {c.link for c in after.contacts}
    ]
    rests = np.array(ends + changes)
    # The square of the speed is linear in the path.
    speed = np.sqrt(np.interp(rests, law.path, law.speed**2))
    demanded = np.zeros((len(rests), motion.robot.n))
    demanded[:2] = [place_rates(motion.robot, rates) for rates in (motion.start_rates, motion.end_rates)]
    off = np.abs(motion.curve(rests, 1) * speed[:, None] - demanded)
    worst, column = np.unravel_index(int(off.argmax()), off.shape)
    value = float(off[worst, column])
    text = f"fastest joint where the robot should rest: {value:.2g} rad/s"
    if (motion.start_rates or motion.end_rates) and value <= settings.rest_speed:
        text = f"at both ends every joint is within {value:.2g} rad/s of the rate that it should have"
    elif motion.start_rates or motion.end_rates:
        name, demand = motion.robot.joint_names[column], demanded[worst, column]
        text = f"{name} is {value:.2g} rad/s off the {demand:.4g} rad/s that it should have"
    limit, where = settings.rest_speed, _at(motion, float(rests[worst]), ())
    return Check("limits.rest", value <= limit, value, limit, "rad/s", text, where, Basis.PROOF)


def _at(motion: Motion, s: float, names: tuple[str, ...]) -> Where:
    return Where(s, find_time(motion.law, s), None, names)


def _parabola_peak(a0: np.ndarray, a1: np.ndarray, a2: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return the largest ``|a0 + a1 w + a2 w^2|`` for ``0 <= w <= width``."""
    vertex = np.divide(-a1, 2.0 * a2, out=np.zeros_like(a1), where=np.abs(a2) > 1e-300)
    vertex = np.clip(vertex, 0.0, width)
    inner = np.abs(a0 + vertex * (a1 + vertex * a2))
    return np.asarray(np.maximum(np.maximum(np.abs(a0), np.abs(a0 + width * (a1 + width * a2))), inner))


def _roots(b0: np.ndarray, b1: np.ndarray, b2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both zeros of ``b0 + b1 w + b2 w^2``, without cancellation; 0 where there is none."""
    lean = -0.5 * (b1 + np.where(b1 >= 0.0, 1.0, -1.0) * np.sqrt(np.maximum(b1**2 - 4.0 * b0 * b2, 0.0)))
    far = np.divide(lean, b2, out=np.zeros_like(b0), where=np.abs(b2) > 1e-300)
    near = np.divide(b0, lean, out=np.zeros_like(b0), where=np.abs(lean) > 1e-300)
    return far, near
