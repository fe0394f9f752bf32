"""INFEASIBLE is said for reasons that no configuration gets around: each reason against many configurations."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planar_arm import write_planar_arm
from scipy.spatial.transform import Rotation
from small_robots import box
from tiny_robots import SPATIAL, Segment, Z, atlas, chain, random_configurations

from costs.collision.shapes import make_convex
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import load_robot
from costs.scene import Scene
from service.body.aims import Aims
from service.body.whole_body import WholeBody
from service.explain.distance import chain_length, find_out_of_reach
from service.explain.goal import GoalReasons, find_goal_reasons
from service.start.overlaps import find_overlaps, penetration_depth
from service.start.standing import FEET_GROUP
from service.verify import JointTarget, PoseTarget

ANY = np.full(3, np.inf)


def standing(robot, *pieces, q=None, feet=()):
    start = np.zeros(robot.n) if q is None else q
    return WholeBody.standing(robot, Scene(pieces), start, feet, Aims())


def at(frame, position, rotation=None, tolerance=1e-3, turn=0.01):
    turns = np.full(3, turn) if rotation is not None else ANY
    return PoseTarget(frame, np.array(position, float), rotation, np.full(3, tolerance), turns, 0.0)


def joints(**values):
    return [JointTarget(name, value, 1e-3, 0.0) for name, value in values.items()]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Three links of 0.2 m in a plane, 40 mm thick."""
    return load_robot(urdf=write_planar_arm(tmp_path_factory.mktemp("arm"), 3, 0.2, 0.04, limit=3.0))


@given(seed=st.integers(0, 10_000))
def test_no_configuration_is_farther_than_the_chain_is_long(seed):
    rng = np.random.default_rng(seed)
    for robot, start, frame in (
        (chain(SPATIAL), None, "tip"),  # one of its joints slides
        (chain(SPATIAL), "link1", "tip"),
        (atlas(), "r_foot", "l_tool"),
    ):
        q = random_configurations(robot, rng, 1)[0]
        poses = locate_links(KinematicsEngine(robot), q, [frame] if start is None else [frame, start])
        origin = np.zeros(3) if start is None else poses[start][:3, 3]
        assert np.linalg.norm(poses[frame][:3, 3] - origin) <= chain_length(robot, start, frame) + 1e-9


def test_a_stretched_arm_is_as_long_as_its_chain():
    robot = chain((Segment(Z), Segment(Z, origin=(1.0, 0.0, 0.0))))
    assert chain_length(robot, None, "tip") == pytest.approx(2.0)
    assert chain_length(robot, "link1", "tip") == pytest.approx(2.0)
    assert find_out_of_reach(standing(robot), "tip", np.array([2.01, 0.0, 0.0])) == (
        "tip cannot reach [2.01, 0.0, 0.0]: it is 2.01 m from the base, "
        "and the chain between them is at most 2.00 m long"
    )
    assert find_out_of_reach(standing(robot), "tip", np.array([1.99, 0.0, 0.0])) is None


def test_a_free_base_has_no_reach():
    assert chain_length(atlas(), None, "l_tool") == np.inf


def test_a_target_within_its_tolerance_of_the_reach_may_be_reached():
    # a tolerance is a distance: the corner of its cube is farther away than it
    robot = chain((Segment(Z), Segment(Z, origin=(1.0, 0.0, 0.0))))
    beyond = np.array([2.0999, 0.0, 0.0])
    assert find_goal_reasons(standing(robot), [at("tip", beyond, tolerance=0.1)]).impossible == ()
    for place, tolerance in ((beyond, 0.05), (np.array([2.0, 0.0, 0.0]) + 0.0999, 0.1)):
        (reason,) = find_goal_reasons(standing(robot), [at("tip", place, tolerance=tolerance)]).impossible
        assert reason.startswith("tip cannot reach")


def test_two_links_cannot_be_farther_apart_than_what_is_between_them():
    q = atlas().postures["stand"]
    body = standing(atlas(), q=q, feet=atlas().link_groups[FEET_GROUP])
    hands = [at("l_hand", [0.0, 1.5, 1.3]), at("r_hand", [0.0, -1.5, 1.3])]
    (line,) = find_goal_reasons(body, hands).impossible
    assert line.startswith("l_hand and r_hand cannot be at their targets at once: these are 3.00 m apart, ")
    assert find_goal_reasons(body, hands[:1]).impossible == ()


