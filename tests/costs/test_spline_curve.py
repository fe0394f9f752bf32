"""The executed spline: it keeps holds, rests at borders, stays within limits and adds waypoints only where needed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_robots import PLANAR, atlas, chain, contact_free_state

from costs.kinematics import KinematicsEngine, locate_links
from costs.terms import FramePose, PointHalfSpace
from service.body.task_plan import KeptCurve
from service.motion.spline import PhasePath, make_spline

FREE = np.full(2, 3.0)


def tip_height_hold(robot):
    """The planar arm's tip stays on the line y = 1."""
    return lambda waypoints: PointHalfSpace(robot, "tip", waypoints, np.array([0.0, 1.0, 0.0]), 1.0)


def foot_holds(robot, q):
    poses = locate_links(KinematicsEngine(robot), q, ["l_foot", "r_foot"])
    return tuple(
        lambda waypoints, link=link, pose=pose: FramePose(robot, link, waypoints, pose) for link, pose in poses.items()
    )


def largest_residual(robot, holds, q):
    state = contact_free_state(robot)(q)
    return max(np.abs(hold(np.arange(len(q))).value(state)).max() for hold in holds)


def between(curve, per_interval=20):
    """Path parameters strictly between the knots."""
    u = np.linspace(0.0, 1.0, per_interval + 1)[1:-1]
    return (curve.knots[:-1, None] + np.diff(curve.knots)[:, None] * u).ravel()


def arm_with_tip_at(x):
    """(S, 2) configurations of the planar arm, elbow bent to the left, whose tip stands at (x, 1)."""
    elbow = 2.0 * np.arccos(0.5 * np.hypot(x, 1.0))
    return np.stack([np.arctan2(1.0, x) - 0.5 * elbow, elbow], axis=1)


def sliding_arm(n_waypoints=6, noise=1e-3):
    """Waypoints of the planar arm whose tip moves along y = 1, nearly."""
    q = arm_with_tip_at(np.linspace(1.2, 0.4, n_waypoints))
    return q + noise * np.random.default_rng(1).normal(size=q.shape) * (np.arange(n_waypoints)[:, None] > 0)


def test_holds_are_kept_at_knots_and_nearly_so_between():
    robot = chain(PLANAR)
    hold = tip_height_hold(robot)
    path = PhasePath("slide", sliding_arm(), (hold,), drift=5e-4)
    spline = make_spline(KinematicsEngine(robot), [path], -FREE, FREE, np.ones(2))
    assert largest_residual(robot, [hold], spline.curve.positions) < 1e-9
    assert largest_residual(robot, [hold], spline.curve(between(spline.curve))) < 5e-4


def test_planted_feet_of_a_whole_body_are_kept():
    robot = atlas()
    stand = robot.postures["stand"]
    holds = foot_holds(robot, stand)
    rng = np.random.default_rng(2)
    step = rng.uniform(-0.12, 0.12, robot.n)
    q = stand + np.linspace(0.0, 1.0, 6)[:, None] * step
    spline = make_spline(
        KinematicsEngine(robot), [PhasePath("lean", q, holds)], robot.lower, robot.upper, np.ones(robot.n)
    )
    assert largest_residual(robot, holds, spline.curve.positions) < 1e-9
    assert largest_residual(robot, holds, spline.curve(between(spline.curve, 9))) < 5e-4
    np.testing.assert_array_equal(spline.curve.positions[0], stand)


def test_knot_velocities_do_not_break_the_holds():
    robot = chain(PLANAR)
    hold = tip_height_hold(robot)
    spline = make_spline(KinematicsEngine(robot), [PhasePath("s", sliding_arm(), (hold,))], -FREE, FREE, np.ones(2))
    state = contact_free_state(robot)(spline.curve.positions)
    jacobian = hold(np.arange(len(spline.curve.knots))).linearize(state).jacobian
    assert np.abs(spline.curve.tangents).max() > 0.1
    np.testing.assert_allclose(jacobian @ spline.curve.tangents.ravel(), 0.0, atol=1e-9)


def test_the_curve_rests_at_the_borders_of_phases_and_moves_on_within():
    robot = chain(PLANAR)
    out = np.linspace([0.0, 0.0], [1.0, 0.5], 4)
    back = np.linspace([1.0, 0.5], [0.2, -0.5], 5)
    spline = make_spline(
        KinematicsEngine(robot), [PhasePath("out", out, ()), PhasePath("back", back, ())], -FREE, FREE, np.ones(2)
    )
    assert spline.ends == (0, 3, 7)
    np.testing.assert_allclose(spline.curve.tangents[list(spline.ends)], 0.0)
    assert (np.abs(np.delete(spline.curve.tangents, spline.ends, axis=0)) > 0.1).all()
    np.testing.assert_allclose(spline.curve.positions, np.concatenate([out, back[1:]]))


