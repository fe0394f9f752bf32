"""Exported samples: every knot, one a sample period at least, and close ones where the robot rests."""

from __future__ import annotations

import numpy as np

from benchmarks.planning.timing_reference import chain, spline_through
from service.motion.execute import BESIDE_REST, SAME_TIME_S, SAMPLE_PERIOD_S, _sample_law
from service.motion.timing import time_curve
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
