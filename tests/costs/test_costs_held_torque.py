"""The torque of an arm that exerts a force: Jacobian, pinocchio's figures, and a lever worked out by hand."""

import numpy as np
import pinocchio as pin
import pytest
from jacobian import check_jacobian
from tiny_robots import Segment, atlas_with_wheel, chain, random_configurations

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.state import MotionState
from costs.terms import HeldTorque
from costs.terms.joint_torque import find_limited_joints

FORCES = np.array([[40.0, -90.0, 15.0], [0.0, 0.0, 0.0], [-120.0, 5.0, 60.0]])


def make_state(robot):
    engine = KinematicsEngine(robot)
    return lambda q: MotionState(engine(q), Contacts.none())


@pytest.mark.parametrize("seed", range(3))
def test_its_jacobian_is_that_of_central_differences(seed):
    robot = atlas_with_wheel()
    q = random_configurations(robot, np.random.default_rng(seed), 3)
    check_jacobian(HeldTorque(robot, "l_peg", [0, 1, 2], FORCES, 0.9), make_state(robot), q)


def test_it_is_the_torque_that_pinocchio_computes_for_the_arm_and_the_back():
    robot = atlas_with_wheel()
    q = random_configurations(robot, np.random.default_rng(7), 3)
    term = HeldTorque(robot, "r_peg", [0, 1, 2], FORCES, 0.9)
    names = {robot.joint_names[column] for column in term.limited}
    assert names == {name for name in robot.joint_names if name.startswith(("r_arm", "back"))}
    assert set(term.limited) < set(find_limited_joints(robot))
    rows = term.value(make_state(robot)(q)).reshape(3, 2, -1)
    model, data = robot.model, robot.model.createData()
    frame = model.getFrameId("r_peg")
    for k in range(3):
        torque = pin.computeGeneralizedGravity(model, data, q[k]).copy()
        moved = pin.computeFrameJacobian(model, data, q[k], frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        share = ((torque - moved.T @ FORCES[k]) / robot.effort)[term.limited]
        np.testing.assert_allclose(rows[k, 0], share - 0.9, atol=1e-9)
        np.testing.assert_allclose(rows[k, 1], -share - 0.9, atol=1e-9)


def test_a_lever_of_one_metre_turns_a_newton_into_a_newton_metre():
    robot = chain((Segment((0.0, 0.0, 1.0), size=(1.0, 0.1, 0.1), mass=2.0),))
    frame = robot.bodies[-1].link
    q = np.zeros((1, robot.n))
    plain, pushed = (
        HeldTorque(robot, frame, [0], np.array([force]), 0.0).value(make_state(robot)(q))
        for force in ([0.0, 0.0, 0.0], [0.0, 5.0, 0.0])
    )
    joint = robot.model.getFrameId(frame)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q[0])
    arm = data.oMf[joint].translation[0]
    limited = HeldTorque(robot, frame, [0], np.zeros((1, 3))).limited
    expected = -5.0 * arm / robot.effort[limited]
    np.testing.assert_allclose((pushed - plain)[: len(limited)], expected, atol=1e-12)
