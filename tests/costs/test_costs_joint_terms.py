"""Joint-space terms and tolerances: Jacobians, values worked out by hand, refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jacobian import check_jacobian
from quadratic_terms import Affine, Function
from tiny_robots import PLANAR, SPATIAL, atlas, chain, contact_free_state, random_configurations

from costs.terms import (
    AxisDirection,
    FramePose,
    Joined,
    JointDifference,
    JointTarget,
    NormWithin,
    PairWithin,
    Positive,
    WithinTolerance,
)

ROBOTS = {"atlas": atlas, "chain": lambda: chain(SPATIAL)}


@pytest.fixture(params=ROBOTS, name="robot")
def _robot(request):
    return ROBOTS[request.param]()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_joint_difference_jacobian(robot, order):
    rng = np.random.default_rng(order)
    weights = rng.uniform(0.1, 3.0, robot.n)
    weights[[0, -1]] = 0.0
    x = random_configurations(robot, rng, 5)
    term = JointDifference(5, weights, order, dt=0.5, waypoints=np.array([1, 0]))
    dense = check_jacobian(term, contact_free_state(robot), x)
    assert dense.shape == (2 * (robot.n - 2), 5 * robot.n)


def test_joint_target_jacobian(robot):
    rng = np.random.default_rng(4)
    x = random_configurations(robot, rng, 3)
    target = rng.normal(size=(2, 3))
    term = JointTarget(3, robot.n, np.array([2, 0]), np.array([1, 3, 0]), target, gain=np.array([1.0, -1.0, 0.3]))
    check_jacobian(term, contact_free_state(robot), x)


@pytest.mark.parametrize("tolerance", [0.01, np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])])
def test_within_tolerance_jacobian(robot, tolerance):
    x = random_configurations(robot, np.random.default_rng(5), 3)
    frame = "l_tool" if robot.is_floating else "tip"
    term = WithinTolerance(FramePose(robot, frame, [0, 2], np.eye(4)), tolerance)
    check_jacobian(term, contact_free_state(robot), x)


def test_norm_within_jacobian(robot):
    x = random_configurations(robot, np.random.default_rng(6), 3)
    frame = "l_tool" if robot.is_floating else "tip"
    axis = AxisDirection(robot, frame, [0, 2], np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]))
    assert check_jacobian(NormWithin(axis, 2, 0.3), contact_free_state(robot), x).shape[0] == 2


def test_a_norm_is_within_its_limit_by_hand():
    robot = chain(PLANAR)
    state = contact_free_state(robot)(np.array([[3.0, 4.0], [0.0, 0.0]]))
    pair = JointTarget(2, 2, np.array([0, 1]), np.array([0, 1]), np.zeros(2))
    np.testing.assert_allclose(NormWithin(pair, 2, 1.0).value(state), [4.0, -1.0])
    np.testing.assert_allclose(NormWithin(pair, 2, 1.0).linearize(state).jacobian.toarray()[0, :2], [0.6, 0.8])


def test_a_pair_is_within_an_octagon_of_the_disc(robot):
    x = random_configurations(robot, np.random.default_rng(6), 3)
    frame = "l_tool" if robot.is_floating else "tip"
    axis = AxisDirection(robot, frame, [0, 2], np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]))
    assert check_jacobian(PairWithin(axis, 0.3), contact_free_state(robot), x).shape[0] == 16


@given(angle=st.floats(0.0, 6.3), radius=st.floats(0.0, 3.0), limit=st.floats(0.01, 2.0))
def test_an_octagon_lies_in_its_disc_and_reaches_it_in_its_corners(angle, radius, limit):
    state = contact_free_state(chain(PLANAR))(radius * np.array([[np.cos(angle), np.sin(angle)]]))
    pair = JointTarget(1, 2, np.array([0]), np.array([0, 1]), np.zeros(2))
    most = float(PairWithin(pair, limit).value(state).max())
    off_corner = (angle % (np.pi / 4)) - np.pi / 8
    assert most == pytest.approx(radius * np.cos(np.pi / 8 - abs(off_corner)) - limit * np.cos(np.pi / 8), abs=1e-12)
    assert radius <= limit + 1e-12 or most > 0.0


def test_positive_rows_have_the_derivative_of_those_beyond_zero(robot):
    x = random_configurations(robot, np.random.default_rng(7), 3)
    frame = "l_tool" if robot.is_floating else "tip"
    pose = FramePose(robot, frame, [0, 2], np.eye(4))
    value = pose.value(contact_free_state(robot)(x))
    assert (value > 0.0).any()
    assert (value < 0.0).any()
    check_jacobian(Positive(pose), contact_free_state(robot), x)
    np.testing.assert_array_equal(Positive(pose).value(contact_free_state(robot)(x)), np.maximum(value, 0.0))


def test_differences_of_a_cubic_by_hand():
    # q1 = t^3 at dt = 2 and t = 0, 2, 4, 6; q2 = t
    robot = chain(PLANAR)
    t = np.array([0.0, 2.0, 4.0, 6.0])
    state = contact_free_state(robot)(np.stack([t**3, t], axis=1))
    value = {order: JointDifference(4, np.array([1.0, 10.0]), order, dt=2.0).value(state) for order in (1, 2, 3)}
    np.testing.assert_allclose(value[1], [4.0, 10.0, 28.0, 10.0, 76.0, 10.0])
    np.testing.assert_allclose(value[2], [12.0, 0.0, 24.0, 0.0])
    np.testing.assert_allclose(value[3], [6.0, 0.0])
    only = JointDifference(4, np.array([0.0, 10.0]), waypoints=np.array([2]))
    np.testing.assert_allclose(only.value(state), [20.0])


def test_a_gain_of_minus_one_keeps_a_joint_above_its_target():
    robot = chain(PLANAR)
    state = contact_free_state(robot)(np.array([[0.2, 1.5], [0.2, 1.1]]))
    pushed = JointTarget(2, 2, np.array([0, 1]), np.array([1]), np.array([1.3]), gain=-1.0)
    np.testing.assert_allclose(pushed.value(state), [-0.2, 0.2])  # at most zero: above


def test_tolerance_rows_by_hand():
    robot = chain(PLANAR)
    state = contact_free_state(robot)(np.array([[0.2, 1.5], [0.0, 1.0]]))
    target = JointTarget(2, 2, np.array([0, 1]), np.array([0, 1]), np.array([0.0, 1.0]))
    within = WithinTolerance(target, np.array([0.05, 0.6]))
    np.testing.assert_allclose(within.value(state), [0.15, -0.1, -0.05, -0.6, -0.25, -1.1, -0.05, -0.6])


def test_the_tolerated_rows_must_be_a_multiple_of_the_tolerances():
    robot = chain(PLANAR)
    state = contact_free_state(robot)(np.zeros((1, 2)))
    target = JointTarget(1, 2, np.array([0]), np.array([0, 1]), np.zeros(2))
    with pytest.raises(ValueError):
        WithinTolerance(target, np.array([0.1, 0.2, 0.3])).value(state)


@pytest.mark.parametrize(("arguments", "message"), [({"order": 4}, "order must be 1"), ({"dt": 0.0}, "dt must be pos")])
def test_ill_posed_differences_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        JointDifference(4, np.ones(2), **arguments)


@pytest.mark.parametrize("smooth", [(True, True), (True, False), (False, True), (False, False)])
def test_joined_rows_are_smooth_where_all_are(smooth):
    row = {True: Function(np.sin, lambda x: np.diag(np.cos(x))), False: Affine([[1.0]], 0.0)}
    assert all(part.is_smooth is is_smooth for is_smooth, part in row.items())
    assert Joined([row[is_smooth] for is_smooth in smooth]).is_smooth is (smooth == (True, True))
