"""Joints that follow others: kinematics, derivatives, limits and torques against code of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jacobian import central_differences, check_jacobian
from lxml import etree
from robot_files import joint, link, robot, write_urdf

from costs.collision import Contacts
from costs.contact import Contact
from costs.contact_points import ContactPoints, Load, measure_weight
from costs.kinematics import KinematicsEngine
from costs.robot import MechanismJoint, RobotError, RobotModel, load_robot, with_mechanism
from costs.state import LoadedState, MotionState
from costs.terms import FrictionPyramid, JointTorque, StaticTorque
from service.verify.forces.dynamics import map_axes
from service.verify.prepared_motion import ForwardKinematics

SEEDS = st.integers(0, 2**32 - 1)
WIDE = '<limit lower="-3" upper="3" velocity="2" effort="30"/>'


def _follow(leader: str, ratio: float, offset: float, limit: str = WIDE) -> str:
    return f'{limit}<mimic joint="{leader}" multiplier="{ratio!r}" offset="{offset!r}"/>'


def _hand_text(rng: np.random.Generator) -> str:
    """An arm whose fingers follow its second joint, one of them through another, and a joint that comes later."""

    def numbers(size: float) -> str:
        return " ".join(repr(float(x)) for x in rng.uniform(-size, size, 3))

    def part(name: str) -> str:
        inertial = (
            f'<inertial><origin xyz="{numbers(0.2)}"/><mass value="{rng.uniform(0.5, 2.0)!r}"/>'
            '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        shape = '<collision><geometry><box size="0.1 0.08 0.06"/></geometry></collision>'
        return f'<link name="{name}">{inertial}{shape}</link>'

    def turn(name: str, parent: str, child: str, inside: str = WIDE, kind: str = "revolute") -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{numbers(0.4)}" rpy="{numbers(2.0)}"/><axis xyz="{numbers(1.0)}"/>{inside}</joint>'
        )

    ratio = [float(rng.choice([-1, 1]) * rng.uniform(0.3, 2.0)) for _ in range(3)]
    offset = [float(x) for x in rng.uniform(-0.5, 0.5, 3)]
    return robot(
        *(part(name) for name in ("base", "arm", "grip", "a", "b", "c", "tip", "z")),
        turn("swing", "base", "arm"), turn("close", "arm", "grip"),
        turn("fa", "grip", "a", _follow("close", ratio[0], offset[0])),
        turn("fb", "a", "b", _follow("fa", ratio[1], offset[1])),
        turn("fc", "grip", "c", _follow("zlead", ratio[2], offset[2]), "prismatic"),
        turn("last", "b", "tip"), turn("zlead", "base", "z"),
    )  # fmt: skip


def _place_links(text: str, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Poses of all links in the root link, from the URDF's text alone."""
    joints = {element.get("name"): element for element in etree.fromstring(text).findall("joint")}

    def value(name: str) -> float:
        mimic = joints[name].find("mimic")
        if mimic is None:
            return values[name]
        return float(mimic.get("multiplier")) * value(mimic.get("joint")) + float(mimic.get("offset"))

    poses = {"base": np.eye(4)}
    while len(poses) <= len(joints):
        for name, element in joints.items():
            parent, child = element.find("parent").get("link"), element.find("child").get("link")
            if parent not in poses or child in poses:
                continue
            origin = np.eye(4)
            origin[:3, 3] = np.array(element.find("origin").get("xyz").split(), dtype=float)
            r, p, y = np.array(element.find("origin").get("rpy").split(), dtype=float)
            origin[:3, :3] = (
                pin.exp3(np.array([0, 0, y])) @ pin.exp3(np.array([0, p, 0])) @ pin.exp3(np.array([r, 0, 0]))
            )
            axis = np.array(element.find("axis").get("xyz").split(), dtype=float)
            axis /= np.linalg.norm(axis)
            motion = np.eye(4)
            if element.get("type") == "prismatic":
                motion[:3, 3] = value(name) * axis
            else:
                motion[:3, :3] = pin.exp3(value(name) * axis)
            poses[child] = poses[parent] @ origin @ motion
    return poses


def _load_hand(folder: Path, seed: int, root: str = "fixed") -> tuple[RobotModel, str]:
    text = _hand_text(np.random.default_rng(seed))
    return load_robot(urdf=write_urdf(folder, text), root=root), text  # type: ignore[arg-type]


