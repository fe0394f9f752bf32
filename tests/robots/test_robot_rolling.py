"""Robots on two wheels, whose base turns and drives and never slides sideways."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jacobian import check_jacobian
from robot_files import joint, link, robot, write_urdf

from costs.collision import Contacts
from costs.curve import Curve
from costs.kinematics import KinematicsEngine
from costs.robot import RobotError, RobotModel, load_robot
from costs.scene import Scene
from costs.state import MotionState
from costs.terms.rolling import RollingBase, roll_path, stop_between
from service import certify, load_request, plan, read_trajectory, write_result
from service.replay.replay import verify_result
from service.result.result import PlanResult
from service.verify import Motion, Phase, verify
from service.verify.rolling import SLIDE_M, SLIDE_SHARE

MASS = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
REQUEST = """robot: {{urdf: robot.urdf, root: {root}}}
start: {{joints: {{base_yaw: 0.5, lift: 0.2}}}}
scene: {{floor: false, obstacles: [{{name: pillar, type: cylinder, radius: 0.15, height: 2, position: [1, 0.05, 1]}}]}}
goal: {{joints: {{base_x: 2.0, base_y: 0.4, base_yaw: 1.0, lift: 0.6}}}}
"""


def _write_cart(folder: Path) -> Path:
    wide = '<limit lower="-2" upper="2" velocity="2" effort="60"/>'
    lift = joint("lift", "chassis", "arm", inside=wide, xyz="0.2 0 0.5").replace('xyz="0 0 1"', 'xyz="0 -1 0"')
    chassis, arm = (
        link(name, box).replace("</link>", MASS)
        for name, box in (("chassis", '<box size="0.5 0.4 0.3"/>'), ("arm", '<box size="0.3 0.1 0.1"/>'))
    )
    return write_urdf(folder, robot(chassis, arm, lift))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a cart and a request that leads it around a pillar."""
    folder = tmp_path_factory.mktemp("cart")
    _write_cart(folder).rename(folder / "robot.urdf")
    for root in ("differential", "planar"):
        (folder / f"{root}.yaml").write_text(REQUEST.format(root=root))
    return folder


@pytest.fixture(scope="module")
def cart(folder: Path) -> RobotModel:
    return load_robot(urdf=folder / "robot.urdf", root="differential")


@pytest.fixture(scope="module")
def driven(folder: Path) -> PlanResult:
    return plan(load_request(folder / "differential.yaml"))


def _measure_slide(curve: Curve) -> float:
    q = curve(np.linspace(curve.knots[0], curve.knots[-1], 5000))
    step, yaw = np.diff(q[:, :2], axis=0), 0.5 * (q[1:, 2] + q[:-1, 2])
    return float(np.abs(np.cos(yaw) * step[:, 1] - np.sin(yaw) * step[:, 0]).sum())


def _measure_excess(curve: Curve) -> float:
    """Return by how much a base slides beyond its share of the whole way [m]."""
    q = curve(np.linspace(curve.knots[0], curve.knots[-1], 5000))
    return _measure_slide(curve) - SLIDE_SHARE * float(np.linalg.norm(np.diff(q[:, :2], axis=0), axis=1).sum())


def test_a_cart_drives_around_a_pillar_without_sliding(folder: Path, driven: PlanResult, tmp_path: Path) -> None:
    assert driven.verdict.value == "CERTIFIED", driven.explanation
    assert driven.motion is not None
    assert driven.certificate is not None
    assert "rolling.base" in [check.name for check in driven.certificate.checks]
    assert _measure_slide(driven.motion.curve) < 1e-9
    assert np.allclose(driven.positions[-1], [2.0, 0.4, 1.0, 0.6], atol=1e-3)
    write_result(driven, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"
    assert verify_result(tmp_path / "out", folder / "differential.yaml")["verdict"] == "CERTIFIED"


def test_a_motion_that_slides_is_refuted(folder: Path, cart: RobotModel, tmp_path: Path) -> None:
    slid = plan(load_request(folder / "planar.yaml"))
    assert slid.motion is not None
    certificate = verify(replace(slid.motion, robot=replace(slid.motion.robot, rolls=True)))
    failed = [check for check in certificate.failed() if check.name == "rolling.base"]
    assert failed
    assert failed[0].value - failed[0].limit + SLIDE_M >= _measure_excess(slid.motion.curve) > 0.05
    # The same as a foreign trajectory, and as a record whose request says otherwise.
    write_result(slid, tmp_path / "out")
    outcome = certify(read_trajectory(tmp_path / "out" / "trajectory.csv"), load_request(folder / "differential.yaml"))
    assert not outcome.is_certified
    assert verify_result(tmp_path / "out", folder / "differential.yaml")["verdict"] != "CERTIFIED"


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_the_bound_is_never_below_the_slide(cart: RobotModel, data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
    q, v = rng.uniform(-1.0, 1.0, (4, 4)), rng.uniform(-2.0, 2.0, (4, 4))
    curve = Curve(np.cumsum(rng.uniform(0.1, 1.0, 4)), q, v)
    first, last = float(curve.knots[0]), float(curve.knots[-1])
    motion = Motion(cart, Scene(()), curve, None, (Phase("drive", first, last),))
    check = next(check for check in verify(motion).checks if check.name == "rolling.base")
    assert _measure_excess(curve) <= (check.value - check.limit + SLIDE_M) * (1.0 + 1e-6) + 1e-9
    assert check.value <= 1.2 * _measure_slide(curve) + 0.05  # and not far above it


@pytest.mark.parametrize(("aside", "is_ok"), [(0.0, True), (0.0008, True), (0.03, False)])
def test_a_long_way_does_not_excuse_a_slide_at_one_place(cart: RobotModel, aside: float, is_ok: bool) -> None:
    """The base drives 8 m straight ahead, and is moved aside within 10 cm of it."""
    places = [(0.0, 0.0), (4.0, 0.0), (4.1, aside), (8.0, aside)]
    curve = Curve(np.array([0.0, 4.0, 4.1, 8.0]), np.array([[x, y, 0.0, 0.2] for x, y in places]), np.eye(4)[[0] * 4])
    motion = Motion(cart, Scene(()), curve, None, (Phase("drive", 0.0, 8.0),))
    check = next(check for check in verify(motion).checks if check.name == "rolling.base")
    assert check.ok == is_ok, check.text


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_path_becomes_turns_and_drives(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
    q = rng.uniform(-2.0, 2.0, (int(rng.integers(6, 30)), 5))
    if data.draw(st.booleans()):
        q[:, :2] = q[0, :2]  # the base stays
    path = roll_path(q)
    s = np.arange(len(q), dtype=float)
    curve = Curve(s, path, stop_between(path, np.gradient(path, axis=0)))
    assert np.allclose(path[[0, -1]], q[[0, -1]])
    assert np.allclose(path[:, 3:], q[:, 3:])
    assert _measure_slide(curve) < 1e-9


def test_the_rows_of_a_rolling_base_have_their_derivative(cart: RobotModel) -> None:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (9, cart.n))
    engine = KinematicsEngine(cart)
    check_jacobian(RollingBase(9), lambda x: MotionState(engine(x), Contacts.none()), q)
    rolled = MotionState(engine(roll_path(q)), Contacts.none())
    assert np.allclose(RollingBase(9).value(rolled), 0.0, atol=1e-12)


def test_a_bundled_robot_has_no_wheels(folder: Path) -> None:
    data: dict[str, Any] = {"name": "atlas", "root": "differential"}
    with pytest.raises(RobotError, match="root differential goes with a urdf"):
        load_robot(**data)
