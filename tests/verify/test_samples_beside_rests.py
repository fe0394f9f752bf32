"""Exported samples: every knot, one a sample period at least, close ones at rests and where little drift is allowed."""

from __future__ import annotations

import numpy as np

from benchmarks.planning.timing_reference import chain, spline_through
from costs.scene import Scene
from service.body.aims import Aims
from service.body.task_plan import PlannedPhase, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.phase import TaskPhase
from service.motion.execute import (
    BESIDE_REST,
    HELD_CHORD_SHARE,
    SAME_TIME_S,
    SAMPLE_PERIOD_S,
    _sample_law,
    make_motion,
)
from service.motion.timing import TimingSettings, time_curve
from service.verify import Motion
from service.verify.timeline import find_times


def test_samples_are_close_to_rests_and_never_all_but_together() -> None:
    robot = chain(np.array([1.0]), np.array([5.0]))
    curve = spline_through(robot, np.linspace(0.0, 2.0, 7)[:, None])
    rest = float(curve.knots[3])
    law = time_curve(robot, curve, [rest])
    samples = _sample_law(curve.knots, law, np.full(len(curve.knots) - 1, np.inf))
    assert np.all(np.isin(curve.knots, samples))
    times = find_times(law, samples)
    assert np.diff(times).max() <= SAMPLE_PERIOD_S + 1e-9
    assert np.diff(times).min() > 0.99 * SAME_TIME_S
    length = curve.knots[1] - curve.knots[0]
    for stop, sides in ((0.0, (1,)), (rest, (-1, 1)), (float(curve.knots[-1]), (-1,))):
        for side in sides:
            beside = stop + side * length * BESIDE_REST
            assert np.abs(samples[:, None] - beside).min(axis=0).max() < 1e-12
            gap = np.abs(samples - stop)
            assert gap[(gap > 0.0) & (np.sign(samples - stop) == side)].min() <= 0.0101 * length


def test_samples_are_as_close_as_the_drift_of_a_phase_demands() -> None:
    robot = chain(np.array([1.0]), np.array([5.0]))
    body = WholeBody.standing(robot, Scene(()), np.zeros(1), (), Aims())
    q = np.array([0.0, 0.4, 0.5, 1.2, 1.0])[:, None]
    phases = (PlannedPhase(TaskPhase("free"), q, True), PlannedPhase(TaskPhase("chain"), q[::-1], True, drift=1e-5))
    motion = make_motion(TaskPlan(body, phases), TimingSettings())
    free, chained = (_measure_chord(motion, phase.first, phase.last) for phase in motion.phases)
    assert chained <= HELD_CHORD_SHARE * 1e-5 * (1.0 + 1e-6)
    assert free > 10.0 * chained


def _measure_chord(motion: Motion, first: float, last: float) -> float:
    """Return how far the curve is off its samples, read linearly [rad]."""
    assert motion.samples is not None
    own = motion.samples[(motion.samples >= first) & (motion.samples <= last)]
    middle = 0.5 * (own[1:] + own[:-1])
    ends = motion.curve(own)
    return float(np.abs(motion.curve(middle) - 0.5 * (ends[1:] + ends[:-1])).max())
