"""Placements and Jacobians of all waypoints, against pinocchio's own and against differences."""

import numpy as np
import pinocchio as pin
import pytest
from jacobian import central_differences
from tiny_robots import PLANAR, SPATIAL, atlas, atlas_with_wheel, chain, random_configurations

from costs.kinematics import KinematicsEngine, locate_frame, locate_links

ROBOTS = {
    "atlas": atlas,
    "atlas with a wheel": atlas_with_wheel,
    "fixed chain": lambda: chain(SPATIAL),
    "floating chain": lambda: chain(SPATIAL, "floating"),
}


@pytest.fixture(params=ROBOTS, name="robot")
def _robot(request):
    return ROBOTS[request.param]()


def test_placements_are_pinocchios(robot):
    q = random_configurations(robot, np.random.default_rng(1), 5)
    kinematics = KinematicsEngine(robot)(q)
    data = robot.model.createData()
    for t in range(5):
        pin.forwardKinematics(robot.model, data, q[t])
        for joint in range(robot.model.njoints):
            np.testing.assert_allclose(kinematics.rotation[t, joint], data.oMi[joint].rotation, atol=1e-14)
            np.testing.assert_allclose(kinematics.position[t, joint], data.oMi[joint].translation, atol=1e-14)


def test_kinematics_keep_their_values_when_the_engine_moves_on(robot):
    engine = KinematicsEngine(robot)
    q = random_configurations(robot, np.random.default_rng(2), 4)
    first = engine(q[:2])
    kept = [array.copy() for array in (first.q, first.rotation, first.position, first.jacobian)]
    engine(q[2:])
    q[:2] = 0.0
    for array, copy in zip((first.q, first.rotation, first.position, first.jacobian), kept, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_point_jacobians_are_differences_of_the_points(robot):
    rng = np.random.default_rng(3)
    q = random_configurations(robot, rng, 1)
    engine = KinematicsEngine(robot)
    joint = np.arange(robot.model.njoints)
    local = rng.normal(size=(len(joint), 3))
    here = np.zeros(len(joint), dtype=int)

    def points(x):
        kinematics = engine(x)
        return (np.einsum("jkl,jl->jk", kinematics.rotation[0], local) + kinematics.position[0]).ravel()

    kinematics = engine(q)
    world = points(q).reshape(-1, 3)
    expected = central_differences(points, q, 1e-6).reshape(len(joint), 3, robot.n)
    np.testing.assert_allclose(kinematics.point_jacobian(here, joint, world), expected, atol=1e-8)
    direction = rng.normal(size=(len(joint), 3))
    np.testing.assert_allclose(
        kinematics.directional_jacobian(here, joint, world, direction),
        np.einsum("jk,jkn->jn", direction, expected),
        atol=1e-8,
    )


def test_angular_jacobians_are_differences_of_the_rotation(robot):
    q = random_configurations(robot, np.random.default_rng(4), 1)
    engine = KinematicsEngine(robot)
    kinematics = engine(q)
    step = 1e-6
    for joint in range(robot.model.njoints):
        for index in range(robot.n):
            ahead, behind = q.copy(), q.copy()
            ahead[0, index] += step
            behind[0, index] -= step
            turn = engine(ahead).rotation[0, joint] @ engine(behind).rotation[0, joint].T
            np.testing.assert_allclose(
                kinematics.angular_jacobian(joint)[0, :, index], pin.log3(turn) / (2.0 * step), atol=1e-8
            )


def test_centre_of_mass_and_its_jacobian_are_pinocchios_and_the_differences(robot):
    q = random_configurations(robot, np.random.default_rng(5), 3)
    engine = KinematicsEngine(robot)
    kinematics = engine(q)
    data = robot.model.createData()
    for t in range(3):
        np.testing.assert_allclose(kinematics.com[t], pin.centerOfMass(robot.model, data, q[t]), atol=1e-13)
        expected = pin.jacobianCenterOfMass(robot.model, data, q[t])
        np.testing.assert_allclose(kinematics.com_jacobian[t], expected, atol=1e-12)
    difference = central_differences(lambda x: engine(x).com[0], q[:1], 1e-6)
    np.testing.assert_allclose(kinematics.com_jacobian[0], difference, atol=1e-8)


def test_a_mechanism_leaves_the_robot_as_it_is():
    plain, augmented = atlas(), atlas_with_wheel()
    q = random_configurations(augmented, np.random.default_rng(6), 2)
    alone, together = KinematicsEngine(plain)(q[:, :-1]), KinematicsEngine(augmented)(q)
    np.testing.assert_allclose(together.com, alone.com, atol=1e-13)
    assert not together.com_jacobian[:, :, -1].any()
    wheel, _ = locate_frame(augmented, "valve")
    np.testing.assert_array_equal(together.topology.supports[wheel], np.arange(augmented.n) == augmented.n - 1)
    np.testing.assert_allclose(together.position[:, wheel], [[0.7, 0.0, 1.1]] * 2, atol=1e-14)


def test_planar_arm_by_hand():
    # elbow at a right angle: first link along x, second along y
    robot = chain(PLANAR)
    engine = KinematicsEngine(robot)
    q = np.array([0.0, 0.5 * np.pi])
    pose = locate_links(engine, q, ["tip"])["tip"]
    np.testing.assert_allclose(pose[:3, 3], [1.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    kinematics = engine(q[None])
    np.testing.assert_allclose(kinematics.com[0], [0.75, 0.25, 0.0], atol=1e-12)  # of (0.5, 0) and (1, 0.5)
    joint, _ = locate_frame(robot, "tip")
    columns = kinematics.point_jacobian(np.array([0]), np.array([joint]), pose[None, :3, 3])[0]
    np.testing.assert_allclose(columns, [[-1.0, -1.0], [1.0, 0.0], [0.0, 0.0]], atol=1e-12)


def test_planted_poses_are_those_of_pinocchios_frames():
    robot = atlas()
    q = random_configurations(robot, np.random.default_rng(7), 1)[0]
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    for link, pose in locate_links(KinematicsEngine(robot), q, ["l_foot", "r_tool"]).items():
        expected = data.oMf[robot.model.getFrameId(link)].homogeneous
        np.testing.assert_allclose(pose, expected, atol=1e-13)


def test_an_unknown_frame_is_named():
    with pytest.raises(KeyError, match=r"unknown frame 'l_tol' of robot 'atlas"):
        locate_frame(atlas(), "l_tol")
