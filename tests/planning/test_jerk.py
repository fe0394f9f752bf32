"""Limited jerk: smooth curves, laws whose acceleration never changes faster than allowed, and a check that says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.planning.timing_reference import chain
from costs.curve import Curve, TimeLaw
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel
from costs.scene import Scene
from service.motion.spline import PhasePath, make_spline
from service.motion.timing import TimingSettings, time_curve
from service.planner import plan
from service.replay.whole import certify_whole
from service.request.file import load_request
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.verify import Motion, Phase, Status, verify

ROOT = Path(__file__).parents[2]
RISE_S, WINDOW_S = 0.1, 0.01  # of the definition in docs/request-format.md


def _make_curve(robot: RobotModel, q: np.ndarray, *, is_smooth: bool) -> Curve:
    paths = [PhasePath("move", q, ())]
    limits = robot.lower, robot.upper, robot.velocity
    return make_spline(KinematicsEngine(robot), paths, *limits, is_smooth=is_smooth).curve


def _draw(seed: int, count: int, n: int = 3) -> tuple[RobotModel, np.ndarray]:
    rng = np.random.default_rng(seed)
    robot = chain(rng.uniform(0.5, 3.0, n), rng.uniform(1.0, 10.0, n))
    return robot, np.cumsum(rng.uniform(-0.3, 0.3, (count, n)), axis=0)


def _measure_jerk(curve: Curve, law: TimeLaw) -> np.ndarray:
    """Return the largest mean jerk over any window, from positions alone, with the robot at rest around the motion."""
    dt = 1e-3
    times = np.arange(-20, int(law.times[-1] / dt) + 20) * dt
    q = curve(law.at(np.clip(times, 0.0, law.times[-1]))[0])
    acceleration = np.diff(q, 2, axis=0) / dt**2
    k = round(WINDOW_S / dt)
    return np.asarray(np.abs(acceleration[k:] - acceleration[:-k]).max(axis=0) / WINDOW_S)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(3, 12))
def test_a_smooth_curve_bends_alike_on_both_sides_of_every_waypoint(seed: int, count: int) -> None:
    robot, q = _draw(seed, count)
    curve = _make_curve(robot, q, is_smooth=True)
    _, _, c2, c3 = curve.coefficients()
    before = 2.0 * c2 + 6.0 * c3 * np.diff(curve.knots)[:, None]
    assert np.allclose(before[:-1], 2.0 * c2[1:], atol=1e-6 * np.abs(c2).max())
    assert np.allclose(curve(curve.knots), q)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 8), scale=st.sampled_from([0.1, 0.5, 1.0]))
def test_no_window_of_a_timed_curve_has_more_than_the_allowed_jerk(seed: int, count: int, scale: float) -> None:
    robot, q = _draw(seed, count)
    curve = _make_curve(robot, q, is_smooth=True)
    law = time_curve(robot, curve, settings=TimingSettings(jerk_scale=scale))
    assert np.abs(law.shares - 1.0).max() < 1e-6
    assert (law.path[0], law.path[-1]) == (curve.knots[0], curve.knots[-1])
    # Positions are differenced over a millisecond, which smears the windows' ends by as much.
    assert np.all(_measure_jerk(curve, law) <= 1.12 * scale * robot.acceleration / RISE_S)
    motion = Motion(robot, Scene(()), curve, law, jerk_scale=scale)
    (check,) = [check for check in verify(motion).checks if check.name == "limits.jerk"]
    assert check.ok


def test_a_rest_on_the_way_is_kept_and_its_sides_do_not_add_up() -> None:
    robot, q = _draw(3, 9)
    curve = _make_curve(robot, q, is_smooth=True)
    rest = float(curve.knots[4])
    law = time_curve(robot, curve, [rest], TimingSettings(jerk_scale=0.3))
    assert law.speed[law.path == rest] == pytest.approx(0.0, abs=1e-12)
    assert np.all(_measure_jerk(curve, law) <= 1.12 * 0.3 * robot.acceleration / RISE_S)


def test_a_law_without_a_limit_is_refuted_where_one_is_promised() -> None:
    robot, q = _draw(1, 6)
    curve = _make_curve(robot, q, is_smooth=False)
    motion = Motion(robot, Scene(()), curve, time_curve(robot, curve), (Phase("move", *curve.knots[[0, -1]].tolist()),))
    assert not [check for check in verify(motion).checks if check.name == "limits.jerk"]
    (failed,) = [check for check in verify(replace(motion, jerk_scale=1.0)).failed() if "jerk" in check.name]
    assert "of its jerk limit" in failed.text
    assert failed.value > failed.limit == 1.0


def test_a_plan_keeps_the_jerk_limit_of_its_request_and_no_other() -> None:
    request = load_request(ROOT / "examples/requests/joint_goal.yaml")
    request = replace(request, options=replace(request.options, jerk_scale=0.5))
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED
    motion, setup = result.motion, prepare(request)
    assert motion is not None
    assert motion.law is not None
    n = result.robot.n
    limits = 0.5 * result.robot.acceleration / RISE_S
    assert np.all(_measure_jerk(motion.curve, motion.law)[:n] <= 1.12 * limits)
    certificate = certify_whole(setup, motion)
    assert certificate is not None
    assert certificate.status is Status.CERTIFIED
    for told in (None, 1.0):  # a record that leaves the limit out, or widens it, is not the request's
        assert certify_whole(setup, replace(motion, jerk_scale=told)) is None
