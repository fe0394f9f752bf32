"""Pose, axis and half-space terms: Jacobians over all waypoints and values worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jacobian import check_jacobian
from scipy.spatial.transform import Rotation
from tiny_robots import PLANAR, SPATIAL, atlas, atlas_with_wheel, chain, contact_free_state, random_configurations

from costs.kinematics import KinematicsEngine, locate_links
from costs.terms import AxisDirection, BeyondBall, BeyondBox, FramePose, LookAt, PointHalfSpace

CASES = {
    "atlas hand": (atlas, "l_tool", None),
    "atlas hand in its pelvis": (atlas, "r_tool", "pelvis"),
    "atlas hand in its other hand": (atlas, "r_hand", "l_hand"),
    "atlas hand on a wheel": (atlas_with_wheel, "l_tool", "valve"),
    "wheel in an atlas hand": (atlas_with_wheel, "valve", "l_tool"),
    "chain": (lambda: chain(SPATIAL), "tip", None),
    "chain in its first link": (lambda: chain(SPATIAL), "tip", "link1"),
    "chain in its base": (lambda: chain(SPATIAL), "tip", "base"),
}
HERE = np.array([2, 0])


@pytest.fixture(params=CASES, name="case")
def _case(request):
    make, frame, reference = CASES[request.param]
    robot = make()
    return robot, frame, reference, random_configurations(robot, np.random.default_rng(11), 3)


def relative_rotation(robot, frame, reference, q):
    poses = locate_links(KinematicsEngine(robot), q, [frame, *([reference] if reference else [])])
    base = poses[reference][:3, :3] if reference else np.eye(3)
    return base.T @ poses[frame][:3, :3]


def axis_at_angle(robot, frame, reference, q, axis, angle):
    """A direction that the frame's axis misses by just that angle."""
    along = relative_rotation(robot, frame, reference, q) @ axis
    across = np.cross(along, [0.3, -0.5, 0.8])
    return Rotation.from_rotvec(angle * across / np.linalg.norm(across)).apply(along)


def test_frame_pose_jacobian(case):
    robot, frame, reference, x = case
    rng = np.random.default_rng(12)
    target = np.tile(np.eye(4), (2, 1, 1))
    target[:, :3, :3] = Rotation.random(2, random_state=3).as_matrix()
    target[:, :3, 3] = rng.normal(size=(2, 3))
    term = FramePose(robot, frame, HERE, target, reference=reference)
    dense = check_jacobian(term, contact_free_state(robot), x)
    axes = np.array([True, False, True, False, False, True])
    some = check_jacobian(FramePose(robot, frame, HERE, target, axes, reference), contact_free_state(robot), x)
    np.testing.assert_array_equal(some, dense[np.tile(axes, 2)])


@pytest.mark.parametrize("angle", [1e-9, 1e-5, 0.3, 0.5 * np.pi, 2.0, 3.0, 3.1])
def test_axis_direction_jacobian_at_any_angle(case, angle):
    robot, frame, reference, x = case
    axis = np.array([0.6, 0.0, 0.8])
    direction = axis_at_angle(robot, frame, reference, x[2], axis, angle)
    term = AxisDirection(robot, frame, [2], axis, direction, reference)
    state = contact_free_state(robot)(x)
    assert np.linalg.norm(term.value(state)) == pytest.approx(angle, rel=1e-9, abs=1e-11)
    # close to the opposite direction the rows turn about it 1 / (pi - angle) times as fast as the axis does
    check_jacobian(term, contact_free_state(robot), x, step=1e-6, tolerance=1e-6 if angle < 3.05 else 1e-4)


def test_axis_direction_over_several_waypoints(case):
    robot, frame, reference, x = case
    term = AxisDirection(robot, frame, HERE, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.3, 1.0]), reference)
    assert check_jacobian(term, contact_free_state(robot), x, step=1e-6).shape[0] == 4


