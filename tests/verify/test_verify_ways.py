"""Ways of frames and of joints: proven along the whole curve, and refuted where a motion leaves them or stops short."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import dense_points, robot_of

from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.verify import Basis, Check, JointWayTarget, Motion, Phase, Target, VerifyError, WayTarget, verify

X, Z = np.eye(3)[0], np.eye(3)[2]
LENGTH = 0.5  # of the link behind the turning joint [m]


def portal() -> RobotModel:
    """Two slides along x and y that carry a joint about z with a link along x, whose end is the frame ``tip``."""
    model = pin.Model()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    y = model.addJoint(x, pin.JointModelPY(), pin.SE3.Identity(), "y")
    turn = model.addJoint(y, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(turn, pin.Inertia(1.0, np.zeros(3), 1e-2 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", turn, 0, pin.SE3(np.eye(3), LENGTH * X), pin.FrameType.OP_FRAME))
    return robot_of(model, [])


def line(**more: object) -> WayTarget:
    """The tip moves 1 m along x from (0.5, 0, 0), its axes the world's."""
    way = WayTarget("tip", LENGTH * X, np.eye(3), np.zeros(3), Z, 0.0, X, np.zeros(3), 1e-3, 1e-2)
    return replace(way, **more)  # type: ignore[arg-type]


def arc(angle: float = 1.5, **more: object) -> WayTarget:
    """The tip is carried about the z axis, and turns along."""
    way = WayTarget("tip", LENGTH * X, np.eye(3), np.zeros(3), Z, angle, np.zeros(3), angle * Z, 1e-3, 1e-2)
    return replace(way, **more)  # type: ignore[arg-type]


def check(
    positions: list[list[float]], target: Target, tangents: list[list[float]] | None = None, law: TimeLaw | None = None
) -> dict[str, Check]:
    """The checks of a motion through joint positions (x, y, turn), by what comes after the target's name."""
    slopes = np.zeros((len(positions), 3)) if tangents is None else np.array(tangents, dtype=float)
    curve = Curve(np.arange(float(len(positions))), np.array(positions, dtype=float), slopes)
    phase = Phase("go", 0.0, len(positions) - 1.0, targets=(target,))
    motion = Motion(portal(), Scene(()), curve, law, (phase,))
    made = {check.name: check for check in verify(motion).checks if check.name.startswith(("way.", "joint_way."))}
    return {name.removeprefix("way.go.tip").removeprefix("joint_way.go.joint0"): own for name, own in made.items()}


def test_a_slide_along_the_line_is_proven() -> None:
    checks = check([[0, 0, 0], [1, 0, 0]], line())
    assert {name: own.ok for name, own in checks.items()} == {"": True, ".rotation": True, ".progress": True}
    assert all(own.basis is Basis.PROOF for own in checks.values())
    assert checks[""].value < 1e-4


def test_a_turn_about_the_axis_is_proven_to_follow_the_arc() -> None:
    checks = check([[0, 0, 0], [0, 0, 1.5]], arc())
    assert all(own.ok and own.basis is Basis.PROOF for own in checks.values())
    assert checks[""].value < 1e-3


def test_a_motion_that_bulges_between_its_waypoints_is_refuted() -> None:
    checks = check([[0, 0, 0], [1, 0, 0]], line(), [[0, 0.05, 0], [0, -0.05, 0]])
    assert not checks[""].ok
    assert "off its way" in checks[""].text


def test_a_frame_that_turns_off_its_way_is_refuted() -> None:
    # The tip stays on its line while the link turns: x follows the cosine, y the sine.
    angle = np.linspace(0.0, 0.3, 30)
    share = angle / 0.3
    positions = np.stack([share + LENGTH * (1.0 - np.cos(angle)), -LENGTH * np.sin(angle), angle], axis=1)
    checks = check(positions.tolist(), line(), np.gradient(positions, axis=0).tolist())
    assert checks[""].ok
    assert not checks[".rotation"].ok
    assert check(positions.tolist(), line(free_axis=Z), np.gradient(positions, axis=0).tolist())[".rotation"].ok
    assert ".rotation" not in check(positions.tolist(), line(rotation_tolerance_rad=np.inf))


@pytest.mark.parametrize("end", [0.0, 0.5, 0.99, 1.01])
def test_a_motion_that_does_another_part_of_its_way_is_refuted(end: float) -> None:
    progress = check([[0, 0, 0], [end, 0, 0]], line())[".progress"]
    assert not progress.ok
    assert f"does {100.0 * end:.1f} %" in progress.text


CREEP = [0.6 - 9e-4 * k for k in range(40)]  # less than a millimetre back from knot to knot, 35 mm in all


