"""The checker reports every pair within margin and buffer: brute force over all pairs finds no other."""

from dataclasses import replace

import numpy as np
import pytest
from convex_distance import signed_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from swept_scenes import body_in_body, body_in_world, checker_of, keys, random_motion, random_scene, state_of
from tiny_robots import PLANAR, SPATIAL, atlas, chain

from costs.collision import ManyPosesChecker, PoseChecker, count_checked, make_search_checker
from costs.kinematics import KinematicsEngine
from costs.scene import ConvexPiece, Scene

ROBOTS = {
    "two joints": (lambda: chain(PLANAR), 0.3),
    "four joints": (lambda: chain(SPATIAL), 0.3),
    "floating chain": (lambda: chain(SPATIAL, "floating"), 0.3),
    "atlas": (atlas, 0.1),
}
BORDERLINE = 1e-6  # pairs this close to the query distance may be reported or not [m]


def intervals_of(n_waypoints):
    return [(0, 0)] if n_waypoints == 1 else [(t, t + 1) for t in range(n_waypoints - 1)]


def all_world_distances(robot, scene, kinematics):
    found = {}
    for first, second in intervals_of(kinematics.n_waypoints):
        for body in range(len(robot.bodies)):
            swept = np.concatenate([body_in_world(robot, kinematics, t, body) for t in (first, second)])
            for p, piece in enumerate(scene.pieces):
                found[first, body, p, False] = signed_distance(swept, piece.vertices)
    return found


def swept_pair_distance(robot, kinematics, first, second, moving, still):
    swept = np.concatenate([body_in_body(robot, kinematics, t, moving, still) for t in (first, second)])
    return signed_distance(swept, robot.bodies[still].outer)


def check_against(expected, contacts, query):
    reported = dict(zip(keys(contacts), contacts.distance.tolist(), strict=True))
    assert len(reported) == len(contacts), "a pair is reported twice"
    for key, distance in expected.items():
        if distance < query - BORDERLINE:
            assert key in reported, f"missed {key} at {distance:.4f} m"
    for key, distance in reported.items():
        assert distance < query
        assert distance == pytest.approx(expected[key], abs=1e-5)


@pytest.mark.parametrize("n_waypoints", [1, 5])
@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=4)
@given(seed=st.integers(0, 100_000))
def test_no_contact_with_the_world_is_missed(name, n_waypoints, seed):
    make, step = ROBOTS[name]
    robot, rng = make(), np.random.default_rng(seed)
    scene = random_scene(rng, 5, 0.8)
    state = state_of(robot, checker_of(robot, scene, 0.02, buffer=0.05))(random_motion(robot, rng, n_waypoints, step))
    contacts = state.contacts.where(~state.contacts.is_self)
    check_against(all_world_distances(robot, scene, state.kinematics), contacts, 0.07)


@pytest.mark.parametrize("n_waypoints", [1, 3])
@pytest.mark.parametrize("name", ["four joints", "atlas"])
@settings(max_examples=3)
@given(seed=st.integers(0, 100_000))
def test_no_contact_of_the_robot_with_itself_is_missed(name, n_waypoints, seed):
    make, step = ROBOTS[name]
    robot, rng = make(), np.random.default_rng(seed)
    checker = checker_of(robot, Scene(), 0.02, buffer=0.05)
    # three times the random walk's start: folded far enough for links to meet
    state = state_of(robot, checker)(2.0 * random_motion(robot, rng, n_waypoints, step))
    count = [len(body.outer) for body in robot.bodies]
    expected = {}
    for a, b in checker.margins.self_pairs.tolist():
        still, moving = (a, b) if count[a] >= count[b] else (b, a)
        for first, second in intervals_of(n_waypoints):
            expected[first, a, b, True] = swept_pair_distance(robot, state.kinematics, first, second, moving, still)
    check_against(expected, state.contacts, 0.07)


def test_every_pair_of_links_that_may_meet_is_checked_once():
    robot = atlas()
    pairs = checker_of(robot, Scene(), 0.02).margins.self_pairs
    assert len({(a, b) for a, b in pairs.tolist()}) == len(pairs)
    checked = {tuple(sorted((robot.bodies[a].link, robot.bodies[b].link))) for a, b in pairs.tolist()}
    for a, first in enumerate(robot.bodies):
        for second in robot.bodies[a + 1 :]:
            names = tuple(sorted((first.link, second.link)))
            assert (names in checked) == (first.joint != second.joint and names not in robot.ignored_pairs)


def test_contacts_depend_on_the_query_alone():
    robot, rng = atlas(), np.random.default_rng(5)
    make_state = state_of(robot, checker_of(robot, random_scene(rng, 8, 0.7), 0.02))
    x, other = random_motion(robot, rng, 3, 0.1), random_motion(robot, rng, 3, 0.1)
    before = make_state(x).contacts
    make_state(other)
    after = make_state(x).contacts
    for name in before.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


def test_a_robot_without_bodies_has_no_contacts(tmp_path):
    from costs.robot import load_robot

    urdf = tmp_path / "bare.urdf"
    urdf.write_text(
        '<robot name="bare"><link name="base"/><link name="arm"/><joint name="turn" type="revolute">'
        '<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    robot = load_robot(urdf=urdf)
    scene = random_scene(np.random.default_rng(1), 3, 0.5)
    assert len(state_of(robot, checker_of(robot, scene, 0.02))(np.zeros((2, 1))).contacts) == 0


@pytest.mark.parametrize("name", ["four joints", "atlas"])
def test_poses_are_clear_exactly_where_no_pair_is_nearer_than_its_margin(name):
    robot = ROBOTS[name][0]()
    answers = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        centre = (0.7, 0.0, 0.0) if seed % 2 else (2.0, 0.0, 0.0)
        checker = checker_of(robot, random_scene(rng, 4, 0.6, centre), 0.02, buffer=0.0)
        engine = KinematicsEngine(robot)
        q = random_motion(robot, rng, 3, 0.1)
        state = state_of(robot, checker)
        clear = [len(state(row[None]).contacts) == 0 for row in q]
        for poses in (
            PoseChecker(engine, checker.scene, checker.margins),
            ManyPosesChecker(robot, checker.scene, checker.margins),
            make_search_checker(engine, checker.scene, checker.margins),
        ):
            assert [poses.are_clear(row[None]) for row in q] == clear
            assert poses.are_clear(q) == all(clear)
        answers += clear
    assert 5 < sum(answers) < len(answers) - 5


def test_pairs_that_may_touch_do_not_count_as_near():
    robot, rng = ROBOTS["four joints"][0](), np.random.default_rng(3)
    q = random_motion(robot, rng, 1, 0.1)
    engine = KinematicsEngine(robot)
    inside = ConvexPiece("box", body_in_world(robot, engine(q), 0, 2) + 0.01)
    checker = checker_of(robot, Scene((inside,)), 0.02, buffer=0.0)
    assert checker(engine(q)).distance.min() < 0.0
    margins = checker.margins
    touching = replace(margins, world=-np.ones_like(margins.world), own=-np.ones_like(margins.own))
    assert count_checked(margins) == margins.world.size + len(margins.own)
    assert count_checked(touching) == 0
    for poses in (
        PoseChecker(engine, checker.scene, touching),
        ManyPosesChecker(robot, checker.scene, touching),
        make_search_checker(engine, checker.scene, touching),
    ):
        assert poses.are_clear(q)
