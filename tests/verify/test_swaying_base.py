"""A fixed base that something else balances: clearance and reach of hands hold on every base within its sway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import CUBE, box, let_some_follow, random_model, robot_of

from costs.curve import Curve
from costs.robot.model import LinkBody
from costs.scene import Scene
from service import parse_request, plan
from service.errors import RequestError
from service.verify import Motion, Phase, PoseTarget, Status, Sway, verify
from service.verify.clearance.swaying import bound_largest_sway, bound_sways
from service.verify.joint_chain import JointTree

SWAY = Sway(0.03, 2.0)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), distance=st.floats(0.0, 0.2), angle=st.floats(0.1, 10.0))
def test_no_point_of_a_body_moves_farther_than_the_bound(seed: int, distance: float, angle: float) -> None:
    rng = np.random.default_rng(seed)
    model = let_some_follow(rng, random_model(rng, 5, is_floating=False, branches=True))
    bodies = [
        LinkBody(f"b{j}", f"b{j}", j, corners, corners) for j in range(1, model.njoints) for corners in [0.1 * CUBE]
    ]
    sway, limit = Sway(distance, angle), 1.5
    bound = bound_sways(JointTree(model, np.full(model.nq, limit), 0), bodies, sway)
    data = model.createData()
    for _ in range(8):
        pin.forwardKinematics(model, data, rng.uniform(-limit, limit, model.nq))
        turn, way = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        base = pin.SE3(pin.exp3(np.deg2rad(angle) * turn), distance * way)
        for body, most in zip(bodies, bound, strict=True):
            points = body.vertices @ data.oMi[body.joint].rotation.T + data.oMi[body.joint].translation
            moved = points @ base.rotation.T + base.translation
            assert np.linalg.norm(moved - points, axis=1).max() <= most + 1e-9
    assert bound_largest_sway(robot_of(model, bodies, limit=limit), sway) == pytest.approx(bound.max())


def _slide(wall_m: float, sway: Sway, limit: float = 10.0) -> Motion:
    """A box of 10 cm slides along x from 0 to 0.8 m, to 0.85 m with its face, and aims at 0.8 m."""
    model = pin.Model()
    for name, kind in (("slide", pin.JointModelPX()), ("side", pin.JointModelPY()), ("lift", pin.JointModelPZ())):
        model.addJoint(model.njoints - 1, kind, pin.SE3.Identity(), name)
    model.addFrame(pin.Frame("tip", 3, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = robot_of(model, [LinkBody("slider", "slider", 3, 0.05 * CUBE, 0.05 * CUBE)], limit=limit)
    curve = Curve(np.arange(2.0), np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]]), np.array([[0.8, 0.0, 0.0]] * 2))
    target = PoseTarget("tip", np.array([0.8, 0.0, 0.0]), None, np.full(3, 1e-3), np.full(3, np.inf), at=1.0)
    wall = box("wall", (wall_m + 0.1, 0.0, 0.0), (0.1, 1.0, 1.0))
    return Motion(robot, Scene((wall,)), curve, phases=(Phase("reach", 0.0, 1.0, targets=(target,)),), sway=sway)


@pytest.mark.parametrize(("wall_m", "sway", "is_kept"), [
    (0.90, Sway(0.049), True),
    (0.90, Sway(0.051), False),
    (0.96, Sway(0.03, 2.0), True),
    (0.90, Sway(0.03, 2.0), False),
])  # fmt: skip
def test_the_world_is_cleared_by_what_sway_moves_the_links(wall_m: float, sway: Sway, is_kept: bool) -> None:
    certificate = verify(_slide(wall_m, sway))
    assert (certificate.status is Status.CERTIFIED) == is_kept
    if not is_kept:
        (failed,) = certificate.failed()
        assert failed.text.startswith("slider is ")
        assert "are demanded" in failed.text


def test_a_hand_that_cannot_make_up_for_the_sway_is_named_with_what_is_missing() -> None:
    certificate = verify(_slide(2.0, Sway(0.03), limit=0.81))
    (failed,) = certificate.failed()
    assert failed.name == "swayed.reach.tip"
    assert "tip stays 20.0 mm beside its place where the base has swayed by 30 mm and 0 deg" in failed.text
    assert verify(_slide(2.0, Sway(0.03), limit=0.84)).status is Status.CERTIFIED


def test_without_sway_nothing_of_it_is_checked() -> None:
    certificate = verify(replace(_slide(0.9, SWAY), sway=Sway()))
    assert certificate.status is Status.CERTIFIED
    assert not [check for check in certificate.checks if check.name.startswith("swayed.")]


def test_a_robot_whose_base_is_planned_does_not_sway() -> None:
    goal = {"joints": {"l_arm_elx": 1.2}}
    request = parse_request({"robot": {"name": "atlas"}, "goal": goal, "options": {"sway_m": 0.03}})
    with pytest.raises(
        RequestError, match=r"^options.sway_m: 0.03 with a robot whose base is planned; expected robot.root: fixed"
    ):
        plan(request)