@pytest.mark.parametrize(
    ("places", "slopes"),
    [
        ([0.0, 0.6, 0.5, 1.0], [0.0, 0.0, 0.0, 0.0]),
        ([0.0, *CREEP, 1.0], [0.0] * 42),
        ([0.0, 0.4, 1.0], [0.0, -0.5, 0.0]),  # between two knots
    ],
)
def test_a_motion_that_goes_back_on_its_way_is_refuted(places: list[float], slopes: list[float]) -> None:
    checks = check([[x, 0, 0] for x in places], line(), [[slope, 0, 0] for slope in slopes])
    assert checks[""].ok
    assert not checks[".progress"].ok
    assert "moves back by" in checks[".progress"].text


def test_the_wrong_sense_of_a_circle_is_refuted() -> None:
    whole = 2.0 * np.pi
    way = [[0, 0, angle] for angle in np.linspace(0.0, whole, 9)]
    assert all(own.ok for own in check(way, arc(whole)).values())
    back = [[0, 0, -angle] for _, _, angle in way]
    assert not check(back, arc(whole))[".progress"].ok
    assert not check([[0, 0, 0], [0, 0, 1e-3]], arc(whole))[".progress"].ok  # a circle that is not done ends there, too


@settings(max_examples=25)
@given(seed=st.integers(0, 2**31))
def test_the_bound_is_never_below_the_distance_at_any_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = np.stack([np.linspace(0.0, 1.0, 4), *rng.uniform(-0.02, 0.02, size=(2, 4))], axis=1)
    tangents = rng.uniform(-0.3, 0.3, size=(4, 3))
    target = line(tolerance_m=0.5, rotation_tolerance_rad=3.0)
    own = check(positions.tolist(), target, tangents.tolist())[""]
    curve = Curve(np.arange(4.0), positions, tangents)
    tips = dense_points(portal().model, curve, np.linspace(0.0, 3.0, 200), 3, LENGTH * X[None])[:, 0]
    assert own.value >= np.abs(tips[:, 1]).max() - 1e-9


def run_at(speed: float, ramp: float = 0.02) -> TimeLaw:
    """One metre at a speed, with ramps at both ends; the path parameter is the way itself."""
    path = np.array([0.0, ramp, 1.0 - ramp, 1.0])
    return TimeLaw.accelerated(path, np.array([0.0, speed, speed, 0.0]))


@pytest.mark.parametrize(("speed", "is_ok"), [(0.2, True), (0.208, True), (0.22, False), (0.18, False)])
def test_a_speed_within_five_percent_is_kept(speed: float, is_ok: bool) -> None:
    slope = [[1, 0, 0], [1, 0, 0]]
    target = line(speed_m_s=0.2, ramp_m=0.03)
    own = check([[0, 0, 0], [1, 0, 0]], target, slope, run_at(speed))[".speed"]
    assert own.ok is is_ok
    assert own.basis is Basis.SAMPLES
    assert own.value == pytest.approx(abs(speed / 0.2 - 1.0), abs=1e-3)


def joint_way(**more: object) -> JointWayTarget:
    first, last = np.zeros(2), np.array([0.4, -0.2])
    return replace(JointWayTarget(("joint0", "joint1"), first, last, 1e-4), **more)  # type: ignore[arg-type]


def test_joints_on_a_straight_line_are_proven_and_others_refuted() -> None:
    straight = check([[0, 0, 0], [0.4, -0.2, 0]], joint_way())
    assert straight[""].ok
    assert straight[""].basis is Basis.PROOF
    bent = check([[0, 0, 0], [0.4, -0.2, 0]], joint_way(), [[0.0, 0.1, 0], [0, 0, 0]])
    assert not bent[""].ok
    assert not check([[0, 0, 0], [0.3, -0.15, 0]], joint_way())[".end"].ok
    assert not check([[0, 0, 0], [0.1, 0, 0]], joint_way(last=np.zeros(2)))[""].ok


def test_the_cubic_profile_is_that_of_a_curve_whose_parameter_runs_evenly() -> None:
    even = TimeLaw.accelerated(np.array([0.0, 1e-5, 1.0 - 1e-5, 1.0]), np.array([0.0, 1.0, 1.0, 0.0]))
    law = TimeLaw(even.times * (2.0 / even.times[-1]), even.path, even.speed * even.times[-1] / 2.0)
    way = [[0, 0, 0], [0.4, -0.2, 0]]
    own = check(way, joint_way(profile="cubic", duration_s=2.0), None, law)
    assert own[".profile"].ok
    assert own[".duration"].ok
    assert not check(way, joint_way(profile="quintic", duration_s=2.0), None, law)[".profile"].ok
    assert not check(way, joint_way(duration_s=2.5), None, law)[".duration"].ok


@pytest.mark.parametrize(
    "wrong",
    [
        line(axis=2.0 * Z),
        line(tolerance_m=-1.0),
        line(tolerance_m=np.nan),
        line(shift=np.array([np.nan, 0.0, 0.0])),
        line(rotation=2.0 * np.eye(3)),
        joint_way(last=np.zeros(3)),
    ],
)
def test_a_malformed_way_is_rejected(wrong: Target) -> None:
    with pytest.raises(VerifyError):
        check([[0, 0, 0], [1, 0, 0]], wrong)
