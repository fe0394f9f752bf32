"""The terms that problem files need besides the others: Jacobians, and values worked out by hand."""

import numpy as np
import pytest
from jacobian import check_jacobian
from scipy.spatial.transform import Rotation
from swept_scenes import checker_of, random_motion, random_scene, state_of
from tiny_robots import PLANAR, SPATIAL, atlas, chain, contact_free_state, random_configurations

from costs.allowance import Allowance, BodyRef
from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.scene import ConvexPiece, Scene
from costs.terms import (
    Between,
    ClearancePerPair,
    FrameDisplacement,
    FramePose,
    JointDifference,
    JointTarget,
    PairClearance,
    RequiredClearance,
    Scaled,
    SweptClearance,
)
from costs.terms.pair_clearance import find_pose_contacts

ROBOTS = {"atlas": (atlas, "l_tool"), "chain": (lambda: chain(SPATIAL), "tip")}
CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


@pytest.fixture(params=ROBOTS, name="case")
def _case(request):
    make, frame = ROBOTS[request.param]
    return make(), frame


def test_frame_displacement_jacobian(case):
    robot, frame = case
    x = random_configurations(robot, np.random.default_rng(1), 4)
    dense = check_jacobian(FrameDisplacement(robot, frame, [2, 0]), contact_free_state(robot), x)
    assert dense.shape == (6, 4 * robot.n)


def test_scaled_and_bounded_rows_jacobian(case):
    robot, frame = case
    x = random_configurations(robot, np.random.default_rng(2), 3)
    pose = FramePose(robot, frame, [0, 2], np.eye(4))
    gain = np.array([1.0, 0.0, -2.0, 0.5, 3.0, 0.1])
    check_jacobian(Scaled(pose, gain, target=0.3), contact_free_state(robot), x)
    check_jacobian(Between(pose, -(gain**2), np.arange(6.0)), contact_free_state(robot), x)