@pytest.fixture(name="folder", scope="module")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hands")


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_planner_and_verifier_place_followers_where_the_file_says(folder: Path, seed: int) -> None:
    hand, text = _load_hand(folder, seed)
    assert sorted(hand.joint_names) == ["close", "last", "swing", "zlead"]
    assert hand.model.nq == hand.model.nv == 4
    q = np.random.default_rng(seed + 1).uniform(-2.0, 2.0, (3, 4))
    kinematics, placed = KinematicsEngine(hand)(q), ForwardKinematics(hand.model).at(q)
    for t, row in enumerate(q):
        poses = _place_links(text, dict(zip(hand.joint_names, row, strict=True)))
        for body in hand.bodies:
            frame = hand.model.frames[hand.model.getFrameId(body.link)]
            expected = poses[body.link] @ np.linalg.inv(frame.placement.homogeneous)
            for rotation, position in (
                (kinematics.rotation, kinematics.position),
                (placed.rotation, placed.translation),
            ):
                np.testing.assert_allclose(rotation[t, body.joint], expected[:3, :3], atol=1e-9)
                np.testing.assert_allclose(position[t, body.joint], expected[:3, 3], atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.sampled_from(["fixed", "floating"]))
def test_derivatives_are_differences_where_joints_follow(folder: Path, seed: int, root: str) -> None:
    hand, _ = _load_hand(folder, seed, root)
    rng = np.random.default_rng(seed + 1)
    q = rng.uniform(-1.0, 1.0, (1, hand.n))
    engine = KinematicsEngine(hand)
    joints = np.arange(1, hand.model.njoints)
    local, here = rng.normal(size=(len(joints), 3)), np.zeros(len(joints), dtype=int)

    def locate(x: np.ndarray) -> np.ndarray:
        kinematics = engine(x)
        return np.einsum("jkl,jl->jk", kinematics.rotation[0, joints], local) + kinematics.position[0, joints]

    kinematics, points = engine(q), locate(q)
    expected = central_differences(lambda x: locate(x).ravel(), q, 1e-6).reshape(len(joints), 3, hand.n)
    np.testing.assert_allclose(kinematics.point_jacobian(here, joints, points), expected, atol=1e-7)
    np.testing.assert_allclose(
        kinematics.directional_jacobian(here, joints, points, local),
        np.einsum("jk,jkn->jn", local, expected),
        atol=1e-6,
    )
    by_com = central_differences(lambda x: engine(x).com[0], q, 1e-6)
    np.testing.assert_allclose(kinematics.com_jacobian[0], by_com, atol=1e-7)
    for joint_index in joints:
        turned = central_differences(
            lambda x, k=joint_index: (engine(x).rotation[0, k] @ kinematics.rotation[0, k].T).ravel(), q, 1e-6
        ).reshape(3, 3, hand.n)
        spin = np.stack([turned[2, 1], turned[0, 2], turned[1, 0]])
        np.testing.assert_allclose(kinematics.angular_jacobian(int(joint_index))[0], spin, atol=1e-6)
    # A coordinate supports what its followers move, too.
    moves = np.abs(expected).max(axis=1) > 1e-9
    assert np.all(kinematics.topology.supports[joints] | ~moves)


