"""Balance, planted feet, targets and limits: bounds hold on the whole curve and violations are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import dense_points, floating_joint, random_curve, random_model, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.verify import (
    AxisTarget,
    Basis,
    Check,
    CircleTarget,
    JointTarget,
    Motion,
    Phase,
    PlantedContact,
    PoseTarget,
    SupportPolygon,
    VerifyError,
    verify,
)
from service.verify.limits import measure_timed_peaks

SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


def _check(motion: Motion, name: str) -> Check:
    (found,) = [check for check in verify(motion).checks if check.name == name]
    return found


def _turning_arm(length: float = 0.5) -> RobotModel:
    """One joint about z; the frame ``tip`` at its end looks along the arm, and the mass sits there."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    tip = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.appendBodyToJoint(joint, pin.Inertia(2.0, tip.translation, 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    return robot_of(model, [])


def _quarter_turn(**promises: object) -> Motion:
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [0.5 * np.pi]]), np.full((2, 1), 0.5 * np.pi))
    return Motion(_turning_arm(), Scene(), curve, phases=(Phase("turn", 0.0, 1.0, **promises),))  # type: ignore[arg-type]


def test_the_balance_margin_of_a_turning_mass_is_bounded_between_the_knots() -> None:
    # The mass moves on a quarter circle of 0.5 m; only half-way does it leave the polygon x + y <= 0.7 by 7 mm.
    wide = np.array([[-1.0, -1.0], [1.7, -1.0], [-1.0, 1.7]])
    check = _check(_quarter_turn(support=SupportPolygon(wide)), "balance.turn")
    assert not check.ok
    assert check.value == pytest.approx((0.7 - 0.5 * np.sqrt(2.0)) / np.sqrt(2.0), abs=1e-4)
    wider = wide + np.array([0.0, 0.02])
    check = _check(_quarter_turn(support=SupportPolygon(wider)), "balance.turn")
    assert check.ok
    assert check.basis is Basis.PROOF
    assert 0.0 <= check.value <= (0.72 - 0.5 * np.sqrt(2.0)) / np.sqrt(2.0)
    strict = _check(_quarter_turn(support=SupportPolygon(wider, margin_m=0.02)), "balance.turn")
    assert not strict.ok


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_proven_balance_margin_holds_at_dense_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, 4, is_floating=True, branches=True)
    curve = random_curve(rng, model.nq, 3, size=0.3, spread=0.2)
    motion = Motion(robot_of(model, [], is_floating=True), Scene(), curve)
    data = model.createData()
    dense = np.linspace(curve.knots[0], curve.knots[-1], 301)
    masses = np.array([pin.centerOfMass(model, data, q).copy() for q in curve(dense)])[:, :2]
    polygon = masses.mean(axis=0) + SQUARE * 40.0 * np.abs(masses - masses.mean(axis=0)).max()
    motion = replace(motion, phases=(Phase("p", curve.knots[0], curve.knots[-1], support=SupportPolygon(polygon)),))
    check = _check(motion, "balance.p")
    inside = np.minimum(polygon[2] - masses, masses - polygon[0]).min()
    assert check.basis is Basis.PROOF
    assert inside - 0.02 <= check.value <= inside + 1e-9


def test_a_foot_that_moves_only_between_the_knots_is_found() -> None:
    # Both knots hold the same angle; the tangents turn the foot by 0.02 / 4 and back.
    curve = Curve(np.array([0.0, 1.0]), np.zeros((2, 1)), np.array([[0.02], [-0.02]]))
    sole = np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    pose = np.eye(4)
    pose[0, 3] = 0.5
    drift = 0.55 * 2.0 * np.sin(0.5 * 0.02 / 4.0)
    for tolerance, expected in ((1.02 * drift, True), (0.98 * drift, False)):
        contact = PlantedContact("tip", pose, sole, tolerance_m=tolerance)
        motion = Motion(_turning_arm(), Scene(), curve, phases=(Phase("stand", 0.0, 1.0, contacts=(contact,)),))
        check = _check(motion, "planted.stand.tip")
        assert check.ok is expected
        assert check.value == pytest.approx(drift, rel=0.06)
        assert _check(motion, "planted.stand.tip.waypoints").ok