def test_what_the_given_joints_alone_bring_into_an_obstacle_stays_in_it_wherever_the_others_are(arm):
    block = box("block", (0.3, 0.03, 0.0), (0.03, 0.03, 0.1))
    body = standing(arm, block)
    (line,) = find_goal_reasons(body, joints(j0=0.0, j1=0.0)).impossible
    assert line == "the goal is in collision: l1 is 20 mm inside block (obstacle), wherever the other joints are"
    for last in np.linspace(-3.0, 3.0, 50):
        inside = find_overlaps(arm, np.array([0.0, 0.0, last]), body.scene, ())
        assert "l1" in {overlap.link for overlap in inside}
    # j1 alone does not say where l1 is, and a link beyond the given joints may turn away
    assert find_goal_reasons(body, joints(j1=0.0)).impossible == ()
    beyond = standing(arm, box("block", (0.5, 0.0, 0.0), (0.03, 0.03, 0.1)))
    assert find_goal_reasons(beyond, joints(j0=0.0, j1=0.0)).impossible == ()


@pytest.mark.parametrize("depth_mm", [0.1, 0.2, 0.5, 2.0, 7.6])
def test_given_joints_in_collision_are_told_with_the_depth_however_small_it_is(arm, depth_mm):
    touching = box("block", (0.5, 0.05 - 1e-3 * depth_mm, 0.0), (0.03, 0.03, 0.1))
    (line,) = find_goal_reasons(standing(arm, touching), joints(j0=0.0, j1=0.0, j2=0.0)).impossible
    assert line == f"the goal is in collision: l2 is {depth_mm} mm inside block (obstacle)"


def test_a_goal_that_touches_or_is_clear_by_little_is_not_called_impossible(arm):
    for gap in (0.0, 1e-4, 5e-3):
        beside = box("block", (0.5, 0.05 + gap, 0.0), (0.03, 0.03, 0.1))
        reasons = find_goal_reasons(standing(arm, beside), joints(j0=0.0, j1=0.0, j2=0.0))
        assert reasons == GoalReasons((), ())


def test_legs_that_are_given_place_the_body_on_planted_feet():
    robot = atlas()
    q = robot.postures["stand"]
    crate = box("crate", (0.3, 0.0, 1.4), (0.2, 0.2, 0.1))
    body = standing(robot, crate, q=q, feet=robot.link_groups[FEET_GROUP])
    first = robot.n - len(robot.joint_names[6:])
    posture = joints(**{name: float(q[first + k]) for k, name in enumerate(robot.joint_names[first:])})
    lines = find_goal_reasons(body, posture).impossible
    assert any(re.fullmatch(r"the goal is in collision: utorso is \d+ mm inside crate .*", line) for line in lines)
    # with a leg's joint left out the body may be anywhere
    free = [target for target in posture if not target.joint.endswith("leg_kny")]
    assert find_goal_reasons(body, free).impossible == ()


def test_links_that_the_given_joints_cross_are_named_on_a_free_base():
    robot = atlas()
    legs = [name for name in robot.joint_names if "_leg_" in name]
    q = robot.postures["stand"].copy()
    crossed = {name: float(q[robot.joint_names.index(name)]) for name in legs} | {"l_leg_hpx": -0.5}
    body = standing(robot, q=q, feet=robot.link_groups[FEET_GROUP])
    lines = find_goal_reasons(body, joints(**crossed)).impossible
    assert any("l_lleg is 1" in line and "inside r_uleg, wherever the other joints are" in line for line in lines)
    assert find_goal_reasons(body, joints(l_leg_hpx=-0.5)).impossible == ()


@given(seed=st.integers(0, 10_000))
def test_a_link_said_to_be_inside_at_its_pose_is_inside_at_every_pose_within_tolerance(seed):
    rng = np.random.default_rng(seed)
    robot, piece = atlas(), box("crate", (0.6, 0.2, 1.0), tuple(rng.uniform(0.02, 0.2, 3)))
    wanted = Rotation.random(random_state=seed).as_matrix()
    tolerance, turn = rng.uniform(1e-3, 0.03), rng.uniform(1e-3, 0.2)
    target = at("l_tool", piece.vertices.mean(axis=0) + rng.normal(scale=0.1, size=3), wanted, tolerance, turn)
    body = standing(robot, piece, q=robot.postures["stand"], feet=robot.link_groups[FEET_GROUP])
    for line in find_goal_reasons(body, [target]).impossible:
        _stays_inside(robot, piece, target, line, rng, turn)


