"""Joint limits of the curve and of its timing: positions and accelerations exactly, speeds from above."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from service.verify.certificate import Basis, Check, Where
from service.verify.errors import VerifyError
from service.verify.motion import Motion, Phase
from service.verify.settings import VerifySettings
from service.verify.timeline import time_of
from service.verify.track import Track


@dataclass(frozen=True)
class TimedPeaks:
    """Largest values on the cells between neighbouring grid points of the time law and knots.

    Attributes:
        s: (C,) path parameter where each cell begins.
        speed: (C, n) upper bound of ``|dq/dt|``.
        acceleration: (C, n) largest ``|d2q/dt2|``, exact.
    """

    s: Float[np.ndarray, "C"]
    speed: Float[np.ndarray, "C n"]
    acceleration: Float[np.ndarray, "C n"]


def timed_peaks(curve: Curve, law: TimeLaw) -> TimedPeaks:
    """Peaks of speed and acceleration along the timed curve.

    Between two grid points ``d2s/dt2 = u`` is constant, so ``(ds/dt)^2`` is linear in s and ``q' u + q'' (ds/dt)^2`` is
    a parabola in s for a cubic: ends and vertex hold its extremes.

    Raises:
        VerifyError: when the law is inconsistent or does not run from the curve's first knot to its last.
    """
    _check_law(curve, law)
    moving = np.flatnonzero(np.diff(law.path) > 0.0)
    grid = np.unique(np.concatenate([law.path, curve.knots]))
    first, last = grid[:-1], grid[1:]
    owner = moving[np.clip(np.searchsorted(law.path[moving + 1], 0.5 * (first + last)), 0, len(moving) - 1)]
    square = law.speed**2
    u = 0.5 * (square[owner + 1] - square[owner]) / (law.path[owner + 1] - law.path[owner])
    x = np.maximum(square[owner] + 2.0 * u * (first - law.path[owner]), 0.0)
    x_last = np.maximum(x + 2.0 * u * (last - first), 0.0)
    piece = np.clip(np.searchsorted(curve.knots, 0.5 * (first + last), side="right") - 1, 0, len(curve.knots) - 2)
    _, c1, c2, c3 = curve.coefficients()[:, piece]
    v = (first - curve.knots[piece])[:, None]
    # q' = a0 + a1 w + a2 w^2 with w counted from the cell's beginning.
    a0, a1, a2 = c1 + 2.0 * c2 * v + 3.0 * c3 * v**2, 2.0 * c2 + 6.0 * c3 * v, 3.0 * c3
    width = (last - first)[:, None]
    speed = _parabola_peak(a0, a1, a2, width) * np.sqrt(np.maximum(x, x_last))[:, None]
    gain, start = u[:, None], x[:, None]
    b0, b1, b2 = gain * a0 + a1 * start, 3.0 * gain * a1 + 2.0 * a2 * start, 5.0 * gain * a2
    return TimedPeaks(first, speed, _parabola_peak(b0, b1, b2, width))


def position_check(track: Track) -> Check:
    """Whether the cubic stays within the joint position limits, exactly."""
    motion, robot, (low, high) = track.motion, track.motion.robot, track.range
    excess = np.maximum(robot.lower - low, high - robot.upper)
    piece, column = np.unravel_index(int(np.argmax(excess)), excess.shape)
    value = float(excess[piece, column])
    s = float(motion.curve.knots[piece])
    name = robot.joint_names[column]
    is_ok = value <= 1e-9
    text = (
        f"{name} comes nearest to its limits: {-value:.4f} rad left" if is_ok else f"{name} exceeds by {value:.4f} rad"
    )
    return Check("limits.position", is_ok, value, 0.0, "rad", text, _at(motion, s, (name,)), Basis.PROOF)


def timed_checks(motion: Motion, law: TimeLaw, phases: tuple[Phase, ...], settings: VerifySettings) -> Iterator[Check]:
    """Speed and acceleration limits, and rest at the ends and where contacts change."""
    peaks = timed_peaks(motion.curve, law)
    for kind, values, limits in (
        ("speed", peaks.speed, motion.robot.velocity),
        ("acceleration", peaks.acceleration, motion.robot.acceleration),
    ):
        ratio = values / limits
        cell, column = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        value, name = float(ratio[cell, column]), motion.robot.joint_names[column]
        text = f"{name} reaches {100.0 * value:.1f} % of its {kind} limit"
        where = _at(motion, float(peaks.s[cell]), (name,))
        is_ok = value <= 1.0 + settings.limit_tolerance
        yield Check(f"limits.{kind}", is_ok, value, 1.0, "1", text, where, Basis.PROOF)
    yield _rest_check(motion, law, phases)


def _rest_check(motion: Motion, law: TimeLaw, phases: tuple[Phase, ...]) -> Check:
    """The robot must stand still at both ends and where the set of planted links changes."""
    ends = [float(motion.curve.knots[0]), float(motion.curve.knots[-1])]
    changes = [
        after.first
        for before, after in pairwise(phases)
        if {c.link for c in before.contacts} != {c.link for c in after.contacts}
    ]
    rests = np.array(ends + changes)
    speed = np.interp(rests, law.path, law.speed)
    fastest = np.abs(motion.curve(rests, 1) * speed[:, None]).max(axis=1)
    worst = int(fastest.argmax())
    value = float(fastest[worst])
    text = f"fastest joint where the robot should rest: {value:.2g} rad/s"
    return Check(
        "limits.rest", value <= 1e-6, value, 1e-6, "rad/s", text, _at(motion, float(rests[worst]), ()), Basis.PROOF
    )


def _at(motion: Motion, s: float, names: tuple[str, ...]) -> Where:
    return Where(s, time_of(motion.law, s), None, names)


def _parabola_peak(a0: np.ndarray, a1: np.ndarray, a2: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Largest ``|a0 + a1 w + a2 w^2|`` for ``0 <= w <= width``."""
    vertex = np.divide(-a1, 2.0 * a2, out=np.zeros_like(a1), where=np.abs(a2) > 1e-300)
    vertex = np.clip(vertex, 0.0, width)
    inner = np.abs(a0 + vertex * (a1 + vertex * a2))
    return np.asarray(np.maximum(np.maximum(np.abs(a0), np.abs(a0 + width * (a1 + width * a2))), inner))


def _check_law(curve: Curve, law: TimeLaw) -> None:
    if not np.all(np.diff(law.times) > 0.0) or not np.all(np.diff(law.path) >= 0.0) or np.any(law.speed < 0.0):
        raise VerifyError("the time law needs increasing times, a path that does not run back and speeds >= 0")
    scale = float(curve.knots[-1] - curve.knots[0])
    if max(abs(law.path[0] - curve.knots[0]), abs(law.path[-1] - curve.knots[-1])) > 1e-9 * scale:
        raise VerifyError(f"the time law runs from {law.path[0]} to {law.path[-1]}, not along the whole curve")
    travelled = 0.5 * (law.speed[:-1] + law.speed[1:]) * np.diff(law.times)
    if np.max(np.abs(travelled - np.diff(law.path))) > 1e-6 * scale:
        raise VerifyError("the time law's path does not follow from its speeds and times")
