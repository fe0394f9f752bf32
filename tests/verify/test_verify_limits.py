"""Limits of the timed curve: exact peaks, steps that hide no speed, and the speeds that a reader of samples sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import random_curve, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.verify import Check, Motion, Phase, PlantedContact, VerifyError, VerifySettings, verify
from service.verify.limits import _roots, check_timing, measure_exported_speeds, measure_timed_peaks
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_times

# What a certified motion may exceed a speed limit by, relative; besides the last places of the numbers.
TOLERANCE = VerifySettings().limit_tolerance
LINE = Curve(np.arange(2.0), np.array([[0.0], [1.0]]), np.ones((2, 1)))


def _robot(n: int, velocity: np.ndarray | float = 10.0, acceleration: float = 1e9) -> RobotModel:
    model = pin.Model()
    for k in range(n):
        joint = model.addJoint(model.njoints - 1, pin.JointModelRZ(), pin.SE3.Identity(), f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    robot = robot_of(model, [], limit=1e3)
    return replace(robot, velocity=np.broadcast_to(velocity, (n,)), acceleration=np.full(n, acceleration))


def _law(path: np.ndarray, speed: np.ndarray) -> TimeLaw:
    """The law that has these speeds there."""
    return TimeLaw(np.append(0.0, np.cumsum(2.0 * np.diff(path) / (speed[:-1] + speed[1:]))), path, speed)


def _checks(motion: Motion) -> dict[str, Check]:
    assert motion.law is not None
    return {check.name: check for check in check_timing(PreparedMotion(motion), VerifySettings())}


def _brisk(n_steps: int, lie: float) -> Motion:
    """One joint along 2 rad within 0.5 rad/s, but for steps that are longer than their speeds and times come to."""
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [2.0]]), np.full((2, 1), 2.0))
    path = np.linspace(0.0, 1.0, n_steps + 1)
    speed = 0.25 * np.sin(np.pi * path) ** 0.25
    speed[[0, -1]] = 0.0
    law = _law(path, speed)
    durations = np.diff(law.times)
    durations = np.maximum(durations - lie / np.maximum(0.5 * (speed[:-1] + speed[1:]), 1e-3), 0.5 * durations)
    law = TimeLaw(np.append(0.0, np.cumsum(durations)), path, speed)
    return Motion(_robot(1, 0.5), Scene(), curve, law, samples=np.linspace(0.0, 1.0, 201))


def test_an_error_that_is_small_beside_the_curve_does_not_add_up_over_many_steps() -> None:
    motion = _brisk(400_000, 4.4e-7)  # each step is wrong by less than a millionth of the curve: 0.6 rad/s
    assert motion.law is not None
    middle = np.searchsorted(motion.law.path, [0.4, 0.6])
    assert 2.0 * 0.2 / np.diff(motion.law.times[middle])[0] > 0.6
    with pytest.raises(VerifyError, match=r"path does not follow.*is 1\.2\d* times as long as they come to"):
        verify(motion)
    assert verify(_brisk(2000, 0.0)).failed() == ()


def test_a_step_that_is_a_little_too_long_is_refused_and_named() -> None:
    law = _law(np.linspace(0.0, 1.0, 5), np.array([0.0, 1.0, 2.0, 1.0, 0.0]))
    measure_timed_peaks(LINE, law)
    for excess in (1.5e-6, -1.5e-6):
        times = law.times.copy()
        times[3:] -= excess * (times[3] - times[2])
        with pytest.raises(VerifyError, match=r"step 2 .*expected 1 within 1e-06"):
            measure_timed_peaks(LINE, replace(law, times=times))


def test_a_shortened_step_within_tolerance_raises_the_speed_that_is_reported() -> None:
    law = _law(np.linspace(0.0, 1.0, 5), np.ones(5))
    times = law.times * (1.0 - 8e-7)
    peaks = measure_timed_peaks(LINE, replace(law, times=times))
    assert peaks.speed.max() == pytest.approx(1.0 + 8e-7, abs=1e-9)


def test_the_executed_path_runs_through_the_points_of_a_law_whose_speeds_are_a_little_off() -> None:
    law = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.6, 1.0]), np.array([0.5, 0.5, 0.5]))
    path, speed, _ = law.at(np.array([1.0 - 1e-12, 1.0, 2.0 - 1e-12, 2.0]))
    np.testing.assert_allclose(path, [0.6, 0.6, 1.0, 1.0], atol=1e-11)
    np.testing.assert_allclose(speed, [0.6, 0.4, 0.4, 0.4], atol=1e-11)
    np.testing.assert_allclose(find_times(law, np.array([0.3, 0.6, 0.8])), [0.5, 1.0, 1.5])


@pytest.mark.parametrize(
    ("times", "path", "speed", "message"),
    [
        ([0.0, 1.0, 1.0], [0.0, 0.5, 1.0], [0.5, 0.5, 0.5], "increasing times"),
        ([0.0, 2.0, 1.0], [0.0, 0.5, 1.0], [0.5, 0.5, 0.5], "increasing times"),
        ([0.0, 1.0, 2.0], [0.0, 1.1, 1.0], [1.0, 1.0, 1.0], "does not run back"),
        ([0.0, 1.0, 2.0], [0.0, 0.5, 1.0], [0.5, -0.5, 0.5], "speeds >= 0"),
        ([0.0, 1.0, 2.0], [0.0, 0.5, 1.0], [0.5, np.nan, 0.5], "speeds >= 0"),
        ([0.0, 1.0, 2.0], [1e-6, 0.5, 1.0], [0.5, 0.5, 0.5], "not along the whole curve"),
        ([0.0, 1.0, 2.0], [0.0, 0.5, 1.0 - 1e-6], [0.5, 0.5, 0.5], "not along the whole curve"),
        ([0.0, 1.0, 2.0], [1.2e-9, 0.5, 1.0], [0.5, 0.5, 0.5], "not along the whole curve"),
        ([0.0, 1.0, 2.0], [0.0, 0.5, 1.0 + 1.2e-9], [0.5, 0.5, 0.5], "not along the whole curve"),
        ([0.0, 1.0], [0.0, 0.5, 1.0], [0.5, 0.5, 0.5], "got 2, 3 and 3"),
        ([0.0], [0.0], [0.0], "at least 2"),
        ([0.0, 1.0, 2.0, 3.0], [0.0, 0.5, 0.5, 1.0], [0.5, 0.5, 0.5, 0.5], "step 1 .*is 0 times"),
        ([0.0, 1.0], [0.0, 1.0], [0.0, 0.0], "does not follow"),
    ],
)
def test_a_malformed_law_is_refused(times: list[float], path: list[float], speed: list[float], message: str) -> None:
    with pytest.raises(VerifyError, match=message):
        measure_timed_peaks(LINE, TimeLaw(np.array(times), np.array(path), np.array(speed)))


def test_the_ends_of_a_law_are_held_against_the_length_of_the_curve_not_against_where_it_lies() -> None:
    far = Curve(1000.0 + LINE.knots, LINE.positions, LINE.tangents)
    law = TimeLaw(np.array([0.0, 1.0]), np.array([1000.0, 1001.0]), np.ones(2))
    measure_timed_peaks(far, law)
    with pytest.raises(VerifyError, match="not along the whole curve"):
        measure_timed_peaks(far, replace(law, path=np.array([1000.0 + 5e-9, 1001.0]), speed=np.full(2, 1.0 - 5e-9)))
    short = Curve(0.1 * LINE.knots, LINE.positions, LINE.tangents)
    with pytest.raises(VerifyError, match="not along the whole curve"):
        measure_timed_peaks(short, TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 0.1 - 5e-10]), np.full(2, 0.1)))


@pytest.mark.parametrize(
    ("b", "roots"),
    [
        ((6.0, -5.0, 1.0), (2.0, 3.0)),
        ((6.0, 5.0, 1.0), (-3.0, -2.0)),
        ((-1.0, 0.0, 4.0), (-0.5, 0.5)),
        ((1.0, -2.0, 1e-20), (0.5, 2e20)),
        ((1.0, 2.0, 1e-20), (-2e20, -0.5)),
        ((1.0, -2.0, 0.0), (0.0, 0.5)),
        ((0.0, -2.0, 1.0), (0.0, 2.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0)),
        ((1.0, 0.0, 0.0), (0.0, 0.0)),
    ],
)
def test_zeros_of_a_parabola_are_exact_however_flat_it_is(
    b: tuple[float, float, float], roots: tuple[float, float]
) -> None:
    found = np.sort(np.concatenate(_roots(*(np.array([value]) for value in b))))
    np.testing.assert_allclose(found, roots, rtol=1e-12)


def test_a_law_may_wait_where_it_rests() -> None:
    law = TimeLaw(np.array([0.0, 1.0, 4.0, 5.0]), np.array([0.0, 0.5, 0.5, 1.0]), np.array([1.0, 0.0, 0.0, 1.0]))
    assert measure_timed_peaks(LINE, law).speed.max() == pytest.approx(1.0)
    np.testing.assert_allclose(law.at(np.array([1.0, 2.0, 4.0]))[0], 0.5)
    np.testing.assert_allclose(find_times(law, np.array([0.0, 0.5, 1.0])), [0.0, 1.0, 5.0])


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_the_peaks_of_speed_and_acceleration_are_those_of_dense_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curve = random_curve(rng, 2, int(rng.integers(2, 6)))
    inner = rng.uniform(curve.knots[0], curve.knots[-1], int(rng.integers(0, 8)))
    path = np.unique(np.concatenate([curve.knots[[0, -1]], inner]))
    law = _law(path, rng.uniform(0.1, 1.0, len(path)))
    peaks = measure_timed_peaks(curve, law)
    for first, last, fastest, hardest in zip(
        peaks.s, np.append(peaks.s[1:], path[-1]), peaks.speed, peaks.acceleration, strict=True
    ):
        s = first + (last - first) * np.linspace(1e-9, 1.0 - 1e-9, 2001)
        step = np.clip(np.searchsorted(law.path, s) - 1, 0, len(path) - 2)
        u = np.diff(law.speed**2)[step] / np.diff(law.path)[step] / 2.0
        x = law.speed[step] ** 2 + 2.0 * u * (s - law.path[step])
        speed = np.abs(curve(s, 1) * np.sqrt(x)[:, None]).max(axis=0)
        acceleration = np.abs(curve(s, 1) * u[:, None] + curve(s, 2) * x[:, None]).max(axis=0)
        np.testing.assert_allclose(speed, fastest, rtol=1e-5, atol=2e-3 * fastest.max() + 1e-9)
        assert np.all(speed <= fastest * (1.0 + 1e-12) + 1e-12)
        assert np.all(acceleration <= hardest * (1.0 + 1e-9) + 1e-9)
        np.testing.assert_allclose(acceleration, hardest, rtol=1e-5, atol=2e-3 * hardest.max() + 1e-9)


def test_both_sides_of_a_knot_count_for_the_acceleration() -> None:
    # q'' is -2 before the knot and 6 behind it, at ds/dt = 1.
    curve = Curve(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [4.0]]), np.array([[2.0], [0.0], [6.0]]))
    law = TimeLaw(np.array([0.0, 2.0]), np.array([0.0, 2.0]), np.ones(2))
    np.testing.assert_allclose(measure_timed_peaks(curve, law).acceleration[:, 0], [2.0, 6.0])
    np.testing.assert_allclose(measure_timed_peaks(curve, law).speed[:, 0], [2.0, 6.0])


def test_a_check_names_its_joint_and_where_its_peak_is() -> None:
    rows = np.zeros((3, 2))
    rows[:, 0], rows[:, 1] = [0.0, 0.1, 0.2], [0.0, 1.0, 3.0]
    curve = Curve(np.arange(3.0), rows, np.array([[0.1, 1.0], [0.1, 1.0], [0.1, 3.0]]))
    law = TimeLaw(np.array([0.0, 2.0]), np.array([0.0, 2.0]), np.ones(2))
    motion = Motion(_robot(2, np.array([10.0, 2.5]), 8.0), Scene(), curve, law, samples=np.linspace(0.0, 2.0, 11))
    checks = _checks(motion)
    for kind, s in (("speed", 1.0), ("exported", 1.8)):
        where = checks[f"limits.{kind}"].where
        assert where is not None
        assert (where.s, where.time_s, where.names) == (pytest.approx(s), pytest.approx(s), ("joint1",))
    assert list(checks) == ["limits.speed", "limits.acceleration", "limits.exported", "limits.rest"]
    assert [checks[f"limits.{kind}"].limit for kind in ("speed", "acceleration", "exported")] == [1.0] * 3
    assert checks["limits.speed"].text == "joint1 reaches 120.0 % of its speed limit"
    assert checks["limits.acceleration"].text == "joint1 reaches 25.0 % of its acceleration limit"
    assert checks["limits.exported"].text == "joint1 reaches 112.0 % of its speed limit between exported samples"


def test_exported_speeds_are_differences_of_positions_over_those_of_times() -> None:
    law = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.25, 1.0]), np.array([0.0, 0.5, 1.0]))
    found = measure_exported_speeds(LINE, law, np.array([0.0, 0.25, 1.0]))
    np.testing.assert_allclose(found, [[0.25], [0.75]], rtol=1e-12)
    back = Curve(LINE.knots, -LINE.positions, -LINE.tangents)
    np.testing.assert_allclose(measure_exported_speeds(back, law, np.array([0.0, 0.25, 1.0])), found, rtol=1e-12)


def test_what_rounding_makes_of_close_samples_is_no_speed() -> None:
    # Positions near 3000, path parameters near 700, times near 100 s: each may be the one whose last places show.
    for offset, start, pace, way in (
        (3000.0, 0.0, 1.0, 1.0), (-3000.0, 0.0, 1.0, 1.0), (0.0, 700.0, 1.0, 1.0), (0.0, 700.0, 1.0, -1.0),
        (0.0, 0.0, 0.01, -1.0),
    ):  # fmt: skip
        knots = start + np.arange(2.0)
        curve = Curve(knots, offset + way * LINE.positions, way * LINE.tangents)
        law = TimeLaw(np.arange(2.0) / pace, knots, np.full(2, pace))
        samples = np.unique(np.concatenate([knots, start + 0.99 + 1e-11 * np.arange(50)]))
        assert measure_exported_speeds(curve, law, samples).max() <= pace * (1.0 + 1e-9)
        # And no more than that is forgiven: ten times the distance is ten times the speed, but for the last places.
        fast = measure_exported_speeds(curve, TimeLaw(0.1 * law.times, knots, 10.0 * law.speed), samples)
        assert fast[[0, -1]].min() >= 9.9999 * pace
    one = measure_exported_speeds(
        LINE, TimeLaw(np.arange(2.0), np.arange(2.0), np.ones(2)), np.array([0.0, 1e-12, 1.0])
    )
    assert 0.98 < one[0, 0] <= 1.0


def test_samples_that_are_faster_than_the_limit_are_refused_however_the_law_explains_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    law = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.ones(2))
    motion = Motion(_robot(1, 1.0), Scene(), LINE, law, samples=np.linspace(0.0, 1.0, 11))
    assert _checks(motion)["limits.exported"].ok
    monkeypatch.setattr("service.verify.limits.find_times", lambda law, s: s * (1.0 - 3e-6))
    check = _checks(motion)["limits.exported"]
    assert not check.ok
    assert check.value == pytest.approx(1.0 + 3e-6, abs=1e-9)
    monkeypatch.setattr("service.verify.limits.find_times", lambda law, s: np.minimum(s, 0.5))  # repeated times
    assert _checks(motion)["limits.exported"].value == np.inf
    still = replace(motion, curve=Curve(LINE.knots, np.zeros((2, 1)), np.zeros((2, 1))))
    assert _checks(still)["limits.exported"].value == 0.0


def test_one_joint_that_moves_where_the_robot_should_rest_is_enough() -> None:
    rows = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, -1.0]])
    curve = Curve(np.arange(2.0), rows, np.array([[0.0, 0.0, -3e-6], [0.0, 0.0, 0.0]]))
    check = _checks(Motion(_robot(3), Scene(), curve, TimeLaw(np.arange(2.0), np.arange(2.0), np.ones(2))))
    assert check["limits.rest"].value == pytest.approx(3e-6)
    assert not check["limits.rest"].ok
    assert check["limits.rest"].where is not None
    assert check["limits.rest"].where.s == 0.0
    turned = Curve(np.arange(2.0), rows, np.array([[0.0, 0.0, 0.0], [0.0, 9e-7, 0.0]]))
    check = _checks(Motion(_robot(3), Scene(), turned, TimeLaw(np.arange(2.0), np.arange(2.0), np.ones(2))))
    assert check["limits.rest"].ok
    assert check["limits.rest"].where is not None
    assert check["limits.rest"].where.s == 1.0
    faster = replace(turned, tangents=-4.0 / 3.0 * turned.tangents)
    check = _checks(Motion(_robot(3), Scene(), faster, TimeLaw(np.arange(2.0), np.arange(2.0), np.ones(2))))
    assert not check["limits.rest"].ok


def test_speed_hidden_between_grid_points_where_contacts_change_is_found() -> None:
    # At rest at 0, ever faster from there: a hundredth of the way on, the speed is a tenth of the last.
    law = TimeLaw(np.array([0.0, 4.0]), np.array([0.0, 1.0]), np.array([0.0, 0.5]))
    planted = (PlantedContact("joint0", np.eye(4), np.zeros((1, 3))),)
    phases = (Phase("a", 0.0, 0.01, contacts=planted), Phase("b", 0.01, 1.0))
    curve = Curve(LINE.knots, 1e-5 * LINE.positions, 1e-5 * LINE.tangents)
    assert not _checks(Motion(_robot(1), Scene(), curve, law, phases))["limits.rest"].ok
    still = Curve(LINE.knots, LINE.positions, np.zeros((2, 1)))
    check = _checks(Motion(_robot(1), Scene(), still, law, phases))["limits.rest"]
    assert check.value == pytest.approx((6 * 0.01 - 6 * 0.01**2) * 0.05)


def _lie(rng: np.random.Generator, law: TimeLaw) -> TimeLaw:
    """The law with something done to it that may let the robot go faster than the speeds say."""
    times, path, speed = law.times.copy(), law.path.copy(), law.speed.copy()
    size = 10.0 ** rng.uniform(-13.0, -2.0)
    kind = rng.integers(7)
    steps = np.diff(times)
    if kind == 0:  # all steps a little short
        times = np.append(0.0, np.cumsum(steps * (1.0 - size)))
    elif kind == 1:  # jitter of the times
        times = np.append(0.0, np.cumsum(steps * (1.0 + size * rng.normal(size=len(steps)))))
    elif kind == 2:  # jitter of the path
        path[1:-1] = np.sort(path[1:-1] + size * rng.normal(size=len(path) - 2) * np.diff(path)[1:])
    elif kind == 3:  # speeds that claim less
        speed *= 1.0 - size
    elif kind == 4:  # some steps of 1e-12 s, and what they skip
        chosen = rng.random(len(steps)) < 0.1
        times = np.append(0.0, np.cumsum(np.where(chosen, 1e-12, steps)))
    elif kind == 5:  # a step of 1e-12 s put in, with a leap of the path
        at = int(rng.integers(1, len(times) - 1))
        leap = size * (path[at + 1] - path[at])
        times, path = np.insert(times, at + 1, times[at] + 1e-12), np.insert(path, at + 1, path[at] + leap)
        speed = np.insert(speed, at + 1, speed[at])
    else:  # repeated times
        at = int(rng.integers(1, len(times) - 1))
        times = np.insert(times, at, times[at])
        path, speed = np.insert(path, at, path[at]), np.insert(speed, at, speed[at])
    return TimeLaw(times, path, speed)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_no_certified_law_executes_or_exports_more_than_its_speed_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curve = random_curve(rng, 2, int(rng.integers(2, 5)))
    curve.tangents[[0, -1]] = 0.0
    inner = np.linspace(curve.knots[0], curve.knots[-1], int(10.0 ** rng.uniform(0.5, 4.0)) + 2)
    path = np.unique(np.concatenate([curve.knots, inner]))
    honest = _law(path, rng.uniform(0.2, 1.0) * (1.0 + 0.1 * rng.random(len(path))))
    limit = measure_timed_peaks(curve, honest).speed.max(axis=0)
    samples = np.unique(np.concatenate([curve.knots, rng.choice(path, size=min(len(path), 50))]))
    motion = Motion(_robot(2, limit), Scene(), curve, honest, samples=samples)
    assert all(check.ok for check in _checks(motion).values())
    law = _lie(rng, honest)
    try:
        if not all(check.ok for check in _checks(replace(motion, law=law)).values()):
            return
    except VerifyError:
        return
    # What a reader of times and positions sees, at the law's points, at the samples and densely in time.
    dense = np.linspace(0.0, law.times[-1], 5001)
    step = np.clip(np.searchsorted(law.times, dense, side="right") - 1, 0, len(law.times) - 2)
    share = (dense - law.times[step]) / np.diff(law.times)[step]
    rise = law.speed[step] * share + 0.5 * np.diff(law.speed)[step] * share**2
    along = law.path[step] + np.diff(law.path)[step] * rise / (0.5 * (law.speed[step] + law.speed[step + 1]))
    for times, s in ((law.times, law.path), (find_times(law, samples), samples), (dense, along)):
        moved, took = np.abs(np.diff(curve(s), axis=0)), np.diff(times)[:, None]
        rounding = 1e-14 * (1.0 + np.abs(curve(s)).max() + np.abs(curve(s, 1)).max() * s[-1] + limit * times[-1])
        assert np.all(moved <= limit * took * (1.0 + 1.01 * TOLERANCE) + rounding)
