"""Clearance: what is certified is never refuted by dense sampling with another distance, and what collides is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hull_reference import sampled_gap
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import CUBE, box, random_curve, random_model, robot_of

from costs.allowance import Allowance, BodyRef
from costs.curve import Curve
from costs.robot.model import LinkBody, RobotModel
from costs.scene import ConvexPiece, Scene
from service.verify import Basis, Certificate, Motion, Phase, Status, VerifyError, VerifySettings, verify

SLIDER, WALL = BodyRef.of_link("slider"), BodyRef.of_piece("wall")


def _slider(half: tuple[float, float, float] = (0.05, 0.05, 0.05)) -> RobotModel:
    """A box that slides along x."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    vertices = CUBE * np.asarray(half)
    return robot_of(model, [LinkBody("slider", "slider", 1, vertices, vertices)])


def _spinner(length: float = 1.0) -> RobotModel:
    """A thin rod from the origin along x that turns about z."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    vertices = CUBE * np.array([length / 2, 0.01, 0.01]) + np.array([length / 2, 0.0, 0.0])
    return robot_of(model, [LinkBody("rod", "rod", 1, vertices, vertices)])


def _straight(*rows: list[float]) -> Curve:
    positions = np.array(rows, dtype=float)
    return Curve(np.arange(len(rows), dtype=float), positions, np.gradient(positions, axis=0))


def _line(*rows: list[float]) -> Curve:
    """Two knots joined linearly."""
    positions = np.array(rows, dtype=float)
    return Curve(np.arange(2.0), positions, np.tile(positions[1] - positions[0], (2, 1)))


def _clearance(certificate: Certificate) -> tuple[bool, Basis]:
    found = [check for check in certificate.checks if check.name == "clearance"]
    return all(check.ok for check in found), found[0].basis


def test_the_clearance_of_a_sliding_box_is_exact() -> None:
    motion = Motion(_slider(), Scene((box("wall", (1.0, 0.0, 0.0), (0.1, 1.0, 1.0)),)), _line([0.0], [0.8]))
    certificate = verify(motion)
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_pair == ("slider", "wall")
    assert certificate.min_clearance_m == pytest.approx(0.05, abs=1e-8)


@pytest.mark.parametrize("farther_m", [0.02, 0.04, 0.06, 0.5])
def test_a_clearance_is_told_up_to_ten_centimetres(farther_m: float) -> None:
    wall = box("wall", (1.0 + farther_m, 0.0, 0.0), (0.1, 1.0, 1.0))
    certificate = verify(Motion(_slider(), Scene((wall,)), _line([0.0], [0.8])))
    is_near = 0.05 + farther_m < 0.1
    assert certificate.min_clearance_pair == (("slider", "wall") if is_near else None)
    assert certificate.min_clearance_m == pytest.approx(0.05 + farther_m if is_near else 0.1, abs=1e-8)


def test_a_thin_wall_between_the_knots_is_seen() -> None:
    wall = box("wall", (0.5, 0.0, 0.0), (0.0005, 1.0, 1.0))
    certificate = verify(Motion(_slider(), Scene((wall,)), _line([0.0], [1.0])))
    assert certificate.status is Status.VIOLATED
    failed = certificate.failed()[0]
    assert failed.where is not None
    assert set(failed.where.names) == {"slider", "wall"}
    assert abs(failed.where.s - 0.5) < 0.06
    assert certificate.min_clearance_m < 0.0


def test_a_rod_that_swings_over_a_piece_between_two_free_knots_is_refuted() -> None:
    # Both end poses and their hull's chord are free of the piece; only the arc meets it.
    post = box("post", (0.98, 0.0, 0.0), (0.005, 0.005, 0.005))
    certificate = verify(Motion(_spinner(), Scene((post,)), _line([-0.6], [0.6])))
    assert certificate.status is Status.VIOLATED


def test_an_arc_that_passes_just_inside_a_piece_is_certified() -> None:
    post = box("post", (1.02, 0.0, 0.0), (0.005, 0.005, 0.005))
    certificate = verify(Motion(_spinner(), Scene((post,)), _line([-0.6], [0.6])))
    assert certificate.status is Status.CERTIFIED
    corner = 1.015 - np.hypot(1.0, 0.01)
    assert corner - 1e-3 <= certificate.min_clearance_m <= corner + 1e-9


def test_a_cubic_that_overshoots_between_its_knots_is_refuted() -> None:
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [0.0]]), np.array([[2.0], [-2.0]]))
    wall = box("wall", (0.5, 0.0, 0.0), (0.01, 1.0, 1.0))
    assert verify(Motion(_slider(), Scene((wall,)), curve)).status is Status.VIOLATED
    far = box("wall", (0.57, 0.0, 0.0), (0.01, 1.0, 1.0))
    certificate = verify(Motion(_slider(), Scene((far,)), curve))
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_m == pytest.approx(0.01, abs=1e-3)


def test_counter_rotating_joints_that_carry_a_bar_into_a_piece_are_refuted() -> None:
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    model.addJoint(first, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.0])), "second")
    bar = CUBE * np.array([0.01, 0.1, 0.01])
    robot = robot_of(model, [LinkBody("bar", "bar", 2, bar, bar)])
    curve = _line([-0.25, 0.25], [0.25, -0.25])
    # At both knots the bar's face is at 0.6 cos 0.25 + 0.01 = 0.591; half-way it reaches 0.61.
    hit = box("piece", (0.602 + 0.05, 0.0, 0.0), (0.05, 0.02, 0.02))
    assert verify(Motion(robot, Scene((hit,)), curve)).status is Status.VIOLATED
    free = box("piece", (0.612 + 0.05, 0.0, 0.0), (0.05, 0.02, 0.02))
    certificate = verify(Motion(robot, Scene((free,)), curve))
    assert certificate.status is Status.CERTIFIED
    assert 1e-3 <= certificate.min_clearance_m <= 2e-3 + 1e-9


def test_touching_is_neither_certified_nor_refuted() -> None:
    certificate = verify(
        Motion(_slider(), Scene((box("wall", (1.0, 0.0, 0.0), (0.1, 1.0, 1.0)),)), _line([0.0], [0.85]))
    )
    assert certificate.status is Status.FEASIBLE_AT_SAMPLES
    assert _clearance(certificate) == (True, Basis.UNPROVEN)


def test_a_touch_within_its_allowance_is_certified_and_listed() -> None:
    wall = Scene((box("wall", (1.0, 0.0, 0.0), (0.1, 1.0, 1.0)),))
    curve = _line([0.0], [0.855])
    allowed = (Phase("push", 0.0, 1.0, allowances=(Allowance(SLIDER, WALL, 0.006),)),)
    certificate = verify(Motion(_slider(), wall, curve, phases=allowed))
    assert certificate.status is Status.CERTIFIED
    assert certificate.exempt[0].pair == ("slider", "wall")
    assert certificate.exempt[0].deepest_m == pytest.approx(0.005, abs=1e-6)
    assert 0.005 - 1e-6 <= certificate.exempt[0].proven_m <= 0.006
    shallow = (Phase("push", 0.0, 1.0, allowances=(Allowance(SLIDER, WALL, 0.004),)),)
    assert verify(Motion(_slider(), wall, curve, phases=shallow)).status is Status.VIOLATED


def test_an_allowance_ends_with_its_phase() -> None:
    wall = Scene((box("wall", (1.0, 0.0, 0.0), (0.1, 1.0, 1.0)),))
    touch = (Allowance(SLIDER, WALL, 0.01),)
    curve = Curve(np.arange(4.0), np.array([[0.0], [0.855], [0.855], [0.0]]), np.zeros((4, 1)))
    good = (Phase("push", 0.0, 3.0, allowances=touch),)
    late = (Phase("push", 0.0, 2.0, allowances=touch), Phase("leave", 2.0, 3.0))
    assert verify(Motion(_slider(), wall, curve, phases=good)).status is Status.CERTIFIED
    certificate = verify(Motion(_slider(), wall, curve, phases=late))
    assert certificate.status is Status.VIOLATED
    where = certificate.failed()[0].where
    assert where is not None
    assert where.s >= 2.0


def test_two_links_that_pass_through_each_other_are_refuted() -> None:
    model = pin.Model()
    left = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "left")
    right = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "right")
    plate = CUBE * np.array([0.002, 0.1, 0.1])
    bodies = [LinkBody("left", "left", left, plate, plate), LinkBody("right", "right", right, plate, plate)]
    robot = robot_of(model, bodies)
    curve = _line([0.0, 1.0], [1.0, 0.0])
    assert verify(Motion(robot, Scene(), curve)).status is Status.VIOLATED
    together = _line([0.0, 0.1], [1.0, 1.1])
    certificate = verify(Motion(robot, Scene(), together))
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_m == pytest.approx(0.096, abs=1e-8)
    ignored = robot_of(model, bodies, ignored=frozenset({("left", "right")}))
    passed_through = verify(Motion(ignored, Scene(), curve))
    check = next(check for check in passed_through.checks if check.name == "coverage.overlap.left.right")
    assert check.value == pytest.approx(-0.004, abs=1e-4)
    assert passed_through.status is Status.FEASIBLE_AT_SAMPLES
    assert {check.name for check in passed_through.checks} >= {"coverage.pairs"}


def test_a_mechanism_is_checked_against_the_robot_and_against_pieces() -> None:
    robot = _slider()
    wheel = CUBE * 0.05
    model = robot.model.copy()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), "wheel")
    augmented = robot_of(model, [*robot.bodies, LinkBody("wheel/rim", "wheel", joint, wheel, wheel)])
    stem = Scene((box("stem", (0.5, 0.0, 0.0), (0.01, 0.01, 0.01)),))
    moved = frozenset({"wheel"})
    inside = Motion(augmented, stem, _line([0.0, 0.0], [0.3, 1.0]), mechanism_links=moved)
    assert verify(inside).status is Status.VIOLATED
    stands_in = Allowance(BodyRef("mechanism", "wheel"), BodyRef.of_piece("stem"), 0.08)
    apart = replace(inside, phases=(Phase("turn", 0.0, 1.0, allowances=(stands_in,)),))
    certificate = verify(apart)
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_pair == ("slider", "wheel/rim") or set(certificate.min_clearance_pair or ()) == {
        "slider",
        "wheel/rim",
    }
    through = replace(apart, curve=_line([0.0, 0.0], [0.6, 1.0]))
    assert verify(through).status is Status.VIOLATED


def test_a_body_with_many_vertices_is_checked_in_full() -> None:
    rng = np.random.default_rng(1)
    ball = rng.normal(size=(250, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1)[:, None]
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    robot = robot_of(model, [LinkBody("ball", "ball", 1, ball, CUBE * 0.1)])
    near = ball[:, 0].max()
    wall = Scene((box("wall", (1.0, 0.0, 0.0), (0.1, 1.0, 1.0)),))
    certificate = verify(Motion(robot, wall, _line([0.0], [0.9 - near - 0.004])))
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_m == pytest.approx(0.004, abs=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 40, 200])
def test_pieces_of_any_number_of_vertices_are_checked(count: int) -> None:
    rng = np.random.default_rng(count)
    vertices = np.column_stack([rng.uniform(0.5, 0.6, count), rng.uniform(-1, 1, (count, 2))])
    vertices[0] = [0.5, 0.01, 0.02]
    scene = Scene((ConvexPiece("piece", vertices),))
    certificate = verify(Motion(_slider(), scene, _line([0.0], [0.44])))
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_m == pytest.approx(0.01, abs=1e-3)
    assert verify(Motion(_slider(), scene, _line([0.0], [0.46]))).status is Status.VIOLATED


def test_a_flat_piece_of_many_vertices_is_checked() -> None:
    rng = np.random.default_rng(5)
    flat = np.column_stack([np.full(300, 0.5), rng.uniform(-1, 1, (300, 2))])
    certificate = verify(Motion(_slider(), Scene((ConvexPiece("plane", flat),)), _line([0.0], [0.44])))
    assert certificate.status is Status.CERTIFIED
    assert (
        verify(Motion(_slider(), Scene((ConvexPiece("plane", flat),)), _line([0.0], [0.56]))).status is Status.VIOLATED
    )


def test_coarse_export_samples_cost_clearance() -> None:
    # Reading the two samples linearly cuts the arc's corner: the rod's tip passes 1 - cos(0.6) nearer to the axis.
    curve = Curve(np.array([0.0, 1.0]), np.array([[-0.6], [0.6]]), np.array([[4.0], [4.0]]))
    post = Scene((box("post", (1.015, 0.0, 0.0), (0.005, 0.005, 0.005)),))
    fine = Motion(_spinner(), post, curve, samples=np.linspace(0.0, 1.0, 401))
    assert verify(fine).status is Status.CERTIFIED
    coarse = replace(fine, samples=np.linspace(0.0, 1.0, 5))
    assert verify(coarse).status is Status.FEASIBLE_AT_SAMPLES


def test_fewer_halvings_never_turn_a_refuted_motion_into_a_certified_one() -> None:
    post = box("post", (0.98, 0.0, 0.0), (0.005, 0.005, 0.005))
    motion = Motion(_spinner(), Scene((post,)), _line([-0.6], [0.6]))
    for halvings in range(4):
        assert verify(motion, VerifySettings(max_halvings=halvings)).status is not Status.CERTIFIED


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_dense_sampling_never_refutes_what_is_certified(seed: int, is_floating: bool) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(2, 5)), is_floating=is_floating, branches=True)
    bodies = []
    for joint in range(1, model.njoints):
        vertices = rng.uniform(-0.15, 0.15, size=(8, 3))
        bodies.append(LinkBody(f"link{joint}", f"link{joint}", joint, vertices, vertices))
    robot = robot_of(model, bodies)
    curve = random_curve(rng, model.nq, 3, spread=0.3)
    pieces = tuple(
        box(f"piece{k}", tuple(rng.uniform(-1.5, 1.5, 3)), tuple(rng.uniform(0.001, 0.1, 3))) for k in range(4)
    )
    certificate = verify(Motion(robot, Scene(pieces), curve))
    gap = sampled_gap(model, curve, bodies, pieces, np.linspace(curve.knots[0], curve.knots[-1], 161))
    is_clear, _ = _clearance(certificate)
    if is_clear and certificate.min_clearance_m > 0.0:
        assert certificate.min_clearance_m <= gap + 1e-9
        assert certificate.min_clearance_m >= min(gap, 0.1) - 0.03
    if not is_clear:
        assert gap < 0.01


def test_phases_that_leave_a_gap_are_refused() -> None:
    phases = (Phase("a", 0.0, 0.4), Phase("b", 0.5, 1.0))
    with pytest.raises(VerifyError, match=r"phase 'b' must begin at 0\.4"):
        verify(Motion(_slider(), Scene(), _line([0.0], [0.1]), phases=phases))