@given(seed=st.integers(0, 10_000))
def test_a_link_said_to_be_inside_however_turned_is_inside_for_every_rotation(seed):
    rng = np.random.default_rng(seed)
    robot, piece = atlas(), box("crate", (0.6, 0.2, 1.0), tuple(rng.uniform(0.02, 0.2, 3)))
    target = at(
        "l_hand", piece.vertices.mean(axis=0) + rng.normal(scale=0.1, size=3), tolerance=rng.uniform(1e-3, 0.03)
    )
    body = standing(robot, piece, q=robot.postures["stand"], feet=robot.link_groups[FEET_GROUP])
    for line in find_goal_reasons(body, [target]).impossible:
        _stays_inside(robot, piece, target, line, rng, None)


def _stays_inside(robot, piece, target, line, rng, turn):
    link = line.rsplit(" is ", 1)[0].split()[-1]
    frame = robot.model.frames[robot.model.getFrameId(target.frame)]
    shape = make_convex(piece.vertices)
    for _ in range(20):
        rotation = Rotation.random(random_state=rng.integers(1 << 31)).as_matrix()
        if turn is not None:
            axis = rng.uniform(-turn, turn, 3) / np.sqrt(3.0)
            rotation = target.rotation @ Rotation.from_rotvec(axis).as_matrix()
        position = target.position + rng.uniform(-1.0, 1.0, 3) * target.position_tolerance_m
        depths = []
        for one in (one for one in robot.bodies if one.link == link):
            in_frame = (one.vertices - frame.placement.translation) @ frame.placement.rotation
            depths.append(penetration_depth(make_convex(in_frame @ rotation.T + position), shape))
        assert max(depths) > 0.0, line


def test_a_target_deep_in_an_obstacle_is_said_to_be_so_and_one_beside_it_is_not():
    robot = atlas()
    table = box("table", (0.75, 0.0, 0.9), (0.25, 0.6, 0.025))
    body = standing(robot, table, q=robot.postures["stand"], feet=robot.link_groups[FEET_GROUP])
    (line,) = find_goal_reasons(body, [at("l_tool", [0.75, 0.0, 0.9])]).impossible
    how = "with l_tool at [0.75, 0.0, 0.9], however it is turned,"
    assert line == f"the goal is in collision: {how} l_hook is inside table (obstacle)"
    assert find_goal_reasons(body, [at("l_tool", [0.75, 0.0, 0.93])]).impossible == ()
    # turned down, the hand above the tool is clear of the table; turned up it is below, in it
    down, up = (Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix() for angle in (np.pi, 0.0))
    assert find_goal_reasons(body, [at("l_tool", [0.75, 0.0, 0.93], down)]).impossible == ()
    (line,) = find_goal_reasons(body, [at("l_tool", [0.75, 0.0, 0.93], up)]).impossible
    assert line.startswith("the goal is in collision: with l_tool at [0.75, 0.0, 0.93], turned as requested, l_h")
    assert line.endswith(" mm inside table (obstacle)")


def test_two_poses_that_put_links_into_each_other_are_told_with_both(arm):
    poses = [at("l0", [0.0, 0.0, 0.0], np.eye(3), turn=1e-3), at("l2", [0.05, 0.03, 0.0], np.eye(3), turn=1e-3)]
    lines = find_goal_reasons(standing(arm), poses).impossible
    told = "the goal is in collision: with l0 at [0.0, 0.0, 0.0] and l2 at [0.05, 0.03, 0.0], turned as requested,"
    assert f"{told} l0 is 10 mm inside l2" in lines
    apart = [poses[0], at("l2", [0.05, 0.05, 0.0], np.eye(3), turn=1e-3)]
    assert not any("turned as requested" in line for line in find_goal_reasons(standing(arm), apart).impossible)


def test_a_pose_that_only_its_tolerance_may_free_is_noted_and_not_called_impossible(arm):
    beside = box("block", (0.5, 0.05 - 3e-3, 0.0), (0.03, 0.03, 0.1))
    reasons = find_goal_reasons(standing(arm, beside), [at("l2", [0.4, 0.0, 0.0], np.eye(3), tolerance=2e-3)])
    assert reasons.impossible == reasons.unresolved == ()
    told = "with l2 at [0.4, 0.0, 0.0], turned as requested, l2 is 3.0 mm inside block (obstacle)"
    assert reasons.notes == (f"{told}; only its tolerance can free it",)
    exact = find_goal_reasons(standing(arm, beside), [at("l2", [0.4, 0.0, 0.0], np.eye(3), tolerance=1e-4, turn=1e-3)])
    assert exact == GoalReasons((f"the goal is in collision: {told}",), ())