def test_a_foot_that_is_off_at_a_knot_fails_the_finer_tolerance() -> None:
    curve = Curve(np.arange(3.0), np.array([[0.0], [0.001], [0.0]]), np.zeros((3, 1)))
    pose = np.eye(4)
    pose[0, 3] = 0.5
    contact = PlantedContact("tip", pose, np.zeros((1, 3)))
    motion = Motion(_turning_arm(), Scene(), curve, phases=(Phase("stand", 0.0, 2.0, contacts=(contact,)),))
    assert _check(motion, "planted.stand.tip").ok
    at_knots = _check(motion, "planted.stand.tip.waypoints")
    assert not at_knots.ok
    assert at_knots.value == pytest.approx(0.0005, rel=1e-3)
    assert at_knots.where is not None
    assert at_knots.where.s == 1.0


def test_a_circle_is_followed_between_the_knots() -> None:
    circle = CircleTarget("tip", np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.5, 1e-3, np.array([0.0, 0.0, 1.0]), 0.01)
    motion = _quarter_turn(targets=(circle,))
    check = _check(motion, "circle.turn.tip")
    assert check.ok
    assert check.basis is Basis.PROOF
    assert _check(motion, "axis.turn.tip").ok
    # A chord of the circle instead of the arc: right at both knots, 146 mm off half-way.
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.addJoint(1, pin.JointModelPY(), pin.SE3.Identity(), "y")
    model.addFrame(pin.Frame("tip", 2, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    chord = Curve(np.array([0.0, 1.0]), np.array([[0.5, 0.0], [0.0, 0.5]]), np.tile([-0.5, 0.5], (2, 1)))
    check = _check(
        Motion(robot_of(model, []), Scene(), chord, phases=(Phase("turn", 0.0, 1.0, targets=(circle,)),)),
        "circle.turn.tip",
    )
    assert not check.ok
    assert check.value == pytest.approx(0.5 - np.sqrt(0.125), abs=1e-6)


@pytest.mark.parametrize(("first", "last"), [(0.4994, 0.5003), (0.5003, 0.4994), (0.5, 0.5009), (0.4992, 0.4999)])
def test_a_tip_that_moves_towards_the_middle_is_off_its_circle_by_what_its_ends_are(first: float, last: float) -> None:
    # the line goes on to the middle of the circle, the tip does not
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.addFrame(pin.Frame("tip", 1, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    line = Curve(np.array([0.0, 1.0]), np.array([[first], [last]]), np.full((2, 1), last - first))
    circle = CircleTarget("tip", np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.5, 1e-3)
    motion = Motion(robot_of(model, []), Scene(), line, phases=(Phase("turn", 0.0, 1.0, targets=(circle,)),))
    check = _check(motion, "circle.turn.tip")
    assert check.ok
    assert check.value == pytest.approx(max(abs(first - 0.5), abs(last - 0.5)), abs=1e-5)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_proven_path_errors_hold_at_dense_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, 4, is_floating=False, branches=False)
    curve = random_curve(rng, model.nq, 2, spread=0.2)
    frame = f"frame{model.njoints - 1}"
    s = np.linspace(curve.knots[0], curve.knots[-1], 201)
    path = dense_points(model, curve, s, model.njoints - 1, np.array([np.zeros(3), *np.eye(3)]))
    origin, axes = path[:, 0], path[:, 1:] - path[:, :1]
    centre, axis = origin[0] + rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    height = (origin - centre) @ axis
    flat = np.linalg.norm(origin - centre - height[:, None] * axis, axis=1)
    off_circle = np.hypot(height, flat - 0.4)
    lean = np.arccos(np.clip(axes[:, 2] @ axes[0, 2], -1.0, 1.0))
    shift = np.linalg.norm(origin - origin[0], axis=1)
    turned = np.einsum("sij,kj->sik", axes, axes[0])  # rows: axes at s in the axes of the start
    turn = np.arccos(np.clip(0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    targets = (
        CircleTarget(frame, centre, axis, 0.4, 10.0),
        AxisTarget(frame, np.array([0.0, 0.0, 1.0]), axes[0, 2], 3.1),
        PoseTarget(frame, origin[0], axes[0].T, np.full(3, 10.0), np.full(3, np.pi)),
    )
    motion = Motion(
        robot_of(model, []), Scene(), curve, phases=(Phase("p", curve.knots[0], curve.knots[-1], targets=targets),)
    )
    certificate = {check.name: check for check in verify(motion).checks}
    assert off_circle.max() <= certificate[f"circle.p.{frame}"].value + 1e-9
    assert lean.max() <= certificate[f"axis.p.{frame}"].value + 1e-9
    assert shift.max() <= certificate[f"target.p.{frame}"].value + 1e-9
    assert turn.max() <= certificate[f"target.p.{frame}.rotation"].value + 1e-7


def test_a_pose_is_reached_at_its_moment_only() -> None:
    place = np.array([0.0, 0.5, 0.0])
    turned = pin.exp3(np.array([0.0, 0.0, 0.5 * np.pi]))
    goal = PoseTarget("tip", place, turned, np.full(3, 1e-6), np.full(3, 1e-6), at=1.0)
    motion = _quarter_turn(targets=(goal,))
    assert _check(motion, "target.turn.tip").ok
    assert _check(motion, "target.turn.tip.rotation").ok
    early = replace(goal, at=0.9)
    late = replace(motion, phases=(replace(motion.phases[0], targets=(early,)),))
    assert not _check(late, "target.turn.tip").ok
    assert not _check(late, "target.turn.tip.rotation").ok


def test_a_turn_by_half_a_revolution_is_no_small_rotation_error() -> None:
    flipped = pin.exp3(np.array([0.0, 0.0, -0.5 * np.pi]))
    goal = PoseTarget("tip", np.zeros(3), flipped, np.full(3, np.inf), np.full(3, 0.1), at=1.0)
    assert not _check(_quarter_turn(targets=(goal,)), "target.turn.tip.rotation").ok


def test_a_joint_target_is_read_off_the_curve() -> None:
    good, bad = JointTarget("joint0", 0.5 * np.pi, 1e-9, 1.0), JointTarget("joint0", 1.0, 0.1, 1.0)
    assert _check(_quarter_turn(targets=(good,)), "target.turn.joint0").ok
    assert not _check(_quarter_turn(targets=(bad,)), "target.turn.joint0").ok


def test_an_unknown_frame_is_refused_by_name() -> None:
    with pytest.raises(VerifyError, match="unknown frame 'tap'"):
        verify(_quarter_turn(targets=(AxisTarget("tap", np.eye(3)[2], np.eye(3)[2], 0.1),)))


def test_a_joint_that_leaves_its_limits_only_between_the_knots_is_found() -> None:
    robot = _turning_arm()
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.9], [0.9]]), np.array([[1.0], [-1.0]]))
    peak = 0.9 + 0.25
    for limit, expected in ((peak + 1e-6, True), (peak - 1e-6, False)):
        query = replace(robot, lower=np.array([-limit]), upper=np.array([limit]))
        check = _check(Motion(query, Scene(), curve), "limits.position")
        assert check.ok is expected
        assert check.value == pytest.approx(peak - limit, abs=1e-9)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_timed_peaks_hold_at_dense_samples_and_accelerations_are_reached(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curve = random_curve(rng, 3, 4)
    path = np.unique(np.concatenate([curve.knots, rng.uniform(curve.knots[0], curve.knots[-1], 5)]))
    if rng.random() < 0.5:
        path = path[np.isin(path, curve.knots[1:-1], invert=True)]  # cells that run across knots
    speed = rng.uniform(0.1, 1.0, len(path))
    times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(path) / (speed[:-1] + speed[1:]))])
    law = TimeLaw(times, path, speed)
    peaks = measure_timed_peaks(curve, law)
    # Cells may be far shorter than others: each is sampled, just inside of its ends.
    inside = np.linspace(1e-6, 1.0 - 1e-6, 2001)
    s, ds, dds = law.at((times[:-1, None] + np.diff(times)[:, None] * inside).ravel())
    velocity = curve(s, 1) * ds[:, None]
    acceleration = curve(s, 1) * dds[:, None] + curve(s, 2) * (ds**2)[:, None]
    assert np.all(np.abs(velocity).max(axis=0) <= peaks.speed.max(axis=0) + 1e-9)
    found, bound = np.abs(acceleration).max(axis=0), peaks.acceleration.max(axis=0)
    assert np.all(found <= bound + 1e-9)
    assert np.all(found >= 0.98 * bound - 1e-3)