def test_torque_terms_know_followers(folder: Path) -> None:
    hand, _ = _load_hand(folder, 3)
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(2, 3))
    touch = Contact(
        "tip", 0.2 * rng.normal(size=(2, 3)), normals / np.linalg.norm(normals, axis=1)[:, None], 0.6, 900.0
    )
    points = ContactPoints.of(hand, (touch,))
    loads = (Load("b", rng.normal(size=3), rng.normal(size=3), 0.1 * rng.normal(size=3)),)
    engine = KinematicsEngine(hand)

    def state(x: np.ndarray) -> LoadedState:
        q, forces = LoadedState.split(x, 2)
        return LoadedState(MotionState(engine(q), Contacts.none()), forces)

    x = np.concatenate([rng.uniform(-1.0, 1.0, (2, 4)), rng.normal(size=(2, 6))], axis=1)
    check_jacobian(JointTorque(hand, points, (0, 1), loads), state, x)
    check_jacobian(FrictionPyramid(points, (0, 1)), state, x)
    # Without contacts and loads the torques at rest are those of the inverse dynamics.
    bare = StaticTorque(hand, ContactPoints.of(hand, ()))
    q = x[:, :4]
    still = LoadedState(MotionState(engine(q), Contacts.none()), np.zeros((2, 0, 3)))
    weight = measure_weight(hand)
    data = hand.model.createData()
    expected = [pin.rnea(hand.model, data, row, np.zeros(4), np.zeros(4)) for row in q]
    np.testing.assert_allclose(weight * bare.measure(still, np.arange(2)), expected, rtol=1e-3, atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_torques_of_a_force_are_its_work_per_coordinate(folder: Path, seed: int) -> None:
    hand, _ = _load_hand(folder, seed)
    rng = np.random.default_rng(seed)
    q, force, local = rng.uniform(-1.0, 1.0, 4), rng.normal(size=3), rng.normal(size=3)
    tip = int(hand.model.frames[hand.model.getFrameId("tip")].parentJoint)

    def locate(row: np.ndarray) -> np.ndarray:
        placed = ForwardKinematics(hand.model).at(row[None])
        return placed.rotation[0, tip] @ local + placed.translation[0, tip]

    work = central_differences(lambda x: np.array([force @ locate(x[0])]), q[None], 1e-6)[0]
    columns = pin.computeJointJacobians(hand.model, hand.model.createData(), q)
    wrench = np.concatenate([force, np.cross(locate(q), force)])
    np.testing.assert_allclose((columns.T @ wrench) @ map_axes(hand.model, tip), work, atol=1e-6)


def test_a_leader_is_limited_by_its_followers(tmp_path: Path) -> None:
    narrow = '<limit lower="-0.2" upper="0.4" velocity="1" effort="1"/>'
    text = robot(
        link("base"), link("a"), link("b"), joint("ja", "base", "a"),
        joint("jb", "base", "b", inside=_follow("ja", -2.0, 0.1, narrow)),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    # -0.2 <= -2 q + 0.1 <= 0.4 and |-2 q'| <= 1
    np.testing.assert_allclose([model.lower, model.upper, model.velocity], [[-0.15], [0.15], [0.5]])
    assert model.notes == ()


def test_a_follower_that_cannot_stay_within_its_limits_does_not_limit_and_is_named(tmp_path: Path) -> None:
    away = '<limit lower="5" upper="6" velocity="0" effort="1"/>'
    text = robot(
        link("base"), link("a"), link("b"), joint("ja", "base", "a"),
        joint("jb", "base", "b", inside=_follow("ja", 1.0, 0.0, away)),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    np.testing.assert_allclose([model.lower, model.upper, model.velocity], [[-1.0], [1.0], [2.0]])
    assert model.notes == ("joint 'jb' cannot follow 'ja' within its own limits, which do not count",)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (_follow("jb", 1.0, 0.0), _follow("ja", 1.0, 0.0), "joint 'ja' mimics itself"),
        (_follow("jb", 1.0, 0.0), WIDE, "joint 'ja' mimics 'jb', which it carries"),
    ],
)
def test_following_that_makes_no_sense_is_refused(tmp_path: Path, first: str, second: str, message: str) -> None:
    text = robot(
        link("base"), link("a"), link("b"), joint("ja", "base", "a", inside=first), joint("jb", "a", "b", inside=second)
    )
    with pytest.raises(RobotError, match=message):
        load_robot(urdf=write_urdf(tmp_path, text))


def test_a_follower_of_a_fixed_joint_is_fixed(tmp_path: Path) -> None:
    stopped = '<limit lower="-1" upper="1" velocity="0" effort="1"/>'
    text = robot(
        link("base"), link("a"), link("b"), link("c"), joint("ja", "base", "a", inside=stopped),
        joint("jb", "base", "b", inside=_follow("ja", -2.0, 0.1)), joint("jc", "base", "c"),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    assert model.joint_names == ("jc",)
    assert model.notes == ("joint 'ja' has a velocity limit of 0: fixed at 0",)


def test_a_mechanism_beside_followers_moves_alone(folder: Path) -> None:
    hand, _ = _load_hand(folder, 5)
    wheel = MechanismJoint(
        name="wheel_turn", link="wheel", origin=np.array([1.0, 0.0, 0.5]), axis=np.array([1.0, 0.2, 0.0]),
        bodies={"wheel": np.random.default_rng(0).normal(size=(8, 3))},
    )  # fmt: skip
    both = with_mechanism(hand, [wheel])
    engine, q = KinematicsEngine(both), np.array([[0.3, -0.4, 0.2, 0.1, 0.5]])
    joint_index = np.array([both.model.njoints - 1])
    jacobian = engine(q).point_jacobian(np.zeros(1, dtype=int), joint_index, np.ones((1, 3)))[0]
    assert np.all(jacobian[:, :4] == 0.0)
    np.testing.assert_allclose(
        jacobian[:, 4], np.cross(wheel.axis / np.linalg.norm(wheel.axis), np.ones(3) - wheel.origin), atol=1e-12
    )
