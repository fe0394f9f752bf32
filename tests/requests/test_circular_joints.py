"""Joints without limits are circles, rounding at a limit is no error, and followers are read when they follow."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.robot import RobotModel, list_circular, load_robot, turn_near
from service.errors import RequestError
from service.planner import plan
from service.replay.exchange.certify import certify
from service.replay.exchange.joint_trajectory import JointTrajectory
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.output import write_result
from service.result.result import Verdict
from service.setup.prepare import PlanSetup, prepare
from service.verify import Status

INERTIA = '<mass value="0.5"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'


def link(name: str, origin: str, size: str) -> str:
    shape = f'<origin xyz="{origin}"/><geometry><box size="{size}"/></geometry>'
    return f'<link name="{name}"><inertial>{INERTIA}</inertial><collision>{shape}</collision></link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


AT_TIP = '<origin xyz="0.4 0 0"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="2" effort="50"/>'
URDF = "".join(
    (
        '<robot name="turner"><link name="base"/>',
        link("arm", "0.2 0 0", "0.3 0.05 0.05"),
        link("finger", "0 0 0.1", "0.02 0.02 0.1"),
        link("thumb", "0 0 -0.1", "0.02 0.02 0.1"),
        joint("pan", "continuous", "base", "arm", '<axis xyz="0 0 1"/><limit velocity="2" effort="50"/>'),
        joint("grip", "revolute", "arm", "finger", AT_TIP),
        joint("follower", "revolute", "arm", "thumb", f'{AT_TIP}<mimic joint="grip" multiplier="-1" offset="0.1"/>'),
        "</robot>",
    )
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("turner")
    (path / "turner.urdf").write_text(URDF)
    return path


@pytest.fixture(scope="module")
def robot(folder: Path) -> RobotModel:
    return load_robot(urdf=folder / "turner.urdf")


def read(folder: Path, start: dict[str, float], goal: dict[str, float]) -> Any:
    data = {"robot": {"urdf": "turner.urdf"}, "start": {"joints": start}, "scene": {"floor": False}}
    return parse_request({**data, "goal": {"joints": goal}}, folder)


def prepare_with(folder: Path, start: dict[str, float], goal: dict[str, float]) -> PlanSetup:
    return prepare(read(folder, start, goal))


@given(angle=st.floats(-1e3, 1e3), near=st.floats(-1e3, 1e3))
def test_a_turned_angle_is_the_same_place_within_half_a_turn(robot: RobotModel, angle: float, near: float) -> None:
    (turned, limited) = turn_near(robot, np.array([angle, 0.3]), np.array([near, 9.0]))
    assert abs(turned - near) <= math.pi + 1e-9
    assert math.cos(turned - angle) == pytest.approx(1.0, abs=1e-9)
    assert limited == 0.3


def test_only_turning_joints_without_limits_are_circles(robot: RobotModel) -> None:
    assert [robot.joint_names[k] for k in list_circular(robot)] == ["pan"]


@pytest.mark.parametrize(
    ("start", "goal", "moved"), [(3.0, -3.0, 2 * math.pi - 6.0), (8 * math.pi, 0.3, 0.3), (100.53, 0.3, None)]
)
def test_a_joint_without_limits_takes_the_short_way(
    folder: Path, tmp_path: Path, start: float, goal: float, moved: float | None
) -> None:
    result = plan(read(folder, {"pan": start}, {"pan": goal, "grip": 0.2}))
    assert result.verdict is Verdict.CERTIFIED
    assert result.motion is not None
    pan = result.motion.curve.positions[:, 0]
    expected = abs(math.remainder(goal - start, 2 * math.pi)) if moved is None else moved
    assert pan[0] == pytest.approx(start)  # the encoder's turn stays
    assert np.ptp(pan) == pytest.approx(expected, abs=2e-3)
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"


def test_a_goal_elsewhere_on_the_circle_is_missed(folder: Path) -> None:
    path = JointTrajectory(("pan", "grip"), [0.0, 2.0], [[0.0, 0.0], [0.5, 0.2]])
    there, opposite = ({"pan": 0.5 + turn * math.pi} for turn in (2, 1))
    assert certify(path, read(folder, {"pan": 0.0}, there), "spline").certificate.status is Status.CERTIFIED
    assert certify(path, read(folder, {"pan": 0.0}, opposite), "spline").certificate.status is Status.VIOLATED


def test_a_trajectory_in_another_turn_of_the_encoder_is_read_from_the_start(folder: Path) -> None:
    offset = 6 * math.pi
    path = JointTrajectory(("pan", "grip"), [0.0, 2.0], [[offset + 0.1, 0.0], [offset + 0.5, 0.2]])
    certified = certify(path, read(folder, {"pan": 0.1}, {"pan": 0.5}), "spline")
    assert certified.certificate.status is Status.CERTIFIED


def test_many_turns_are_named_with_the_place(folder: Path) -> None:
    notes = prepare_with(folder, {"pan": 100.53}, {"pan": 180.0}).notes
    assert any(note.startswith("start.joints.pan: 100.53 rad are 16 turns, which do not count") for note in notes)
    assert any("goal.joints.pan: 180 rad are 29 turns" in note and "Use 3.14159" in note for note in notes)


def test_a_goal_beyond_its_limit_by_rounding_is_at_the_limit(folder: Path) -> None:
    setup = prepare_with(folder, {"pan": 0.0}, {"grip": 1.0 + 1e-6})
    assert "goal: grip snapped from 1.000001 to its limit 1" in setup.notes
    result = plan(read(folder, {"pan": 0.0}, {"grip": 1.0 + 1e-6}))
    assert result.verdict is Verdict.CERTIFIED
    with pytest.raises(RequestError, match=r"goal\.joints\.grip: 1\.01 is outside"):
        prepare_with(folder, {"pan": 0.0}, {"grip": 1.01})


def test_followers_that_follow_are_accepted_at_start_and_goal(folder: Path) -> None:
    setup = prepare_with(folder, {"grip": 0.5, "follower": -0.4}, {"grip": 0.2, "follower": -0.1})
    assert setup.start[1] == 0.5
    assert prepare_with(folder, {"follower": 0.1}, {"grip": 0.2}).start[1] == 0.0


@pytest.mark.parametrize(
    ("start", "goal", "line"),
    [
        (
            {"grip": 0.5, "follower": 0.4},
            {"grip": 0.1},
            r"start\.joints\.follower: 0\.4, but it follows grip at 0\.5: .* -0\.4",
        ),
        ({"follower": 0.4}, {"grip": 0.1}, r"start\.joints\.follower: 0\.4, .* give grip too"),
        ({}, {"follower": 0.1}, r"goal\.joints\.follower: it follows grip; give grip"),
        ({}, {"grip": 0.1, "follower": 0.1}, r"goal\.joints\.follower: 0\.1, but it follows grip"),
        ({}, {"thumb_j": 0.1}, r"unknown joint 'thumb_j' in goal\.joints"),
    ],
)
def test_followers_elsewhere_are_refused(
    folder: Path, start: dict[str, float], goal: dict[str, float], line: str
) -> None:
    with pytest.raises(RequestError, match=line):
        prepare_with(folder, start, goal)