def test_an_offset_frame_pose_jacobian(case):
    robot, frame = case
    x = random_configurations(robot, np.random.default_rng(3), 3)
    offset = np.eye(4)
    offset[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    offset[:3, 3] = [0.1, -0.3, 0.2]
    check_jacobian(FramePose(robot, frame, [0, 2], np.eye(4), offset=offset), contact_free_state(robot), x)


def test_an_offset_is_brought_to_the_target_by_hand():
    robot = chain(PLANAR)  # the tip of two links of 1 m
    offset = np.eye(4)
    offset[:3, 3] = [0.0, 0.5, 0.0]
    state = contact_free_state(robot)(np.array([[0.0, np.pi / 2]]))  # the tip is at (1, 1) and looks along y
    error = FramePose(robot, "tip", [0], np.eye(4), offset=offset).value(state)
    np.testing.assert_allclose(error, [0.5, 1.0, 0.0, 0.0, 0.0, np.pi / 2], atol=1e-12)


def test_displacement_and_joint_rows_by_hand():
    robot = chain(PLANAR)
    state = contact_free_state(robot)(np.array([[0.0, 0.0], [np.pi / 2, 0.0], [np.pi / 2, np.pi / 2]]))
    moved = FrameDisplacement(robot, "tip", [0, 1])
    np.testing.assert_allclose(moved.value(state), [-2.0, 2.0, 0.0, -1.0, -1.0, 0.0], atol=1e-12)
    speed = Scaled(JointDifference(3, np.ones(2)), np.array([2.0, 1.0]), target=1.0)
    np.testing.assert_allclose(speed.value(state), [np.pi - 2.0, -1.0, -2.0, np.pi / 2 - 1.0])
    offset = JointTarget(3, 2, np.array([2]), np.array([0, 1]), np.pi / 2 - np.array([0.07, 0.07]))
    inside = Between(offset, -0.1, np.array([0.05, 0.2]))
    np.testing.assert_allclose(inside.value(state), [0.02, -0.13, -0.17, -0.17])


@pytest.mark.parametrize("n_waypoints", [1, 4])
def test_pair_clearance_without_exceptions_is_the_swept_clearance_times_its_gain(n_waypoints):
    robot = atlas()
    rng = np.random.default_rng(4)
    checker = checker_of(robot, random_scene(rng, 12, 0.8), 0.05, buffer=0.1)
    state = state_of(robot, checker)(random_motion(robot, rng, n_waypoints, 0.1))
    n_intervals = max(n_waypoints - 1, 1)
    asked = ClearancePerPair.of(checker, RequiredClearance(np.full(n_intervals, 0.05), np.full(n_intervals, 3.0)))
    rows = PairClearance(robot, asked).linearize(state)
    parts = [SweptClearance(robot, is_self=is_self) for is_self in (False, True)]
    assert len(rows.value) > 10
    np.testing.assert_allclose(rows.value, 3.0 * np.concatenate([part.value(state) for part in parts]))
    dense = np.concatenate([part.linearize(state).jacobian.toarray() for part in parts])
    np.testing.assert_allclose(rows.jacobian.toarray(), 3.0 * dense)
    np.testing.assert_array_equal(PairClearance(robot, asked).value(state), rows.value)


def test_contacts_of_poses_are_those_of_each_waypoint_alone():
    robot = atlas()
    rng = np.random.default_rng(5)
    checker = checker_of(robot, random_scene(rng, 12, 0.8), 0.05, buffer=0.1)
    engine = KinematicsEngine(robot)
    x = random_motion(robot, rng, 3, 0.1)
    found = find_pose_contacts(checker, engine(x))
    assert set(found.first.tolist()) == {0, 1, 2}
    for t in range(3):
        alone = checker(engine(x[t : t + 1]))
        here = found.where(found.first == t)
        pairs = [sorted(zip(c.body, c.other, c.is_self, np.round(c.distance, 9), strict=True)) for c in (alone, here)]
        assert pairs[0] == pairs[1]


def _box_above(height: float):
    """A 1 m link along x with its underside 5 cm below the axis, and a box whose top is that far under the axis."""
    robot = chain(PLANAR[:1])
    return robot, Scene((ConvexPiece("box", CUBE + np.array([0.5, 0.0, -0.1 - height])),))


def test_pair_clearance_by_hand():
    robot, scene = _box_above(0.08)  # 3 cm apart
    checker = checker_of(robot, scene, 0.2)
    state = state_of(robot, checker)(np.array([[0.0], [0.0], [1.5]]))
    swept = ClearancePerPair.of(checker, RequiredClearance(np.array([0.05, 0.04]), np.array([20.0, 10.0])))
    np.testing.assert_allclose(PairClearance(robot, swept).value(state), [0.4, 0.1], atol=1e-9)
    at_poses = ClearancePerPair.of(
        checker, RequiredClearance(np.array([0.05, 0.04, 0.04]), np.array([20.0, 0.0, 10.0]))
    )
    value = PairClearance(robot, at_poses, poses=checker).value(state)  # the link has turned away at the last
    assert value[0] == pytest.approx(0.4)
    assert len(value) == 1 or value[1] < 0.0


def test_a_pair_may_be_asked_for_something_else_or_nothing_or_no_more_than_it_has():
    robot, scene = _box_above(0.08)
    checker = checker_of(robot, scene, 0.2)
    state = state_of(robot, checker)(np.array([[0.0], [0.0]]))
    usual = RequiredClearance(np.array([0.05]), np.array([1.0]))
    link1, above = BodyRef.of_link("link1"), BodyRef.of_piece("box")
    special = [(link1, above, RequiredClearance(np.array([0.07]), np.array([2.0])))]
    value = PairClearance(robot, ClearancePerPair.of(checker, usual, special)).value(state)
    np.testing.assert_allclose(value, [0.08], atol=1e-9)
    exempt = ClearancePerPair.of(checker, usual, exempt=[Allowance(link1, above, 0.0)])
    assert len(PairClearance(robot, exempt).value(state)) == 0
    relaxed = ClearancePerPair.of(checker, usual).relax_to(state.contacts, 0.01)
    np.testing.assert_allclose(PairClearance(robot, relaxed).value(state), [-0.01], atol=1e-9)
    assert relaxed.relax_to(Contacts.none(), 0.0).largest == 0.05


@pytest.mark.parametrize("n_waypoints", [1, 3])
def test_pose_clearance_gradient_against_differences(n_waypoints):
    robot = chain(SPATIAL)
    scene = Scene((ConvexPiece("tip", np.array([[0.9, 0.1, 0.5], [0.9, 0.1, 0.2], [1.2, 0.1, 0.2], [0.9, 0.4, 0.2]])),))
    checker = checker_of(robot, scene, 0.5)
    x = np.random.default_rng(6).uniform(-0.15, 0.15, (n_waypoints, robot.n))
    asked = ClearancePerPair.of(
        checker,
        RequiredClearance(np.full(n_waypoints, 0.5), np.zeros(n_waypoints)),
        [
            (
                BodyRef.of_link("link4"),
                BodyRef.of_piece("tip"),
                RequiredClearance(np.full(n_waypoints, 0.5), np.arange(1.0, n_waypoints + 1.0)),
            )
        ],
    )
    term = PairClearance(robot, asked, poses=checker)
    dense = check_jacobian(term, state_of(robot, checker), x, tolerance=1e-4)
    assert dense.shape == (n_waypoints, x.size)
    assert np.abs(dense).max() > 0.1
