"""Properties of the two-handed benchmark's problems: each has a known solution."""

import numpy as np
import pytest

from benchmarks.planning.crowded_scenes import LEAST_TRAVEL, POSITION_TOLERANCE
from benchmarks.planning.two_handed_scenes import PALMS, two_handed_scenes
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import load_robot
from service.body.holds import relative_pose
from service.setup.prepare import prepare
from service.start.overlaps import describe_collisions

N_BOXES = 8
FEET = ("l_foot", "r_foot")


@pytest.fixture(scope="module", name="robot")
def _robot():
    return load_robot("atlas")


@pytest.fixture(scope="module", name="scenes")
def _scenes(robot):
    """One problem of each task."""
    return {task: next(two_handed_scenes(robot, N_BOXES, task, seed)) for task, seed in (("poses", 0), ("beam", 2))}


def samples(scene, n=20):
    knots = scene.witness.curve.knots
    return scene.witness.curve(np.linspace(knots[0], knots[-1], n))


def test_the_known_motion_is_clear_of_boxes_floor_and_self(robot, scenes):
    for scene in scenes.values():
        pieces = prepare(scene.request, robot=robot).scene
        assert sum(piece.kind != "floor" for piece in pieces.pieces) == N_BOXES
        for q in samples(scene):
            assert describe_collisions(scene.witness.robot, q, pieces, FEET) == []


def test_the_planner_is_told_where_the_palms_go_and_nothing_of_the_motion(robot, scenes):
    engine = KinematicsEngine(robot)
    for task, scene in scenes.items():
        q = samples(scene)
        np.testing.assert_allclose(q[0], prepare(scene.request, robot=robot).start, atol=1e-9)
        poses = scene.request.goal.poses
        assert len(poses) == (1 if task == "beam" else 2)
        for pose in poses:
            assert (pose.quaternion_wxyz is None) == (task == "beam")
            np.testing.assert_allclose(
                locate_links(engine, q[-1], PALMS)[pose.link][:3, 3], pose.position, atol=POSITION_TOLERANCE
            )
        for palm in PALMS:
            places = [locate_links(engine, row, PALMS)[palm][:3, 3] for row in (q[0], q[-1])]
            assert np.linalg.norm(places[1] - places[0]) >= LEAST_TRAVEL


def test_a_beam_is_kept_from_start_to_goal(robot, scenes):
    assert "beam" in {body.name for body in scenes["beam"].witness.robot.bodies}
    (keep,) = scenes["beam"].request.keep
    assert {keep.link, keep.relative_to} == set(PALMS)
    first, *rest = (relative_pose(robot, q, keep.link, keep.relative_to) for q in samples(scenes["beam"]))
    for pose in rest:
        assert np.linalg.norm(pose[:3, 3] - first[:3, 3]) < keep.position_tolerance_m
        np.testing.assert_allclose(pose[:3, :3], first[:3, :3], atol=np.deg2rad(keep.rotation_tolerance_deg))


def test_the_straight_line_is_in_collision(scenes):
    assert not any(scene.is_straight_enough for scene in scenes.values())
