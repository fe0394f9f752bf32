"""A robot with the joint of a mechanism added."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.robot import MechanismJoint, RobotError, RobotModel, load_robot, shapes, with_mechanism

ATLAS = load_robot("atlas")
ORIGIN = np.array([0.8, -0.1, 1.1])
RIM = shapes.box(np.array([0.05, 0.3, 0.04])) + ORIGIN + [0.0, 0.1, 0.0]


def _augmented(**changes: Any) -> RobotModel:
    arguments: dict[str, Any] = {
        "name": "valve_turn", "origin": ORIGIN, "axis": np.array([-2.0, 0.0, 0.0]), "bodies": {"rim": RIM},
        "link": "valve", "lower": -7.0, "upper": 7.0, "velocity": 1.0, "acceleration": 2.0,
    }  # fmt: skip
    return with_mechanism(ATLAS, [MechanismJoint(**{**arguments, **changes})])


def test_the_new_joint_is_the_last_coordinate() -> None:
    robot = _augmented()
    assert robot.n == robot.model.nq == robot.model.nv == ATLAS.n + 1
    assert robot.joint_names == (*ATLAS.joint_names, "valve_turn")
    assert (robot.lower[-1], robot.upper[-1], robot.velocity[-1], robot.acceleration[-1]) == (-7.0, 7.0, 1.0, 2.0)
    assert robot.effort[-1] == np.inf
    assert all(posture[-1] == 0.0 and len(posture) == robot.n for posture in robot.postures.values())
    assert robot.mechanism_links == {"valve"}
    assert ATLAS.n == ATLAS.model.nq == 36  # the robot itself is as it was


@given(
    angle=st.floats(-6.0, 6.0),
    axis=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    seed=st.integers(0, 1000),
)
@settings(max_examples=30)
def test_the_mechanism_turns_about_its_axis_whatever_the_robot_does(
    angle: float, axis: tuple[float, float, float], seed: int
) -> None:
    robot = _augmented(axis=np.array(axis))
    q = np.append(np.random.default_rng(seed).uniform(-0.5, 0.5, ATLAS.n), angle)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    (body,) = (body for body in robot.bodies if body.link == "valve")
    pose = data.oMi[body.joint]
    world = body.vertices @ pose.rotation.T + pose.translation
    unit = np.array(axis) / np.linalg.norm(axis)
    expected = (RIM - ORIGIN) @ pin.exp3(unit * angle).T + ORIGIN
    np.testing.assert_allclose(world, expected, atol=1e-12)
    frame = data.oMf[int(robot.model.getFrameId("valve"))]
    np.testing.assert_allclose(frame.homogeneous, pose.homogeneous, atol=1e-15)


def test_the_mechanism_does_not_weigh_on_the_robot() -> None:
    robot = _augmented()
    q = ATLAS.postures["reach_ready"]
    data, robot_data = ATLAS.model.createData(), robot.model.createData()
    com = pin.centerOfMass(ATLAS.model, data, q)
    np.testing.assert_array_equal(pin.centerOfMass(robot.model, robot_data, np.append(q, 1.0)), com)
    jacobian = pin.jacobianCenterOfMass(robot.model, robot_data, np.append(q, 1.0))
    np.testing.assert_allclose(jacobian[:, :-1], pin.jacobianCenterOfMass(ATLAS.model, data, q), atol=1e-12)
    np.testing.assert_array_equal(jacobian[:, -1], 0.0)
    assert pin.computeTotalMass(robot.model) == pin.computeTotalMass(ATLAS.model)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "l_arm_elx"}, "joint name 'l_arm_elx' is in use"),
        ({"link": "pelvis"}, "link name 'pelvis' is in use"),
        ({"bodies": {"l_hand": RIM}}, "body name 'l_hand' is in use"),
        ({"bodies": {"rim": RIM * np.nan}}, "not finite"),
        ({"bodies": {"rim": RIM * [1.0, 1.0, 0.0]}}, "lie in a plane"),
        ({"axis": np.zeros(3)}, "axis is zero"),
        ({"origin": np.array([0.0, np.inf, 0.0])}, "three finite numbers"),
        ({"axis": np.ones(2)}, "three finite numbers"),
        ({"lower": 1.0, "upper": -1.0}, "lower must not exceed upper"),
        ({"lower": float("nan")}, "lower must not exceed upper"),
        ({"velocity": 0.0}, "velocity and acceleration must be positive"),
    ],
)
def test_values_that_cannot_be_right_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(RobotError, match=message):
        _augmented(**changes)


def test_two_mechanisms_stand_side_by_side() -> None:
    door = MechanismJoint("door_swing", "door", -ORIGIN, np.array([0.0, 0.0, 1.0]), {"leaf": RIM}, lower=0.0, upper=1.5)
    robot = with_mechanism(_augmented(), [door])
    assert robot.joint_names[-2:] == ("valve_turn", "door_swing")
    assert robot.mechanism_links == {"valve", "door"}


@given(leaf=st.floats(0.0, 1.5), lever=st.floats(-0.8, 0.0), latch=st.floats(0.0, 0.02))
@settings(max_examples=30)
def test_a_lever_and_its_latch_move_with_the_leaf_that_carries_them(leaf: float, lever: float, latch: float) -> None:
    spindle, up, out = np.array([0.8, 0.3, 1.0]), np.array([0.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0])
    joints = [
        MechanismJoint("swing", "door/leaf", ORIGIN, up, {"leaf": RIM}, upper=1.5, start=0.3, lower=0.0),
        MechanismJoint("turn", "door/lever", spindle, out, {"lever": RIM + 0.1}, parent="door/leaf", lower=-0.8),
        MechanismJoint("slide", "door/latch", spindle, up, {"latch": RIM}, "prismatic", "door/lever", 0.0, 0.02),
    ]
    robot = with_mechanism(ATLAS, joints)
    assert robot.postures["stand"][-3:].tolist() == [0.3, 0.0, 0.0]
    q = np.concatenate([ATLAS.postures["stand"], [leaf, lever, latch]])
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    swung = pin.exp3(up * leaf)
    turned = swung @ pin.exp3(out * lever)
    expected = swung @ (spindle - ORIGIN) + ORIGIN
    placed = data.oMf[int(robot.model.getFrameId("door/lever"))]
    np.testing.assert_allclose(placed.translation, expected, atol=1e-12)
    np.testing.assert_allclose(placed.rotation, turned, atol=1e-12)
    slid = data.oMf[int(robot.model.getFrameId("door/latch"))]
    np.testing.assert_allclose(slid.translation, expected + turned @ (up * latch), atol=1e-12)


def test_a_parent_outside_the_mechanism_is_refused() -> None:
    joint = MechanismJoint("turn", "lever", ORIGIN, np.array([1.0, 0.0, 0.0]), {"lever": RIM}, parent="pelvis")
    with pytest.raises(RobotError, match="'pelvis' is no link of the mechanism"):
        with_mechanism(ATLAS, [joint])


def test_a_start_beyond_the_limits_is_refused() -> None:
    with pytest.raises(RobotError, match=r"starts at 9\.0, outside -7\.0 to 7\.0"):
        _augmented(start=9.0)
