"""Starts that lead the goal's links straight to it, with the holds kept."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_robots import atlas

from costs.kinematics import locate_links
from costs.scene import Scene
from service.body.aims import Aims
from service.body.holds import largest_hold_error
from service.body.kept import make_kept_poses
from service.body.paths import straight_path
from service.body.poses import BASE_SPREAD, JOINT_SPREAD, random_guesses
from service.body.whole_body import WholeBody
from service.request.keep import KeepRequest
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.tasks.reach.goal import Goal, lead_path, make_line_holds

FEET = ("l_foot", "r_foot")


def with_both_hands() -> WholeBody:
    """Atlas on its feet with hands that keep their relative pose."""
    robot = atlas()
    ready = robot.postures["reach_ready"]
    body = WholeBody.standing(robot, Scene(), ready, FEET, Aims())
    return replace(body, kept=make_kept_poses(robot, ready, [KeepRequest("r_hand", "l_hand")]))


def asked(body: WholeBody, **more) -> Goal:
    """The left hand 15 cm forwards and 20 cm up from where it is."""
    place = locate_links(body.engine, body.nominal, ["l_hand"])["l_hand"]
    goal = PoseGoalRequest("l_hand", tuple(place[:3, 3] + [0.15, 0.0, 0.2]), **more)
    return Goal.of(body, GoalRequest(poses=(goal,)))


def turned(body: WholeBody, angle: float) -> tuple[float, float, float, float]:
    """The left hand's orientation turned about the vertical."""
    place = locate_links(body.engine, body.nominal, ["l_hand"])["l_hand"]
    w, x, y, z = (Rotation.from_rotvec([0.0, 0.0, angle]) * Rotation.from_matrix(place[:3, :3])).as_quat(
        scalar_first=True
    )
    return (w, x, y, z)


@pytest.mark.parametrize("free_axis", [None, "none", "y"])
def test_a_led_start_arrives_and_keeps_what_is_held_all_along(free_axis):
    body = with_both_hands()
    more = {} if free_axis is None else {"quaternion_wxyz": turned(body, -0.3), "free_axis": free_axis}
    goal = asked(body, **more)
    q = lead_path(goal, 12)
    np.testing.assert_array_equal(q[0], body.nominal)
    assert largest_hold_error(body.engine, q, body.holds()).max() < 1e-4
    assert largest_hold_error(body.engine, q[-1:], make_line_holds(goal, 1.0)).max() < 1e-4
    assert np.abs(np.diff(q, axis=0)).max() < 0.3


def test_half_way_the_hand_is_half_way():
    body = with_both_hands()
    q = lead_path(asked(body), 11)
    first, middle, last = (locate_links(body.engine, row, ["l_hand"])["l_hand"][:3, 3] for row in q[[0, 5, 10]])
    np.testing.assert_allclose(middle, 0.5 * (first + last), atol=1e-4)


def test_a_goal_out_of_reach_is_led_to_within_the_limits():
    body = with_both_hands()
    far = Goal.of(body, GoalRequest(poses=(PoseGoalRequest("l_hand", (3.0, 0.0, 1.0)),)))
    q = lead_path(far, 6)
    assert np.isfinite(q).all()
    assert np.all((q >= body.robot.lower) & (q <= body.robot.upper))


def test_without_a_link_that_shall_arrive_nothing_is_led():
    body = with_both_hands()
    assert lead_path(Goal.of(body, GoalRequest(posture="stand")), 5) is None


def test_a_straight_line_is_brought_onto_what_is_held():
    body = with_both_hands()
    line = straight_path(body.nominal, lead_path(asked(body), 8)[-1], 8)
    on_holds = body.project_onto_holds(line)
    assert largest_hold_error(body.engine, line, body.holds()).max() > 1e-3
    assert largest_hold_error(body.engine, on_holds, body.holds()).max() < 1e-8
    np.testing.assert_array_equal(on_holds[0], line[0])


def test_random_guesses_are_about_the_start_within_the_limits_and_the_same_for_the_same_seed():
    body = with_both_hands()
    guesses = np.array(random_guesses(body, 200, seed=3))
    np.testing.assert_array_equal(guesses, random_guesses(body, 200, seed=3))
    assert np.abs(guesses - random_guesses(body, 200, seed=4)).max() > 0.1
    assert np.all((guesses >= body.robot.lower) & (guesses <= body.robot.upper))
    elbow = body.robot.joint_names.index("l_arm_elx")
    assert guesses[:, elbow].std() == pytest.approx(JOINT_SPREAD, rel=0.2)
    assert guesses[:, 0].std() == pytest.approx(BASE_SPREAD, rel=0.2)
