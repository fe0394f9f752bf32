"""Slower time laws of the same curve: within limits of speed and acceleration, with a limited jerk, as grips hold.

A stretch is the part of a law between two neighbouring rests, or from or to an end at which the robot moves.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.stopping import poll
from service.verify import (
    FrameSpeed,
    Motion,
    VerifySettings,
    find_grip_slowdown,
    measure_jerks,
    measure_timed_peaks,
    trace_frame,
)

REST = 1e-12  # speed along the path that counts as none [1/s]
# Widths of the filter that are tried, as shares of a stretch's duration.
WIDTHS = np.geomspace(0.03, 1.0, 8)
CELL_S = 1e-2  # longest cell of a filtered law [s]
CELLS = 12  # of the filter's width, at least
SAMPLES_PER_CELL = 4  # of a law, at which speeds of frames are measured
ROUNDS = 8  # of slowing a stretch, which lowers its jerk by the third power but for steps of the curve's bend
GRIP_SPARE = 1.02  # the same for what grips hold
SPARE = 1.002  # more than the estimate asks
JERK_SHARE = 0.95  # of the limits that is used: where the windows of the measure begin changes with the duration


def stretch_law(law: TimeLaw, factor: Float[np.ndarray, "M-1"]) -> TimeLaw:
    """Multiply every cell's duration; the factor may only change at rests.

    Where the robot moves at an end, it is slower there, too (``moving_ends`` makes up for it).
    """
    times = np.concatenate([law.times[:1], law.times[0] + np.cumsum(np.diff(law.times) * factor)])
    return TimeLaw(times, law.path, law.speed / np.append(factor, factor[-1]))


def slow_to_limits(robot: RobotModel, curve: Curve, law: TimeLaw) -> TimeLaw:
    """Slow each stretch between rests until its exact peaks are within the limits."""
    peaks = measure_timed_peaks(curve, law)
    excess = np.maximum(
        (peaks.speed / robot.velocity).max(axis=1), np.sqrt((peaks.acceleration / robot.acceleration).max(axis=1))
    )
    factor = np.ones(len(law.times) - 1)
    for a, b in list_stretches(law):
        inside = (peaks.s >= law.path[a]) & (peaks.s < law.path[b])
        factor[a:b] = max(1.0, float(excess[inside].max()))
    return stretch_law(law, factor)


def slow_to_speeds(motion: Motion, law: TimeLaw, speeds: Sequence[FrameSpeed]) -> TimeLaw:
    """Slow each stretch between rests until frames keep their largest speeds at close samples."""
    for wanted in speeds:
        inner = np.linspace(law.path[:-1], law.path[1:], SAMPLES_PER_CELL, endpoint=False).T.ravel()
        s = np.unique(np.append(inner, law.path[-1]))
        _, places = trace_frame(motion.robot.model, wanted.frame, motion.curve(np.append(s, wanted.last)))
        rates = np.linalg.norm(np.diff(places[:-1], axis=0), axis=1) / np.diff(s)
        square = np.interp(s, law.path, law.speed**2)
        fastest = rates * np.sqrt(np.maximum(square[:-1], square[1:]))
        away = np.linalg.norm(places[:-1] - places[-1], axis=1)
        is_bound = (s[:-1] >= wanted.first) & (s[1:] <= wanted.last)
        is_bound &= np.minimum(away[:-1], away[1:]) <= wanted.near_m
        excess = np.where(is_bound, SPARE * fastest / wanted.most, 0.0)
        factor = np.ones(len(law.times) - 1)
        for a, b in list_stretches(law):
            inside = (s[:-1] >= law.path[a]) & (s[:-1] < law.path[b])
            factor[a:b] = max(1.0, float(excess[inside].max(initial=0.0)))
        law = stretch_law(law, factor)
    return law


def limit_jerk(
    robot: RobotModel,
    curve: Curve,
    law: TimeLaw,
    jerk: Float[np.ndarray, "n"],
    kept: Container[tuple[float, float]] = (),
) -> TimeLaw:
    """Return the law with the speed along the path filtered by a box and slowed, so that jerk limits hold as well.

    The path stays.  A wider box leaves less jerk to slow away, and takes its width itself: on each stretch between two
    rests the width is taken whose law ends first.

    Args:
        robot: with the shares of its limits of speed and acceleration that are used.
        jerk: (n,) limits [rad/s3, m/s3].
        kept: path parameters of the ends of stretches that stay as they are.
    """
    jerk = JERK_SHARE * jerk
    path, speed = [law.path[:1]], [np.zeros(1)]
    for a, b in list_stretches(law):
        own = law.cut(float(law.path[a]), float(law.path[b]))
        if own is None or (float(law.path[a]), float(law.path[b])) in kept:
            path.append(law.path[a + 1 : b + 1])
            speed.append(law.speed[a + 1 : b + 1])
            continue
        part = curve.cut(curve.find_knots(own.path[0], own.path[-1]))
        poll()
        tried = (_slow_to_jerk(robot, part, _filter(own, width), jerk) for width in WIDTHS * own.times[-1])
        best = min(tried, key=lambda one: float(one.times[-1]))
        path.append(best.path[1:])
        speed.append(best.speed[1:])
    return _slow_across_rests(curve, TimeLaw.accelerated(np.concatenate(path), np.concatenate(speed)), jerk, kept)


def _slow_across_rests(
    curve: Curve, law: TimeLaw, jerk: Float[np.ndarray, "n"], kept: Container[tuple[float, float]]
) -> TimeLaw:
    """Slow the stretches on both sides of a rest where their jerks add up."""
    for _ in range(ROUNDS):
        s, jerks = measure_jerks(curve, law)
        excess = (jerks / jerk).max(axis=1)
        if excess.max() <= 1.0:
            break
        factor, first = np.ones(len(law.times) - 1), law.path[0]
        for a, b in list_stretches(law):
            inside = (s >= first) & (s <= law.path[b])
            if (float(law.path[a]), float(law.path[b])) not in kept:
                factor[a:b] = max(1.0, SPARE * float(excess[inside].max(initial=0.0)) ** (1.0 / 3.0))
            first = s[s <= law.path[b]].max(initial=law.path[a])  # the last window reaches into the next stretch
        law = stretch_law(law, factor)
    return law


def slow_until_grips_hold(motion: Motion, law: TimeLaw, kept: Container[tuple[float, float]] = ()) -> TimeLaw:
    """Slow the phases whose grips would let an object slip as it moves, as far as the grips hold its weight alone.

    Args:
        motion: with phases and objects; its own law does not count.
        law: that is slowed; phases begin and end at its rests.
        kept: path parameters of the ends of phases whose speed is given.
    """
    factor = np.ones(len(law.times) - 1)
    for phase in motion.phases:
        if (phase.first, phase.last) in kept:
            continue
        slower = find_grip_slowdown(replace(motion, law=law), phase, VerifySettings())
        if slower > 1.0:
            factor[(law.path[:-1] >= phase.first) & (law.path[1:] <= phase.last)] = GRIP_SPARE * slower
    return stretch_law(law, factor) if np.any(factor > 1.0) else law


def list_stretches(law: TimeLaw) -> Iterator[tuple[int, int]]:
    """Yield the first and the last grid point of every stretch."""
    is_end = law.speed <= REST
    is_end[[0, -1]] = True
    return pairwise(np.flatnonzero(is_end).tolist())


def _filter(law: TimeLaw, width: float) -> TimeLaw:
    """Return a law from rest to rest whose speed is the mean over a width of time of the given law's [s]."""
    times = law.times - law.times[0]
    duration = float(times[-1]) + width
    count = max(int(np.ceil(duration / CELL_S)), int(np.ceil(CELLS * duration / width)))
    t = np.linspace(0.0, duration, count + 1)
    ahead, behind = (law.at(np.clip(t + by, 0.0, times[-1]) + law.times[0])[0] for by in (0.0, -width))
    speed = (ahead - behind) / width
    speed[[0, -1]] = 0.0
    # Between the points the speed is read as linear, so that the path follows from it.
    length = 0.5 * (speed[1:] + speed[:-1]) * (duration / count)
    path = law.path[0] + np.concatenate([[0.0], np.cumsum(length)]) * ((law.path[-1] - law.path[0]) / length.sum())
    path[-1] = law.path[-1]
    moving = np.append(np.diff(path) > 0.0, True)
    return TimeLaw.accelerated(path[moving], speed[moving])


def _slow_to_jerk(robot: RobotModel, curve: Curve, law: TimeLaw, jerk: Float[np.ndarray, "n"]) -> TimeLaw:
    """Return a law between two rests, slowed evenly until limits of speed, acceleration and jerk hold."""
    law = slow_to_limits(robot, curve, law)
    for _ in range(ROUNDS):
        excess = float((measure_jerks(curve, law)[1] / jerk).max())
        if excess <= 1.0:
            break
        law = stretch_law(law, np.full(len(law.times) - 1, SPARE * excess ** (1.0 / 3.0)))
    return law