def test_point_half_space_jacobian(case):
    robot, frame, _, x = case
    normal, point = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, -0.3])
    check_jacobian(PointHalfSpace(robot, frame, HERE, normal, 0.4, point), contact_free_state(robot), x)
    check_jacobian(PointHalfSpace(robot, frame, HERE, normal, 0.4), contact_free_state(robot), x)


def planar_state(*q):
    robot = chain(PLANAR)
    return robot, contact_free_state(robot)(np.array(q))


def test_frame_pose_by_hand():
    # tip at (1, 1, 0) turned by 90 degrees; target at (1, 0, 0) turned by 180 degrees about z
    robot, state = planar_state([0.0, 0.5 * np.pi])
    target = np.diag([-1.0, -1.0, 1.0, 1.0])
    target[0, 3] = 1.0
    value = FramePose(robot, "tip", [0], target).value(state)
    np.testing.assert_allclose(value, [0.0, -1.0, 0.0, 0.0, 0.0, -0.5 * np.pi], atol=1e-12)


def test_relative_pose_by_hand():
    # in the frame of the first link the tip stands at (1, 0, 0) + (cos, sin) of the second joint alone
    robot, state = planar_state([0.7, 0.5 * np.pi], [-1.2, 0.5 * np.pi])
    value = FramePose(robot, "tip", [0, 1], np.eye(4), reference="link1").value(state)
    np.testing.assert_allclose(value, [1.0, 1.0, 0.0, 0.0, 0.0, 0.5 * np.pi] * 2, atol=1e-12)


def test_a_pose_at_its_target_is_zero_and_half_a_turn_away_is_pi():
    robot, state = planar_state([0.0, 0.0])
    target = np.eye(4)
    target[0, 3] = 2.0
    np.testing.assert_allclose(FramePose(robot, "tip", [0], target).value(state), np.zeros(6), atol=1e-12)
    target[:3, :3] = np.diag([1.0, -1.0, -1.0])
    rotation = FramePose(robot, "tip", [0], target).value(state)[3:]
    np.testing.assert_allclose(np.abs(rotation), [np.pi, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.5 * np.pi, 3.0, np.pi])
def test_axis_direction_norm_is_the_angle_by_hand(angle):
    # the last link points along x turned by q2 about z, so it misses x by q2; turning about its own axis is free
    robot, state = planar_state([0.0, angle])
    value = AxisDirection(robot, "tip", [0], np.array([2.0, 0.0, 0.0]), np.array([3.0, 0.0, 0.0])).value(state)
    assert np.linalg.norm(value) == pytest.approx(angle, abs=1e-9)


@given(seed=st.integers(0, 10_000))
def test_axis_direction_is_free_to_turn_about_the_axis(seed):
    rng = np.random.default_rng(seed)
    robot = chain(SPATIAL)
    x = random_configurations(robot, rng, 1)
    turned = x.copy()
    turned[0, 3] = rng.uniform(-2.0, 2.0)  # the last joint turns about the tip's x axis
    term = AxisDirection(robot, "tip", [0], np.array([1.0, 0.0, 0.0]), rng.normal(size=3))
    make_state = contact_free_state(robot)
    np.testing.assert_allclose(term.value(make_state(x)), term.value(make_state(turned)), atol=1e-9)


