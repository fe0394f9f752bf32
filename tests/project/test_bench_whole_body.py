"""Properties of the whole-body benchmark's problems: each has a known solution."""

import numpy as np
import pytest

from benchmarks.planning.crowded_scenes import (
    BALANCE_MARGIN,
    IN_THE_WAY,
    LEAST_TRAVEL,
    POSITION_TOLERANCE,
    crowded_scenes,
)
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import load_robot
from costs.support import SupportPolygon
from service.setup.prepare import prepare
from service.start.overlaps import describe_collisions

N_BOXES = 8
FEET = ("l_foot", "r_foot")


@pytest.fixture(scope="module")
def robot():
    return load_robot("atlas")


@pytest.fixture(scope="module")
def scenes(robot):
    """One problem per kind of goal."""
    return [next(crowded_scenes(robot, N_BOXES, is_pose=is_pose, seed=10)) for is_pose in (False, True)]


def samples(scene, n=20):
    knots = scene.witness.curve.knots
    return scene.witness.curve(np.linspace(knots[0], knots[-1], n))


def test_the_known_motion_is_clear_of_boxes_floor_and_self(robot, scenes):
    for scene in scenes:
        pieces = prepare(scene.request, robot=robot).scene
        assert sum(piece.kind != "floor" for piece in pieces.pieces) == N_BOXES
        for q in samples(scene):
            assert describe_collisions(robot, q, pieces, FEET) == []


def test_the_known_motion_stands_balanced_on_feet_that_stay_where_they_are(robot, scenes):
    engine = KinematicsEngine(robot)
    for scene in scenes:
        setup = prepare(scene.request, robot=robot)
        q = samples(scene)
        polygon = SupportPolygon.of_soles(list(setup.soles.values()))
        assert polygon.margin(engine(q).com[:, :2]).min() >= BALANCE_MARGIN
        at_first = locate_links(engine, setup.start, FEET)
        for row in q:
            for foot, pose in locate_links(engine, row, FEET).items():
                np.testing.assert_allclose(pose, at_first[foot], atol=1e-3)


def test_the_planner_is_told_where_the_palm_goes_and_nothing_of_the_motion(robot, scenes):
    engine = KinematicsEngine(robot)
    for scene, is_pose in zip(scenes, (False, True), strict=True):
        setup, q = prepare(scene.request, robot=robot), samples(scene)
        np.testing.assert_allclose(q[0], setup.start, atol=1e-12)
        goal = scene.request.goal
        assert not goal.joints
        assert goal.posture is None
        (pose,) = goal.poses
        assert (pose.quaternion_wxyz is not None) == is_pose
        places = [locate_links(engine, row, [pose.link])[pose.link][:3, 3] for row in (q[0], q[-1])]
        np.testing.assert_allclose(places[1], pose.position, atol=POSITION_TOLERANCE)
        assert np.linalg.norm(places[1] - places[0]) >= LEAST_TRAVEL


def test_boxes_are_in_the_way_of_the_straight_line(robot, scenes):
    for scene in scenes:
        pieces = prepare(scene.request, robot=robot).scene
        q = samples(scene)
        straight = q[0] + (q[-1] - q[0]) * np.linspace(0.0, 1.0, 41)[:, None]
        lines = [line for row in straight for line in describe_collisions(robot, row, pieces, FEET)]
        hits = {word for line in lines for word in line.split() if word.startswith("box")}
        assert len(hits) >= IN_THE_WAY - 1  # boxes are drawn against swept hulls, which are slightly larger
        assert not scene.is_straight_enough


def test_the_same_seed_draws_the_same_problems(robot, scenes):
    again = next(crowded_scenes(robot, N_BOXES, is_pose=False, seed=10))
    assert again.request == scenes[0].request
