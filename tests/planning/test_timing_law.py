"""Timing: limits hold on both sides of every knot, rests are kept, and slowing restores balance."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import floating_joint, random_curve, random_model, robot_of

from benchmarks.planning.timing_reference import chain, fastest_duration, spline_through, timing_problems
from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.motion.timing import TimingError, TimingSettings, slow_until_zmp_inside, time_curve
from service.verify import Motion, Phase, SupportPolygon, verify
from service.verify.limits import measure_timed_peaks

SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


def _robot(n: int, velocity: float = 1.0, acceleration: float = 2.0) -> RobotModel:
    model = random_model(np.random.default_rng(n), n, is_floating=False, branches=False)
    robot = robot_of(model, [])
    return replace(robot, velocity=np.full(n, velocity), acceleration=np.full(n, acceleration))


def _dense(curve: Curve, law: TimeLaw, count: int = 20001) -> tuple[np.ndarray, np.ndarray]:
    s, speed, gain = law.at(np.linspace(0.0, law.times[-1], count)[:-1])
    velocity = curve(s, 1) * speed[:, None]
    return velocity, curve(s, 1) * gain[:, None] + curve(s, 2) * (speed**2)[:, None]


def test_a_straight_line_takes_the_time_of_the_trapezoid() -> None:
    # 2 rad at 1 rad/s and 2 rad/s^2: half a second to get up to speed, as much to stop, 1.5 s between.
    curve = Curve(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 2.0, 21)[:, None], np.full((21, 1), 2.0))
    law = time_curve(_robot(1), curve)
    assert law.times[-1] == pytest.approx(2.5, rel=0.01)
    assert law.times[-1] >= 2.5 - 1e-9


@pytest.mark.parametrize("n_waypoints", [2, 3, 5, 8, 12, 20, 30])
@pytest.mark.parametrize(("velocity", "acceleration"), [(0.5, 10.0), (0.5, 3.0), (0.5, 0.5)])
def test_a_plan_along_a_line_takes_at_most_four_percent_longer_than_the_trapezoid(
    n_waypoints: int, velocity: float, acceleration: float
) -> None:
    robot = chain(np.array([velocity]), np.array([acceleration]))
    law = time_curve(robot, spline_through(robot, np.linspace(0.0, 2.0, n_waypoints)[:, None]))
    fastest = 2.0 / velocity + velocity / acceleration
    assert fastest - 1e-9 <= law.times[-1] <= 1.04 * fastest


def test_laws_of_random_plans_are_within_six_percent_of_the_fastest() -> None:
    ratios = []
    for problem in islice(timing_problems(1), 15):
        robot, curve = problem.robot, problem.curve
        fastest = fastest_duration(curve, robot.velocity, robot.acceleration, cells=30)
        ratios.append(time_curve(robot, curve).times[-1] / fastest)
    assert max(ratios) < 1.06
    assert np.mean(ratios) < 1.03
    assert min(ratios) > 0.995  # the reference's own grid


def test_a_rest_within_the_curve_costs_what_stopping_costs() -> None:
    robot = chain(np.array([1.0]), np.array([2.0]))
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [2.0]]), np.full((2, 1), 2.0))
    assert time_curve(robot, curve, [0.5]).times[-1] == pytest.approx(3.0, rel=0.005)


def test_a_short_knot_interval_does_not_slow_what_is_beside_it() -> None:
    knots = np.concatenate([np.linspace(0.0, 1.0, 21), [1.0 + 1e-4]])
    curve = Curve(knots, 2.0 * knots[:, None], np.full((22, 1), 2.0))
    law = time_curve(_robot(1), curve, [1.0])
    assert law.times[-1] == pytest.approx(2.5 + 2.0 * np.sqrt(2e-4 / 2.0), rel=0.02)


def test_scales_slow_the_line_down() -> None:
    curve = Curve(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 2.0, 21)[:, None], np.full((21, 1), 2.0))
    law = time_curve(_robot(1), curve, settings=TimingSettings(velocity_scale=0.5, acceleration_scale=0.25))
    assert law.times[-1] == pytest.approx(5.0, rel=0.01)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_limits_hold_everywhere_and_something_is_used_up(seed: int, is_steep: bool) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    curve = random_curve(rng, n, int(rng.integers(2, 9)))
    if not is_steep:
        # At rest between the knots' cubics as well: zero tangents at the ends and at one knot within.
        curve.tangents[[0, -1, len(curve.knots) // 2]] = 0.0
    robot = _robot(n)
    law = time_curve(robot, curve)
    velocity, acceleration = _dense(curve, law)
    assert np.all(np.abs(velocity) <= 1.0 + 1e-6)
    assert np.all(np.abs(acceleration) <= 2.0 + 1e-6)
    assert max(np.abs(velocity).max(), np.abs(acceleration).max() / 2.0) > 0.5
    peaks = measure_timed_peaks(curve, law)
    assert peaks.speed.max() <= 1.0 + 1e-9
    assert peaks.acceleration.max() <= 2.0 + 1e-9
    certificate = {check.name: check for check in verify(Motion(robot, Scene(), curve, law)).checks}
    assert certificate["limits.speed"].ok
    assert certificate["limits.acceleration"].ok
    assert certificate["limits.rest"].ok


def test_the_robot_rests_where_it_is_told_to() -> None:
    curve = random_curve(np.random.default_rng(2), 3, 6)
    rests = [float(curve.knots[2]), 0.5 * float(curve.knots[3] + curve.knots[4])]
    law = time_curve(_robot(3), curve, rests)
    for s in rests:
        assert law.speed[law.path == s].tolist() == [0.0]
    assert np.all(law.speed[1:-1][~np.isin(law.path[1:-1], rests)] > 0.0)


def test_a_jump_of_the_second_derivative_is_respected_on_both_sides() -> None:
    # q'' jumps from -60 to +60 at the middle knot; only a one-sided look would overrun there.
    curve = Curve(np.arange(3.0), np.array([[0.0], [0.0], [0.0]]), np.array([[10.0], [-10.0], [10.0]]))
    _, acceleration = _dense(curve, time_curve(_robot(1), curve))
    assert np.abs(acceleration).max() <= 2.0 + 1e-6


def test_a_coarse_grid_costs_little_time_where_the_second_derivative_jumps() -> None:
    # Constraints at both ends of every cell leave almost nothing for the final slowing to make up for.
    curve = Curve(np.arange(5.0), np.array([[0.0], [1.0], [0.0], [1.0], [0.0]]), np.zeros((5, 1)))
    coarse, fine = (time_curve(_robot(1), curve, settings=TimingSettings(cells_per_interval=k)) for k in (6, 40))
    assert coarse.times[-1] <= 1.1 * fine.times[-1]


def test_a_motionless_stretch_takes_no_infinite_speed() -> None:
    curve = Curve(np.arange(4.0), np.zeros((4, 2)), np.zeros((4, 2)))
    law = time_curve(_robot(2), curve)
    assert np.all(np.isfinite(law.times))
    assert 0.03 <= law.times[-1] <= 1.0


def test_torque_limits_slow_a_heavy_arm() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.array([1.0, 0.0, 0.0]), 1e-6 * np.eye(3)), pin.SE3.Identity())
    robot = replace(robot_of(model, [], limit=100.0), effort=np.array([4.0]))
    curve = Curve(np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1.0, 11)[:, None], np.ones((11, 1)))
    # 4 Nm turn 2 kg at 1 m by 2 rad/s^2: sqrt(2) s for 1 rad.
    law = time_curve(robot, curve)
    assert law.times[-1] == pytest.approx(np.sqrt(2.0), rel=0.03)
    free = time_curve(robot, curve, settings=TimingSettings(use_torques=False))
    assert free.times[-1] < 0.3


def test_a_limit_that_is_not_positive_is_refused() -> None:
    robot = replace(_robot(1), velocity=np.zeros(1))
    with pytest.raises(TimingError, match="must be positive"):
        time_curve(robot, Curve(np.arange(2.0), np.array([[0.0], [1.0]]), np.ones((2, 1))))


def _cart(height: float) -> RobotModel:
    model = pin.Model()
    base = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(10.0, np.array([0.0, 0.0, height]), 0.1 * np.eye(3)), pin.SE3.Identity())
    robot = robot_of(model, [], is_floating=True)
    return replace(robot, velocity=np.full(6, 1.0), acceleration=np.full(6, 2.0))


def _swing() -> Motion:
    """A mass 1 m above the ground that moves 6 cm to the side within its polygon."""
    positions = np.zeros((6, 6))
    positions[:, 0] = np.linspace(0.0, 0.06, 6)
    curve = Curve(np.arange(6.0), positions, np.gradient(positions, axis=0))
    robot = _cart(1.0)
    law = time_curve(robot, curve)
    support = SupportPolygon(SQUARE)
    return Motion(robot, Scene(), curve, law, phases=(Phase("swing", 0.0, 5.0, support=support),))


def test_slowing_brings_the_zmp_inside_and_no_further() -> None:
    motion = _swing()
    before = next(check for check in verify(motion).checks if check.name == "zmp.swing")
    assert not before.ok
    law = slow_until_zmp_inside(motion)
    after = next(check for check in verify(replace(motion, law=law)).checks if check.name == "zmp.swing")
    assert after.ok
    assert after.value < 0.01
    assert motion.law is not None
    assert law.times[-1] > motion.law.times[-1]


def test_slowing_leaves_alone_what_balances() -> None:
    motion = _swing()
    wide = replace(motion, phases=(replace(motion.phases[0], support=SupportPolygon(10.0 * SQUARE)),))
    assert slow_until_zmp_inside(wide) is motion.law


def test_a_robot_that_falls_even_at_rest_is_left_for_the_verifier_to_refuse() -> None:
    motion = _swing()
    away = replace(motion, phases=(replace(motion.phases[0], support=SupportPolygon(SQUARE + 1.0)),))
    assert slow_until_zmp_inside(away) is motion.law


def test_a_law_that_knows_the_polygon_keeps_the_zmp_and_is_faster_than_one_slowed_as_a_whole() -> None:
    motion = _swing()
    robot, curve, phases = motion.robot, motion.curve, motion.phases
    law = time_curve(robot, curve, settings=TimingSettings(zmp_reserve_m=0.01), phases=phases)
    own = replace(motion, law=law)
    assert slow_until_zmp_inside(own, reserve_m=0.01) is law
    check = next(check for check in verify(own).checks if check.name == "zmp.swing")
    assert 0.01 <= check.value < 0.02
    slowed = slow_until_zmp_inside(motion, reserve_m=0.01)
    assert law.times[-1] < 0.95 * slowed.times[-1]


@pytest.mark.parametrize("turn", range(4))
def test_every_edge_of_the_polygon_holds_the_zmp(turn: int) -> None:
    # The same swing towards +y, -x, -y within a polygon that is not centred, on a plane that is not at 0.
    motion = _swing()
    angle = 0.5 * np.pi * turn
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def turned(rows: np.ndarray) -> np.ndarray:
        result = rows.copy()
        result[:, :2] = rows[:, :2] @ matrix.T + (matrix @ [0.5, 0.2] if rows is motion.curve.positions else 0.0)
        return result

    curve = Curve(motion.curve.knots, turned(motion.curve.positions), turned(motion.curve.tangents))
    corners = np.array([[-0.1, -0.1], [0.1, -0.1], [0.12, 0.1], [-0.1, 0.1]])
    phase = Phase("swing", 0.0, 5.0, support=SupportPolygon((corners + np.array([0.5, 0.2])) @ matrix.T, 0.0, 0.3))
    law = time_curve(motion.robot, curve, phases=(phase,))
    plain = time_curve(motion.robot, motion.curve, phases=(replace(phase, support=SupportPolygon(corners, 0.0, 0.3)),))
    assert law.times[-1] == pytest.approx(plain.times[-1], rel=1e-9)
    moved = Motion(motion.robot, Scene(), curve, law, (phase,))
    check = next(check for check in verify(moved).checks if check.name == "zmp.swing")
    assert -1e-3 < check.value < 3e-3
    assert slow_until_zmp_inside(moved).times[-1] <= 1.05 * law.times[-1]


def test_the_reserve_gives_way_where_the_robot_rests_nearer_to_the_edge() -> None:
    # At rest the mass ends 4 mm inside: a reserve of 15 mm cannot be had there, and 2 mm are kept.
    motion = _swing()
    near = replace(motion.phases[0], support=SupportPolygon(SQUARE - [0.036, 0.0]))
    law = time_curve(motion.robot, motion.curve, settings=TimingSettings(zmp_reserve_m=0.015), phases=(near,))
    motion = replace(motion, law=law, phases=(near,))
    check = next(check for check in verify(motion).checks if check.name == "zmp.swing")
    assert 0.002 <= check.value <= 0.004
    assert slow_until_zmp_inside(motion, reserve_m=0.015) is law
    assert law.times[-1] < 5.0


def test_a_polygon_that_covers_only_part_of_a_stretch_is_left_to_the_slowing() -> None:
    motion = _swing()
    halves = (Phase("a", 0.0, 2.5), replace(motion.phases[0], name="b", first=2.5))
    law = time_curve(motion.robot, motion.curve, phases=halves)
    assert motion.law is not None
    np.testing.assert_allclose(law.times, motion.law.times)
    slowed = slow_until_zmp_inside(replace(motion, phases=halves))
    assert slowed.times[-1] > law.times[-1]


def test_torques_and_accelerations_hold_at_once_on_a_curved_path() -> None:
    rng = np.random.default_rng(5)
    model = random_model(rng, 4, is_floating=False, branches=False)
    robot = replace(robot_of(model, []), velocity=np.full(4, 5.0), acceleration=np.full(4, 30.0))
    curve = random_curve(rng, 4, 5, spread=0.6)
    still = pin.Data(model)
    weight = np.array([np.abs(pin.computeGeneralizedGravity(model, still, q)) for q in curve(np.linspace(0, 4, 50))])
    robot = replace(robot, effort=1.5 * weight.max(axis=0) + 0.5)
    law = time_curve(robot, curve)
    check = next(check for check in verify(Motion(robot, Scene(), curve, law)).checks if check.name == "torque.motion")
    assert 0.95 < check.value < 1.005
    free = time_curve(robot, curve, settings=TimingSettings(use_torques=False))
    assert free.times[-1] < 0.99 * law.times[-1]


def test_a_known_law_between_two_rests_is_kept_and_the_rest_is_timed() -> None:
    robot = chain(np.array([1.0]), np.array([2.0]))
    curve = Curve(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [2.0]]), np.zeros((3, 1)))
    fast = time_curve(robot, curve, [1.0])
    first = fast.cut(0.0, 1.0)
    assert first is not None
    slow = TimeLaw(3.0 * first.times, first.path, first.speed / 3.0)
    law = time_curve(robot, curve, [1.0], known=[slow])
    kept = law.cut(0.0, 1.0)
    assert kept is not None
    np.testing.assert_allclose(kept.times, slow.times)
    assert law.times[-1] - slow.times[-1] == pytest.approx(fast.times[-1] - first.times[-1])


def test_a_known_law_that_is_too_fast_is_slowed_to_the_limits() -> None:
    robot = chain(np.array([1.0]), np.array([2.0]))
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.zeros((2, 1)))
    law = time_curve(robot, curve)
    fast = TimeLaw(0.5 * law.times, law.path, 2.0 * law.speed)
    assert time_curve(robot, curve, known=[fast]).times[-1] >= law.times[-1] - 1e-6
