"""A demanded clearance: certified only where every pose keeps it, and refused with the pair and its distance."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hull_reference import sampled_gap
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from small_robots import CUBE, box, random_curve, random_model, robot_of

from costs.allowance import Allowance, BodyRef
from costs.curve import Curve
from costs.robot.model import LinkBody, RobotModel
from costs.scene import Scene
from service.verify import Motion, Phase, Status, verify


def slider() -> RobotModel:
    """A box of 10 cm that slides along x."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    return robot_of(model, [LinkBody("slider", "slider", 1, 0.05 * CUBE, 0.05 * CUBE)])


def slide(wall_m: float, demanded: float, phases: tuple[Phase, ...] = ()) -> Motion:
    """A slide from 0 to 0.8 m towards a wall whose face is at ``wall_m``; the box ends 0.05 m beyond its middle."""
    curve = Curve(np.arange(2.0), np.array([[0.0], [0.8]]), np.full((2, 1), 0.8))
    wall = box("wall", (wall_m + 0.1, 0.0, 0.0), (0.1, 1.0, 1.0))
    return Motion(slider(), Scene((wall,)), curve, phases=phases, clearance_m=demanded)


@pytest.mark.parametrize(("wall_m", "demanded"), [(0.9, 0.049), (1.4, 0.5), (1.4, 0.3), (0.9, 0.0)])
def test_a_clearance_that_is_kept_is_proven_also_beyond_the_horizon(wall_m: float, demanded: float) -> None:
    certificate = verify(slide(wall_m, demanded))
    assert certificate.status is Status.CERTIFIED
    if demanded:
        (text,) = [check.text for check in certificate.checks if check.name == "clearance"]
        assert f"{1e3 * demanded:g} mm from the world as demanded" in text


@pytest.mark.parametrize(("wall_m", "demanded"), [(0.9, 0.051), (1.4, 0.56)])
def test_a_clearance_that_is_missed_is_refuted_with_its_distance(wall_m: float, demanded: float) -> None:
    certificate = verify(slide(wall_m, demanded))
    assert certificate.status is Status.VIOLATED
    (failed,) = certificate.failed()
    assert failed.text == f"slider is {1e3 * (wall_m - 0.85):.1f} mm from wall, {1e3 * demanded:g} mm are demanded"
    assert failed.limit == demanded


def test_what_may_touch_is_not_held_to_it() -> None:
    allowance = Allowance(BodyRef.of_link("slider"), BodyRef.of_piece("wall"), 0.01)
    assert verify(slide(0.849, 0.3, (Phase("press", 0.0, 1.0, allowances=(allowance,)),))).status is Status.CERTIFIED


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), demanded=st.floats(0.005, 0.4))
def test_no_pose_of_a_certified_motion_is_nearer_to_the_world(seed: int, demanded: float) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(2, 4)), is_floating=False, branches=True)
    bodies = []
    for joint in range(1, model.njoints):
        vertices = rng.uniform(-0.15, 0.15, size=(8, 3))
        bodies.append(LinkBody(f"link{joint}", f"link{joint}", joint, vertices, vertices))
    curve = random_curve(rng, model.nq, 3, spread=0.3)
    pieces = tuple(
        box(f"piece{k}", tuple(rng.uniform(-1.5, 1.5, 3)), tuple(rng.uniform(0.001, 0.1, 3))) for k in range(2)
    )
    # Only the world counts: bodies of one link each are compared with the pieces alone.
    robot = robot_of(model, bodies)
    poses = np.linspace(curve.knots[0], curve.knots[-1], 101)
    gap = min(sampled_gap(model, curve, [body], pieces, poses) for body in bodies)
    certificate = verify(Motion(robot, Scene(pieces), curve, clearance_m=demanded))
    held = [check for check in certificate.checks if check.name == "clearance"]
    assume(all(check.limit > 0.0 or check.ok for check in held))  # links that meet each other are another matter
    if certificate.status is Status.CERTIFIED:
        assert gap >= demanded - 1e-9
    if gap < demanded - 1e-3:
        assert certificate.status is Status.VIOLATED
