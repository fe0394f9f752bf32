"""Bodies carried by links: part of the robot, of its mass and of the files it is read from again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from tiny_robots import SPATIAL, atlas, chain, random_configurations

from costs.robot import AttachedBody, RobotError, RobotModel, load_robot, with_attached

POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_euler("zyx", [0.4, 0.3, 0.2]).as_matrix()
POSE[:3, 3] = [0.1, -0.2, 0.3]
BOX_IN_PARTS = tuple(
    np.array([[x, y, z] for x in (-0.05, 0.05) for y in ends for z in (-0.03, 0.03)])
    for ends in ((-0.4, 0.1), (0.1, 0.4))
)
BEAM = AttachedBody("beam", "l_hand", POSE, "box", (0.1, 0.8, 0.06), 4.0, ("r_hand", "r_hook"))


def _placed(robot: RobotModel, q: np.ndarray) -> pin.Data:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data


def _body(robot: RobotModel, name: str):
    (body,) = [body for body in robot.bodies if body.name == name]
    return body


def test_the_body_moves_with_its_link() -> None:
    robot = with_attached(atlas(), [BEAM])
    q = random_configurations(robot, np.random.default_rng(1), 1)[0]
    data, body = _placed(robot, q), _body(robot, "beam")
    assert body.link == "beam"
    at_link = data.oMf[robot.model.getFrameId("l_hand")].homogeneous @ POSE
    np.testing.assert_allclose(data.oMf[robot.model.getFrameId("beam")].homogeneous, at_link, atol=1e-9)
    corners = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.4, 0.4) for z in (-0.03, 0.03)])
    expected = corners @ at_link[:3, :3].T + at_link[:3, 3]
    found = np.array([data.oMi[body.joint].act(vertex) for vertex in body.vertices])
    for corner in expected:
        assert np.linalg.norm(found - corner, axis=1).min() < 1e-9


def test_joints_limits_and_postures_stay_as_they_are() -> None:
    plain, robot = atlas(), with_attached(atlas(), [BEAM])
    assert robot.joint_names == plain.joint_names
    assert list(robot.model.names) == list(plain.model.names)
    np.testing.assert_array_equal(robot.lower, plain.lower)
    assert robot.postures.keys() == plain.postures.keys()
    assert [body.name for body in robot.bodies] == [*(body.name for body in plain.bodies), "beam"]
    assert with_attached(plain, []) is plain


def test_its_mass_counts_by_hand() -> None:
    plain, robot = atlas(), with_attached(atlas(), [BEAM])
    q = plain.postures["reach_ready"]
    data = _placed(robot, q)
    before = pin.centerOfMass(plain.model, plain.model.createData(), q)
    mass = pin.computeTotalMass(plain.model)
    beam = data.oMf[robot.model.getFrameId("beam")].translation
    after = (mass * before + 4.0 * beam) / (mass + 4.0)
    np.testing.assert_allclose(pin.centerOfMass(robot.model, robot.model.createData(), q), after, atol=1e-9)
    without = with_attached(plain, [AttachedBody("beam", "l_hand", POSE, "box", (0.1, 0.8, 0.06))])
    assert pin.computeTotalMass(without.model) == pytest.approx(mass)


@pytest.mark.parametrize(
    ("kind", "size", "expected"),
    [
        ("box", (0.1, 0.8, 0.06), np.array([0.8**2 + 0.06**2, 0.1**2 + 0.06**2, 0.1**2 + 0.8**2]) / 3.0),
        ("sphere", (0.2,), np.full(3, 1.6 * 0.04)),
        ("cylinder", (0.1, 0.6), np.array([0.13, 0.13, 0.02])),
        ("parts", (), np.array([0.8**2 + 0.06**2, 0.1**2 + 0.06**2, 0.1**2 + 0.8**2]) / 3.0),
    ],
)
def test_its_inertia_is_that_of_an_even_body(kind, size, expected) -> None:
    # a body of 4 kg; the cylinder's by hand: 4 (3 r^2 + h^2) / 12 = 0.13, 4 r^2 / 2 = 0.02; the parts are the box, cut
    plain = chain(SPATIAL)
    parts = BOX_IN_PARTS if kind == "parts" else ()
    robot = with_attached(plain, [AttachedBody("load", "tip", np.eye(4), kind, size, 4.0, parts=parts)])
    joint = robot.model.njoints - 1
    tip = robot.model.frames[robot.model.getFrameId("tip")].placement
    added = tip.actInv(robot.model.inertias[joint] - plain.model.inertias[joint])
    assert added.mass == pytest.approx(4.0)
    np.testing.assert_allclose(added.lever, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diag(added.inertia), expected, atol=1e-9)


def test_only_what_holds_it_is_not_checked_against_it() -> None:
    ignored = with_attached(atlas(), [BEAM]).ignored_pairs
    exempt = {pair for pair in ignored if "beam" in pair}
    assert {(a if b == "beam" else b) for a, b in exempt} == {"l_hand", "l_hook", "r_hand", "r_hook"}
    assert ignored - exempt == atlas().ignored_pairs


def _reloaded(robot: RobotModel, folder: Path) -> RobotModel:
    (folder / "robot.urdf").write_text(robot.source.urdf)
    (folder / "robot.srdf").write_text(robot.source.srdf)
    for name, source in robot.source.files.items():
        copy = folder / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(source.read_bytes())
    root = "floating" if robot.is_floating else "fixed"
    return load_robot(urdf=folder / "robot.urdf", srdf=folder / "robot.srdf", package_dirs=[folder], root=root)


@pytest.mark.parametrize(
    "make",
    [lambda: (atlas(), BEAM), lambda: (chain(SPATIAL), CAN), lambda: (chain(SPATIAL), CUT)],
    ids=["atlas", "no srdf", "parts"],
)
def test_read_from_its_files_again_it_is_the_same_robot(make, tmp_path: Path) -> None:
    plain, body = make()
    robot = with_attached(plain, [body])
    again = _reloaded(robot, tmp_path)
    assert again.joint_names == robot.joint_names
    assert again.ignored_pairs == robot.ignored_pairs
    assert again.fixed_links == robot.fixed_links
    assert again.source.urdf == robot.source.urdf
    assert {b.name for b in again.bodies} == {b.name for b in robot.bodies}
    for one in robot.bodies:
        np.testing.assert_allclose(_body(again, one.name).vertices, one.vertices, atol=1e-12)
    for mine, theirs in zip(robot.model.inertias, again.model.inertias, strict=True):
        assert mine.isApprox(theirs, 1e-9)


CUT = AttachedBody("cut", "tip", POSE, "parts", (), 0.5, ("link1",), BOX_IN_PARTS)
CAN = AttachedBody("can", "tip", POSE, "cylinder", (0.03, 0.1), 0.5, ("link1",))


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (AttachedBody("pelvis", "l_hand", POSE, "sphere", (0.1,)), "'pelvis': the name is in use by atlas"),
        (AttachedBody("beam", "l_hnad", POSE, "sphere", (0.1,)), "unknown link 'l_hnad'"),
        (AttachedBody("beam", "l_hand", POSE, "sphere", (0.1,), touching=("hook",)), "unknown link 'hook'"),
        (AttachedBody("beam", "l_hand", POSE, "box", (0.1, 0.0, 0.1)), "every length must be positive"),
    ],
)
def test_what_cannot_be_attached_is_refused(body: AttachedBody, problem: str) -> None:
    with pytest.raises(RobotError, match=problem):
        with_attached(atlas(), [body])


def test_two_bodies_need_two_names() -> None:
    with pytest.raises(RobotError, match="link name 'beam' is used twice"):
        with_attached(atlas(), [BEAM, BEAM])
