"""Robots as they are drawn: shapes and frames are where the model has them, from the numbers of a pose alone."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_files import LIMIT, joint, link, write_urdf
from robot_files import robot as file_of
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES, RobotModel, load_robot
from service.posing.drawing import RobotDrawing, draw_robot
from service.posing.numbers import PoseNumbers
from service.posing.reading import write_pose


def place_joints(drawing: RobotDrawing, numbers: PoseNumbers) -> list[pin.SE3]:
    """Pose of every joint in the world, from 1; 0 is the world."""
    placed = [pin.SE3.Identity()]
    for drawn in drawing.joints:
        rest = _read(drawn.rest or numbers.base)
        motion = np.array(drawn.motion or np.zeros(6)) * (numbers.positions[drawn.position] if drawn.motion else 0.0)
        placed.append(placed[drawn.parent] * rest * pin.exp6(motion))
    return placed


def _read(pose: tuple[float, ...]) -> pin.SE3:
    return pin.SE3(Rotation.from_quat(pose[3:], scalar_first=True).as_matrix(), np.array(pose[:3]))


FOLLOWING = [
    link("base"), link("a"), link("b"), link("c"), joint("ja", "base", "a"),
    joint("jb", "a", "b", inside=LIMIT + '<mimic joint="ja" multiplier="-2" offset="0.1"/>'),
    joint("jc", "b", "c", "prismatic"),
]  # fmt: skip


@pytest.fixture(scope="module", params=["floating", "fixed", "follower", "planar"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    if request.param in ("floating", "fixed"):
        return load_robot("atlas", root=request.param)
    urdf = write_urdf(tmp_path_factory.mktemp("robot"), file_of(*FOLLOWING))
    return load_robot(urdf=urdf, root="planar" if request.param == "planar" else "fixed")


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_shapes_and_frames_are_drawn_where_the_model_has_them(robot: RobotModel, seed: int) -> None:
    random = np.random.default_rng(seed)
    lower, upper = np.maximum(robot.lower, -1.2), np.minimum(robot.upper, 1.2)
    q = random.uniform(lower, upper)
    handles = ("pelvis", "l_foot") if robot.name == "atlas" else ("a", "c")
    drawing = draw_robot(robot, handles)
    placed = place_joints(drawing, write_pose(robot, q))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    for number in range(1, robot.model.njoints):
        np.testing.assert_allclose(placed[number].homogeneous, data.oMi[number].homogeneous, atol=1e-8)
    for frame in drawing.frames:
        expected = data.oMf[robot.model.getFrameId(frame.name)].homogeneous
        np.testing.assert_allclose((placed[frame.joint] * _read(frame.pose)).homogeneous, expected, atol=1e-8)
    assert {frame.name for frame in drawing.frames} >= {*handles, *drawing.tools.values()}
    assert len(drawing.bodies) == len(robot.bodies)
    assert robot.is_floating == (robot.joint_names[:6] == BASE_NAMES)