def test_a_robot_that_moves_at_the_end_or_where_contacts_change_is_found() -> None:
    curve = Curve(np.arange(3.0), np.array([[0.0], [0.5], [1.0]]), np.array([[0.0], [0.5], [0.0]]))
    law = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]), np.ones(3))
    motion = Motion(_turning_arm(), Scene(), curve, law)
    assert _check(motion, "limits.rest").ok
    pose = np.eye(4)
    contact = PlantedContact("tip", pose, np.zeros((1, 3)), 10.0, 10.0)
    change = (Phase("a", 0.0, 1.0, contacts=(contact,)), Phase("b", 1.0, 2.0))
    check = _check(replace(motion, phases=change), "limits.rest")
    assert not check.ok
    assert check.value == pytest.approx(0.5)


def test_speed_and_acceleration_beyond_the_limits_are_named() -> None:
    curve = Curve(np.arange(2.0), np.array([[0.0], [1.0]]), np.zeros((2, 1)))
    law = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.ones(2))
    robot = replace(_turning_arm(), velocity=np.array([1.4]), acceleration=np.array([5.9]))
    certificate = {check.name: check for check in verify(Motion(robot, Scene(), curve, law)).checks}
    assert certificate["limits.speed"].value == pytest.approx(1.5 / 1.4)
    assert certificate["limits.acceleration"].value == pytest.approx(6.0 / 5.9)
    assert not certificate["limits.speed"].ok
    assert not certificate["limits.acceleration"].ok


