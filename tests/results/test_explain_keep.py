"""Reasons why no motion can reach a goal and keep what it shall: true where given, silent where there may be one."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_robots import atlas

from costs.kinematics import locate_links
from costs.scene import Scene
from service.body.aims import Aims
from service.body.holds import project_onto_holds
from service.body.kept import make_kept_poses
from service.body.whole_body import WholeBody
from service.explain.distance import find_never_kept
from service.request.keep import KeepRequest
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.tasks.reach.goal import Goal
from service.verify import Target


def keeping(*keep: KeepRequest) -> WholeBody:
    robot = atlas()
    ready = robot.postures["reach_ready"]
    body = WholeBody.standing(robot, Scene(), ready, ("l_foot", "r_foot"), Aims())
    return replace(body, kept=make_kept_poses(robot, ready, keep))


def places(body: WholeBody, q: np.ndarray, **shift: list[float]) -> tuple[Target, ...]:
    """Goals for frames where they are at ``q``, shifted by so much."""
    now = locate_links(body.engine, q, list(shift))
    poses = tuple(PoseGoalRequest(frame, tuple(now[frame][:3, 3] + by)) for frame, by in shift.items())
    return Goal.of(body, GoalRequest(poses=poses)).targets()


HANDS = KeepRequest("r_hand", "l_hand")


def test_hands_that_shall_arrive_farther_apart_than_they_are_held():
    body = keeping(HANDS)
    apart = places(body, body.nominal, l_tool=[0.0, 0.1, 0.0], r_tool=[0.0, 0.0, 0.0])
    assert find_never_kept(body, apart) == (
        "the goals of r_tool and l_tool are 0.69 m apart, "
        "and keeping r_hand relative to l_hand holds them 0.59 m apart",
    )
    assert find_never_kept(keeping(), apart) == ()


def test_a_shift_within_the_tolerances_is_no_reason():
    body = keeping(HANDS)
    assert find_never_kept(body, places(body, body.nominal, l_tool=[0.0, 0.004, 0.0], r_tool=[0.0] * 3)) == ()
    free = keeping(replace(HANDS, free_axis="y"))
    assert find_never_kept(free, places(free, free.nominal, l_tool=[0.0, 0.1, 0.0], r_tool=[0.0] * 3)) == ()


def test_a_link_kept_in_the_world_that_shall_arrive_elsewhere():
    body = keeping(KeepRequest("r_hand"))
    elsewhere = places(body, body.nominal, r_hand=[0.0, 0.0, 0.2])
    assert find_never_kept(body, elsewhere) == (
        "the goal of r_hand is 0.20 m from where keeping r_hand relative to the world holds it",
    )
    assert find_never_kept(body, places(body, body.nominal, l_hand=[0.0, 0.0, 0.2])) == ()


def test_joint_positions_that_let_go():
    body = keeping(HANDS)
    (line,) = find_never_kept(body, Goal.of(body, GoalRequest(posture="stand")).targets())
    assert line.startswith("the goal does not keep r_hand relative to l_hand: it is ")
    assert find_never_kept(body, Goal.of(body, GoalRequest(posture="reach_ready")).targets()) == ()
    # an elbow alone leaves the other joints to make up for it
    assert find_never_kept(body, Goal.of(body, GoalRequest(joints={"l_arm_elx": 1.0})).targets()) == ()


@pytest.mark.parametrize("free_axis", ["none", "y"])
@pytest.mark.parametrize("seed", range(10))
def test_where_a_configuration_keeps_the_pose_no_reason_is_given(seed, free_axis):
    rng = np.random.default_rng(seed)
    body = keeping(replace(HANDS, free_axis=free_axis))
    q = project_onto_holds(body.engine, (body.nominal + 0.3 * rng.normal(size=body.robot.n))[None], body.holds())[0]
    assert find_never_kept(body, places(body, q, l_tool=[0.0] * 3, r_hook=[0.0] * 3, l_hand=[0.0] * 3)) == ()
    joints = dict(zip(body.robot.joint_names[6:], q[6:].tolist(), strict=True))
    assert find_never_kept(body, Goal.of(body, GoalRequest(joints=joints)).targets()) == ()
