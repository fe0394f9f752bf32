"""A box cast against a box: free at every waypoint, in collision between them; the optimiser must go around.

A checker of poses would call the straight line solved.  Whether it is free is judged here densely, by distances of
another kind than those of the optimiser.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from convex_distance import box, signed_distance
from planar_arm import write_planar_arm
from swept_scenes import body_in_world, checker_of, state_of
from tiny_robots import Segment, chain_urdf

from costs.kinematics import KinematicsEngine
from costs.robot import load_robot
from costs.scene import ConvexPiece, Scene
from costs.terms import JointDifference, SweptClearance
from scopt import Constraint, Cost, Problem, TrustRegionSQP
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict

MARGIN = 0.02
# A cube of 20 cm that slides along x and y; what carries it along x runs a metre below.
SLIDER = (
    Segment((1.0, 0.0, 0.0), origin=(0.0, 0.0, -1.0), size=(0.02, 0.02, 0.02), kind="prismatic"),
    Segment((0.0, 1.0, 0.0), origin=(0.0, 0.0, 1.0), size=(0.2, 0.2, 0.2), kind="prismatic"),
)
WALL = {"size": [0.1, 0.8, 0.4], "position": [0.1, -0.25, 0.0]}
WALL_START = np.linspace([-1.0, 0.0], [1.0, 0.0], 6)
# An arm of two links of 30 cm, and a post near the circle of its tip.
POST = {"size": [0.03, 0.03, 0.2], "position": [0.58, 0.0, 0.0]}
POST_START = np.linspace([-1.0, 0.0], [1.0, 0.0], 12)


def scene_of(obstacle):
    return Scene((ConvexPiece("obstacle", box(obstacle["position"], obstacle["size"])),))


@pytest.fixture
def slider_urdf(tmp_path):
    urdf = tmp_path / "slider.urdf"
    urdf.write_text(chain_urdf(SLIDER))
    return urdf


@pytest.fixture
def arm_urdf(tmp_path):
    return write_planar_arm(tmp_path, 2, 0.3, 0.04, 3.0)


def least_distance(robot, scene, q):
    """Of any body from any piece at single configurations [m]."""
    kinematics = KinematicsEngine(robot)(q)
    return min(
        signed_distance(body_in_world(robot, kinematics, row, body), piece.vertices)
        for row in range(len(q))
        for body in range(len(robot.bodies))
        for piece in scene.pieces
    )


def densely(x, count=60):
    """Configurations on the straight lines between waypoints."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    return np.concatenate([first + s * (last - first) for first, last in itertools.pairwise(x)])


def assert_only_the_waypoints_are_free(robot, scene, start):
    assert least_distance(robot, scene, start) > 0.01
    assert least_distance(robot, scene, densely(start)) < -0.01
    engine, checker = KinematicsEngine(robot), checker_of(robot, scene, 0.0, buffer=0.0)
    assert all(len(checker(engine(q[None]))) == 0 for q in start)
    assert checker(engine(start)).distance.min() < -0.01


def test_the_optimiser_goes_around_what_lies_between_the_waypoints(slider_urdf):
    robot, scene = load_robot(urdf=slider_urdf), scene_of(WALL)
    assert_only_the_waypoints_are_free(robot, scene, WALL_START)
    checker = checker_of(robot, scene, MARGIN)
    lower, upper = np.tile(robot.lower, (6, 1)), np.tile(robot.upper, (6, 1))
    lower[[0, -1]] = upper[[0, -1]] = WALL_START[[0, -1]]
    problem = Problem(
        lower,
        upper,
        (Cost("displacement", JointDifference(6, np.ones(robot.n))),),
        (Constraint("clear", SweptClearance(robot, is_self=False), tolerance=1e-3),),
        state_of(robot, checker),
    )
    result = TrustRegionSQP().solve(problem, WALL_START)
    assert result.is_feasible, result.message
    assert checker(KinematicsEngine(robot)(result.x)).distance.min(initial=np.inf) >= MARGIN - 1e-3
    assert least_distance(robot, scene, densely(result.x)) >= MARGIN - 1e-3
    np.testing.assert_array_equal(result.x[[0, -1]], WALL_START[[0, -1]])


@pytest.mark.parametrize(
    ("robot", "joints", "obstacle", "start"),
    [
        ("slider_urdf", ("joint1", "joint2"), WALL, WALL_START),
        ("arm_urdf", ("j0", "j1"), POST, POST_START),
    ],
    ids=["sliding cube", "turning arm"],
)
def test_a_plan_around_what_lies_between_its_waypoints_is_certified(robot, joints, obstacle, start, request):
    urdf = request.getfixturevalue(robot)
    assert_only_the_waypoints_are_free(load_robot(urdf=urdf), scene_of(obstacle), start)
    result = plan(
        parse_request(
            {
                "robot": {"urdf": str(urdf)},
                "scene": {"obstacles": [{"name": "obstacle", "type": "box", **obstacle}], "floor": False},
                "start": {"joints": dict(zip(joints, start[0].tolist(), strict=True))},
                "goal": {"joints": dict(zip(joints, start[-1].tolist(), strict=True))},
                "options": {"waypoints": len(start), "margin_m": MARGIN},
            }
        )
    )
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    curve = result.motion.curve
    executed = curve(np.linspace(0.0, curve.knots[-1], 400))
    np.testing.assert_allclose(executed[[0, -1]], start[[0, -1]], atol=1e-6)
    assert least_distance(result.robot, scene_of(obstacle), executed) >= result.certificate.min_clearance_m - 1e-6 > 0.0
