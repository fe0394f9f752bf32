"""Inverse kinematics and clearances of one robot, and starts and goals that nearly touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from other_planners import GOAL, JOINTS, POST, START, make_request, write_arm

from costs.robot import RobotModel, load_robot
from costs.scene import ConvexPiece, Scene
from service import (
    PoseGoalRequest,
    RequestError,
    clearance,
    parse_request,
    plan,
    solve_ik,
    sweep_clearance,
    write_result,
)
from service.replay.replay import verify_result

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return load_robot(urdf=write_arm(tmp_path_factory.mktemp("arm")))


def _box(name: str, centre: np.ndarray, size: np.ndarray) -> ConvexPiece:
    return ConvexPiece(name, np.asarray(centre) + 0.5 * CORNERS * np.asarray(size))


def _place(robot: RobotModel, q: np.ndarray, link: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(link)].copy()


def _box_at(robot: RobotModel, q: np.ndarray, gap: float, side: float = 1.0) -> tuple[np.ndarray, list[float]]:
    """Centre and size of a box beside the last link at ``q``, this far off it [m]."""
    pose, size = _place(robot, q, "part3"), [0.05, 0.05, 0.05]
    along = side * pose.rotation[:, 1]
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        near = clearance(robot, q, (_box("near", pose.act(np.array([0.08, 0.0, 0.0])) + middle * along, size),))
        low, high = (middle, high) if near.distance_m < gap else (low, middle)
    return pose.act(np.array([0.08, 0.0, 0.0])) + high * along, size


def test_the_distance_of_a_box_is_that_of_its_face(arm: RobotModel) -> None:
    ahead = np.zeros(4)  # straight along x at z 0.25: the arm ends at x 0.4 + 0.35 + 0.14
    near = clearance(arm, ahead, (_box("wall", np.array([1.0, 0.0, 0.25]), np.array([0.1, 1.0, 1.0])),))
    tip = max(
        float((arm.model.createData() and _place(arm, ahead, "part3").act(v))[0]) for v in arm.bodies[-1].vertices
    )
    assert near.pair == ("part3", "wall")
    assert near.distance_m == pytest.approx(0.95 - tip, abs=1e-6)
    assert clearance(arm, ahead).distance_m == pytest.approx(0.1)


@given(seed=st.integers(0, 1000))
@settings(max_examples=10)
def test_the_bound_of_a_sweep_holds_at_every_pose(arm: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, last = rng.uniform(-1.5, 1.5, (2, 4))
    scene = Scene((_box("box", np.array([0.3, 0.0, 0.3]) + rng.uniform(-0.6, 0.6, 3), rng.uniform(0.05, 0.3, 3)),))
    swept = sweep_clearance(arm, first, last, scene)
    poses = [clearance(arm, first + share * (last - first), scene).distance_m for share in np.linspace(0.0, 1.0, 41)]
    if swept.is_clear:
        assert min(poses) >= swept.lower_m - 1e-9
        assert swept.lower_m >= 0.0
    else:
        assert swept.at is not None
        assert clearance(arm, first + swept.at * (last - first), scene).distance_m < 0.0


@given(seed=st.integers(0, 1000))
@settings(max_examples=10)
def test_inverse_kinematics_finds_a_pose_that_is_there_by_construction(arm: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.8, 1.8, 4)
    if clearance(arm, q).distance_m < 0.02:
        return
    pose = _place(arm, q, "part3")
    goal = PoseGoalRequest("part3", tuple(pose.translation), tuple(np.roll(pin.Quaternion(pose.rotation).coeffs(), 1)))
    solutions = solve_ik(arm, [goal], nominal=START, count=1)
    assert len(solutions) == 1
    reached = _place(arm, solutions[0].q, "part3")
    assert np.linalg.norm(reached.translation - pose.translation) < 1.1e-3
    assert solutions[0].clearance.distance_m > 0.0


def test_several_solutions_are_different_and_the_nearest_comes_first(arm: RobotModel) -> None:
    pose = _place(arm, START, "part3")
    goal = PoseGoalRequest("part3", tuple(pose.translation))
    solutions = solve_ik(arm, [goal], nominal=START, count=3)
    far = [np.abs(solution.q - START).max() for solution in solutions]
    assert len(solutions) >= 2
    assert far == sorted(far)
    assert np.abs(solutions[0].q - solutions[1].q).max() > 0.05


def test_what_cannot_be_asked_is_refused(arm: RobotModel) -> None:
    with pytest.raises(RequestError, match=r"q must be 4 finite numbers \(arm\)"):
        clearance(arm, [0.0, np.nan, 0.0, 0.0])
    with pytest.raises(RequestError, match="unknown link 'hand'; arm has"):
        solve_ik(arm, [PoseGoalRequest("hand", (0.3, 0.0, 0.3))])


@pytest.mark.parametrize("gap", [2e-4, 2e-3])
@pytest.mark.parametrize("where", ["start", "goal"])
def test_ends_that_nearly_touch_are_left_straight_and_certified(
    arm: RobotModel, tmp_path: Path, gap: float, where: str
) -> None:
    end = START if where == "start" else GOAL
    centre, size = _box_at(arm, end, gap, -1.0 if where == "start" else 1.0)
    near = {"name": "near", "type": "box", "size": size, "position": centre.tolist()}
    request = parse_request(make_request(tmp_path, scene={"obstacles": [POST, near]}))
    result = plan(request)
    assert result.verdict.value == "CERTIFIED", result.explanation
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"
    assert result.joint_names == JOINTS