def test_an_inconsistent_law_is_refused() -> None:
    curve = Curve(np.arange(2.0), np.array([[0.0], [1.0]]), np.zeros((2, 1)))
    law = TimeLaw(np.array([0.0, 3.0]), np.array([0.0, 1.0]), np.ones(2))
    with pytest.raises(VerifyError, match="does not follow"):
        verify(Motion(_turning_arm(), Scene(), curve, law))


def _cart(height: float = 1.0) -> RobotModel:
    """A floating mass of 10 kg whose centre is ``height`` above its foot, the frame ``foot``."""
    model = pin.Model()
    base = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(10.0, np.array([0.0, 0.0, height]), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("foot", base, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return robot_of(model, [], is_floating=True)


def test_the_zmp_of_an_accelerated_mass_is_that_of_the_cart_table() -> None:
    # x = 0.05 s, s from rest with ds/dt = t: zmp_x = x - h/g * 0.05.
    positions = np.zeros((2, 6))
    positions[1, 0] = 0.05
    curve = Curve(np.arange(2.0), positions, np.tile(positions[1], (2, 1)))
    law = TimeLaw(np.array([0.0, np.sqrt(2.0)]), np.array([0.0, 1.0]), np.array([0.0, np.sqrt(2.0)]))
    support = SupportPolygon(SQUARE)
    motion = Motion(_cart(), Scene(), curve, law, phases=(Phase("p", 0.0, 1.0, support=support),))
    check = _check(motion, "zmp.p")
    assert check.basis is Basis.SAMPLES
    start, end = -0.05 / 9.81, 0.05 - 0.05 / 9.81
    assert check.value == pytest.approx(0.1 - max(abs(start), end), abs=1e-6)
    faster = TimeLaw(law.times / 5.0, law.path, law.speed * 5.0)
    assert not _check(replace(motion, law=faster), "zmp.p").ok


def test_the_ground_carries_the_robot_so_that_planted_legs_do_not_hold_up_the_base() -> None:
    # A leg below a 10 kg base: without the ground's force the hip would carry only the leg.
    model = pin.Model()
    base = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(10.0, np.array([0.1, 0.0, 0.0]), 0.1 * np.eye(3)), pin.SE3.Identity())
    hip = model.addJoint(base, pin.JointModelRY(), pin.SE3.Identity(), "hip")
    foot = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    model.addFrame(pin.Frame("foot", hip, 0, foot, pin.FrameType.OP_FRAME))
    robot = robot_of(model, [], is_floating=True)
    positions = np.zeros((2, 7))
    positions[:, 0], positions[:, 2] = 0.3, 1.0
    curve = Curve(np.arange(2.0), positions, np.zeros((2, 7)))
    law = TimeLaw(np.arange(2.0), np.arange(2.0), np.ones(2))
    pose = np.eye(4)
    pose[0, 3] = 0.3
    contact = PlantedContact("foot", pose, SQUARE @ np.eye(2, 3))
    phase = Phase("stand", 0.0, 1.0, contacts=(contact,), support=SupportPolygon(SQUARE * 5.0))
    check = _check(Motion(robot, Scene(), curve, law, phases=(phase,)), "torque.stand")
    assert check.value * 1e3 == pytest.approx(10.0 * 9.81 * 0.1, rel=1e-6)