@given(seed=st.integers(0, 10_000))
def test_the_curve_stays_within_limits_that_its_waypoints_keep(seed):
    rng = np.random.default_rng(seed)
    robot = chain(PLANAR)
    lower, upper = np.array([-1.0, -0.5]), np.array([0.8, 1.0])
    # waypoints crowd against the limits, where the neighbours' slopes pull beyond them
    q = np.clip(rng.uniform(-2.0, 2.0, size=(7, 2)), lower + 0.01, upper - 0.01)
    spline = make_spline(KinematicsEngine(robot), [PhasePath("q", q, ())], lower, upper, np.ones(2))
    dense = spline.curve(between(spline.curve, 50))
    assert (dense >= lower - 1e-9).all()
    assert (dense <= upper + 1e-9).all()


@given(seed=st.integers(0, 10_000))
def test_the_curve_stays_within_limits_while_it_keeps_a_hold(seed):
    rng = np.random.default_rng(seed)
    robot = chain(PLANAR)
    hold = tip_height_hold(robot)
    x = rng.uniform(0.4, 1.2, 6)  # to and fro, so that the joints turn back within a hair of their limits
    q = arm_with_tip_at(x)
    motion = arm_with_tip_at(np.linspace(x.min(), x.max(), 200))  # what the hold asks of the joints
    room = rng.uniform(1e-4, 0.02, 2)
    lower, upper = motion.min(axis=0) - room, motion.max(axis=0) + room
    spline = make_spline(KinematicsEngine(robot), [PhasePath("s", q, (hold,), drift=0.05)], lower, upper, np.ones(2))
    dense = spline.curve(between(spline.curve, 50))
    assert (dense >= lower - 1e-9).all()
    assert (dense <= upper + 1e-9).all()


def test_waypoints_are_inserted_where_a_hold_would_drift_and_nowhere_else():
    robot = chain(PLANAR)
    hold = tip_height_hold(robot)
    coarse = PhasePath("s", sliding_arm(4, noise=0.0), (hold,), drift=1e-4)
    spline = make_spline(KinematicsEngine(robot), [coarse], -FREE, FREE, np.ones(2))
    assert spline.is_waypoint.sum() == 4
    assert not spline.is_waypoint.all()
    np.testing.assert_allclose(spline.curve.positions[spline.is_waypoint], coarse.q, atol=1e-6)
    loose = make_spline(
        KinematicsEngine(robot), [PhasePath("s", coarse.q, (hold,), drift=1.0)], -FREE, FREE, np.ones(2)
    )
    assert loose.is_waypoint.all()
    free = make_spline(KinematicsEngine(robot), [PhasePath("s", coarse.q, ())], -FREE, FREE, np.ones(2))
    assert free.is_waypoint.all()


def test_only_the_phase_that_drifts_gets_more_waypoints():
    robot = chain(PLANAR)
    hold = tip_height_hold(robot)
    slide = sliding_arm(4, noise=0.0)
    lift = np.linspace(slide[-1], [0.3, 0.3], 4)
    spline = make_spline(
        KinematicsEngine(robot),
        [PhasePath("slide", slide, (hold,), drift=1e-4), PhasePath("lift", lift, ())],
        -FREE, FREE, np.ones(2),
    )  # fmt: skip
    border = spline.ends[1]
    assert not spline.is_waypoint[:border].all()
    assert spline.is_waypoint[border:].all()
    assert spline.ends[2] - border == 3


def test_the_parameter_runs_at_the_natural_speed_of_the_slowest_joint():
    robot = chain(PLANAR)
    q = np.array([[0.0, 0.0], [1.0, 0.1], [1.0, 1.1], [1.0, 1.1]])
    spline = make_spline(KinematicsEngine(robot), [PhasePath("q", q, ())], -FREE, FREE, np.array([2.0, 0.5]))
    np.testing.assert_allclose(spline.curve.knots, [0.0, 0.5, 2.5, 2.501])


@pytest.mark.parametrize("n_waypoints", [2, 3])
def test_the_shortest_paths_make_a_curve(n_waypoints):
    robot = chain(PLANAR)
    q = np.linspace([0.0, 0.0], [1.0, 1.0], n_waypoints)
    spline = make_spline(KinematicsEngine(robot), [PhasePath("q", q, ())], -FREE, FREE, np.ones(2))
    np.testing.assert_allclose(spline.curve(spline.curve.knots), q)


def test_a_curve_that_is_kept_is_taken_as_it_is():
    robot = chain(PLANAR)
    hold = tip_height_hold(robot)
    path = PhasePath("slide", sliding_arm(), (hold,), drift=5e-4)
    made = make_spline(KinematicsEngine(robot), [path], -FREE, FREE, np.ones(2)).curve
    before = PhasePath("reach", np.array([[0.0, 0.5], made.positions[0]]), ())
    kept = PhasePath("slide", made.positions, (), kept=KeptCurve(made))
    spline = make_spline(KinematicsEngine(robot), [before, kept], -FREE, FREE, np.ones(2))
    own = spline.curve.cut(slice(spline.ends[1], None))
    np.testing.assert_array_equal(own.positions, made.positions)
    np.testing.assert_array_equal(own.tangents, made.tangents)
    np.testing.assert_allclose(own.knots - own.knots[0], made.knots - made.knots[0])
    assert spline.is_waypoint.all()
