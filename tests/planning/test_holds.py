"""What stays put: residuals and Jacobians of separate configurations, and the nearest ones that keep it."""

import numpy as np
from tiny_robots import atlas, contact_free_state, random_configurations

from costs.kinematics import KinematicsEngine, locate_links
from costs.terms import FramePose
from service.body.holds import (
    CLOSE,
    PROJECTION_TOLERANCE,
    largest_hold_error,
    least_norm_step,
    linearize_holds,
    project_onto_holds,
    project_within_limits,
)
from service.body.kept import make_kept_poses
from service.request.keep import KeepRequest


def standing_with_both_hands():
    """Atlas on its feet, with hands that keep their relative pose, a little off at a few configurations."""
    robot = atlas()
    ready = robot.postures["reach_ready"]
    engine = KinematicsEngine(robot)
    feet = locate_links(engine, ready, ["l_foot", "r_foot"])
    holds = [lambda where, link=link: FramePose(robot, link, where, feet[link]) for link in feet]
    (kept,) = make_kept_poses(robot, ready, [KeepRequest("l_hand", "r_hand", free_axis="y")])
    return robot, engine, ready, (*holds, *kept.holds(robot))


def test_each_configuration_has_its_own_rows_and_columns():
    robot, engine, ready, holds = standing_with_both_hands()
    q = ready + 0.05 * random_configurations(robot, np.random.default_rng(2), 3)
    value, jacobian = linearize_holds(engine, q, holds)
    assert jacobian.shape == (3, 6 + 6 + 3 + 2, robot.n)
    for index in range(3):
        state = contact_free_state(robot)(q[index : index + 1])
        rows = [hold(np.array([0])).linearize(state) for hold in holds]
        np.testing.assert_allclose(value[index], np.concatenate([one.value for one in rows]), atol=1e-12)
        np.testing.assert_allclose(jacobian[index], np.vstack([one.jacobian.toarray() for one in rows]), atol=1e-12)


def test_a_projected_configuration_keeps_the_holds_and_is_near():
    robot, engine, ready, holds = standing_with_both_hands()
    q = ready + 0.05 * random_configurations(robot, np.random.default_rng(3), 4)
    on_holds = project_onto_holds(engine, q, holds)
    assert largest_hold_error(engine, q, holds).min() > 0.01
    assert largest_hold_error(engine, on_holds, holds).max() < PROJECTION_TOLERANCE
    # what separates it from the first one is across the holds, up to their curvature
    _, jacobian = linearize_holds(engine, on_holds, holds)
    moved = q - on_holds
    along = moved - least_norm_step(jacobian, np.einsum("skn,sn->sk", jacobian, moved))
    assert np.linalg.norm(along, axis=1).max() < 0.1 * np.linalg.norm(moved, axis=1).min()


def test_without_holds_nothing_moves():
    robot, engine, _, _ = standing_with_both_hands()
    q = random_configurations(robot, np.random.default_rng(4), 2)
    np.testing.assert_array_equal(project_onto_holds(engine, q, ()), q)
    np.testing.assert_array_equal(largest_hold_error(engine, q, ()), np.zeros(2))


def test_coordinates_stay_at_the_limit_that_they_reach():
    robot, engine, ready, holds = standing_with_both_hands()
    q = ready + 0.05 * random_configurations(robot, np.random.default_rng(3), 4)
    free = project_onto_holds(engine, q, holds)
    # a limit between each configuration and its nearest one on the holds, for the joint that moves farthest
    moves = np.abs(free - q).max(axis=0)
    moves[:6] = 0.0
    joint = int(moves.argmax())
    low, high = robot.lower.copy(), robot.upper.copy()
    low[joint], high[joint] = q[:, joint].min(), q[:, joint].max()
    assert ((free[:, joint] < low[joint]) | (free[:, joint] > high[joint])).any()
    inside = project_within_limits(engine, np.clip(q, low, high), holds, low[None], high[None])
    assert (inside >= low).all()
    assert (inside <= high).all()
    assert largest_hold_error(engine, inside, holds).max() < CLOSE