@pytest.mark.parametrize("short_of_pi", [0.0, 1e-12, 1e-9, 1e-7, 1e-5])
def test_an_axis_opposite_its_direction_is_pi_away_with_a_way_back(short_of_pi):
    robot, state = planar_state([0.0, np.pi - short_of_pi])
    term = AxisDirection(robot, "tip", [0], np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    rows = term.linearize(state)
    np.testing.assert_array_equal(rows.value, term.value(state))
    assert np.linalg.norm(rows.value) == pytest.approx(np.pi - short_of_pi, abs=1e-9)
    assert np.abs(rows.jacobian.toarray()).max() < 10.0  # finite, and in the scale of an angle per radian
    spatial = chain(SPATIAL)
    opposite = -relative_rotation(spatial, "tip", None, np.array([0.2, 0.3, 0.1, 0.4]))[:, 0]
    away = AxisDirection(spatial, "tip", [0], np.array([1.0, 0.0, 0.0]), opposite)
    make_state = contact_free_state(spatial)
    x = np.array([[0.2, 0.3, 0.1, 0.4]])
    back = away.linearize(make_state(x))
    step = -back.jacobian.T @ back.value
    assert np.linalg.norm(away.value(make_state(x + (0.1 * step / np.linalg.norm(step))[None]))) < np.pi - 0.02


def test_point_half_space_by_hand():
    # tip at (1, 1, 0); 45 degree plane through the origin: (1 + 1) / sqrt 2; 0.5 beyond the tip along the link: + y
    robot, state = planar_state([0.0, 0.5 * np.pi])
    normal = np.array([5.0, 5.0, 0.0])
    np.testing.assert_allclose(PointHalfSpace(robot, "tip", [0], normal, 1.0).value(state), [np.sqrt(2.0) - 1.0])
    beyond = PointHalfSpace(robot, "tip", [0], normal, 0.0, np.array([0.5, 0.0, 0.0]))
    np.testing.assert_allclose(beyond.value(state), [2.5 / np.sqrt(2.0)])


def test_a_zero_direction_and_an_unknown_frame_are_refused():
    robot = chain(PLANAR)
    with pytest.raises(ValueError, match="direction must not be zero"):
        AxisDirection(robot, "tip", [0], np.zeros(3), np.array([1.0, 0.0, 0.0]))
    with pytest.raises(KeyError, match="unknown frame 'top'"):
        FramePose(robot, "top", [0], np.eye(4))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.0, -1.0)])
def test_look_at_jacobian(case, axis):
    robot, frame, reference, x = case
    place = np.random.default_rng(22).normal(size=3) * 2.0
    term = LookAt(robot, frame, HERE, np.array(axis), place, reference)
    check_jacobian(term, contact_free_state(robot), x)


def test_look_at_is_the_angle_to_the_place(case):
    robot, frame, reference, x = case
    place = np.array([1.7, -0.4, 0.9])
    rows = LookAt(robot, frame, HERE, np.array([0.0, 1.0, 0.0]), place, reference).value(contact_free_state(robot)(x))
    for row, q in zip(rows.reshape(2, 2), x[HERE], strict=True):
        poses = locate_links(KinematicsEngine(robot), q, [frame, *([reference] if reference else [])])
        world = place if reference is None else poses[reference][:3, :3] @ place + poses[reference][:3, 3]
        sight = world - poses[frame][:3, 3]
        cosine = poses[frame][:3, 1] @ sight / np.linalg.norm(sight)
        assert np.linalg.norm(row) == pytest.approx(np.arccos(cosine), abs=1e-9)


def test_excesses_have_the_derivatives_of_what_is_beyond(case):
    robot, frame, reference, x = case
    state = contact_free_state(robot)
    pose = FramePose(robot, frame, HERE, np.eye(4), (True, True, True, False, False, False), reference)
    now = pose.value(state(x)).reshape(2, 3)
    lower, upper = now.min(axis=0) - np.array([0.1, -0.2, 1.0]), now.max(axis=0) + np.array([-0.05, 1.0, 1.0])
    lower, upper = np.minimum(lower, upper - 0.01), upper
    check_jacobian(BeyondBox(pose, lower, upper), state, x)
    for share in (0.4, 2.0):  # outside, and inside for the larger of the two
        check_jacobian(BeyondBall(pose, 3, share * float(np.linalg.norm(now, axis=1).mean())), state, x)


@given(st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=2), st.floats(0.05, 2.0))
def test_what_is_beyond_a_ball_leads_to_its_border(joints, limit):
    robot = chain(PLANAR)
    q = np.resize(np.array(joints), robot.n)[None]
    pose = FramePose(robot, "tip", [0], np.eye(4), (True, True, False, False, False, False))
    state = contact_free_state(robot)(q)
    inside = pose.value(state) - BeyondBall(pose, 2, limit).value(state)
    assert np.linalg.norm(inside) == pytest.approx(min(limit, float(np.linalg.norm(pose.value(state)))), abs=1e-9)
