"""The problem files that TrajOpt's two repositories ship, as they are published, on robots given by path."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from trajopt_robots import write_slider, write_two_arms

from service import PlanResult, RequestError, plan
from service.trajopt.json_fields import parse_document
from service.trajopt.request import TrajoptFiles, load_trajopt_request

DATA = Path(__file__).parents[1] / "data" / "trajopt"
TABLE = "obstacles:\n  - {name: table, type: box, size: [0.6, 0.7, 0.04], position: [0.65, -0.2, 0.7]}\n"


def _plan(folder: Path, name: str, robot: Path, scene: str = "", start: str = "") -> PlanResult:
    files = {"scene": None, "start": None}
    for key, text in (("scene", scene), ("start", start)):
        if text:
            (folder / f"{key}.yaml").write_text(text)
            files[key] = folder / f"{key}.yaml"  # type: ignore[assignment]
    return plan(
        load_trajopt_request(DATA / f"{name}.json", TrajoptFiles(str(robot), robot.with_suffix(".srdf"), **files))
    )


@pytest.mark.parametrize(
    "name",
    [
        "tesseract_arm_around_table",
        "tesseract_arm_around_table_continuous",
        "tesseract_arm_around_table_time",
        "original_arm_around_table",
        "original_arm_around_table_continuous",
    ],
)
def test_an_arm_goes_around_a_table(tmp_path: Path, name: str) -> None:
    start = "joints: {r_shoulder_pan_joint: -1.832, r_shoulder_lift_joint: -0.332, r_upper_arm_roll_joint: -1.011, "
    start += "r_elbow_flex_joint: -1.437, r_forearm_roll_joint: -1.1, r_wrist_flex_joint: -1.926, "
    start += "r_wrist_roll_joint: 3.074}" if name.endswith("time") else ""
    result = _plan(tmp_path, name, write_two_arms(tmp_path), TABLE, start if name.endswith("time") else "")
    assert result.verdict.value == "CERTIFIED", result.explanation
    goal = json.loads((DATA / f"{name}.json").read_text())["constraints"][0]["params"]
    columns = [result.joint_names.index(joint) for joint in result.joint_names if joint.startswith("r_")]
    np.testing.assert_allclose(result.positions[-1, columns], goal.get("targets", goal.get("vals")), atol=1e-3)


@pytest.mark.parametrize("name", ["tesseract_box_cast_test", "original_box_cast_test"])
def test_a_box_goes_around_a_box_in_two_steps(tmp_path: Path, name: str) -> None:
    robot = write_slider(tmp_path, "boxbot", '<box size="1 1 1"/>', ((0.0, 0.0, 0.0),))
    result = _plan(tmp_path, name, robot)
    assert result.verdict.value == "CERTIFIED", result.explanation
    np.testing.assert_allclose(result.positions[[0, -1]], [[-1.9, 0.0], [1.9, 3.8]], atol=1e-3)
    assert result.certificate is not None
    assert result.certificate.min_clearance_m > 0.0


@pytest.mark.parametrize(
    ("name", "is_constraint"), [("tesseract_numerical_ik1", True), ("original_numerical_ik1", False)]
)
def test_one_step_is_inverse_kinematics(tmp_path: Path, name: str, is_constraint: bool) -> None:
    result = _plan(tmp_path, name, write_two_arms(tmp_path))
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert any("n_steps is 1" in note for note in result.notes)
    import pinocchio as pin

    data = result.robot.model.createData()
    pin.framesForwardKinematics(result.robot.model, data, result.positions[-1])
    pose = data.oMf[result.robot.model.getFrameId("l_gripper_tool_frame")]
    np.testing.assert_allclose(pose.translation, [0.4, 0.0, 0.8], atol=1.1e-3 if is_constraint else 0.02)
    np.testing.assert_allclose(pose.rotation, np.diag([-1.0, 1.0, -1.0]), atol=0.01 if is_constraint else 0.1)


def test_a_ball_keeps_its_distance_from_balls(tmp_path: Path) -> None:
    balls = ((0.0, 0.0, 0.0), (-0.75, 0.0, 0.0), (0.0, 0.75, 0.0))
    robot = write_slider(tmp_path, "spherebot", '<sphere radius="0.5"/>', balls)
    start = "joints: {x_joint: -2.5, y_joint: 2.5}"
    result = _plan(tmp_path, "tesseract_simple_collision_test", robot, start=start)
    assert result.verdict.value == "CERTIFIED", result.explanation
    apart = np.linalg.norm(np.append(result.positions[-1], 0.0) - np.array(balls), axis=1) - 1.0
    assert apart.min() >= 0.2 - 2e-3


def test_a_ball_inside_balls_at_its_start_is_told_so(tmp_path: Path) -> None:
    robot = write_slider(tmp_path, "spherebot", '<sphere radius="0.5"/>', ((0.0, 0.0, 0.0),))
    with pytest.raises(RequestError, match="start is in collision"):
        _plan(tmp_path, "tesseract_simple_collision_test", robot)


def test_a_problem_is_planned_without_times_or_without_torques(tmp_path: Path) -> None:
    robot = write_slider(tmp_path, "boxbot", '<box size="1 1 1"/>', ((0.0, 0.0, 0.0),))
    files = TrajoptFiles(str(robot), robot.with_suffix(".srdf"), is_timed=False)
    result = plan(load_trajopt_request(DATA / "tesseract_box_cast_test.json", files))
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert result.velocities is None
    files = TrajoptFiles(str(robot), robot.with_suffix(".srdf"), checks_torque=False)
    assert load_trajopt_request(DATA / "tesseract_box_cast_test.json", files).robot.torque is not None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("original_point_normal1", "line 5: no valid JSON: a comma before '}'; remove it"),
        ("original_request1", "line 13: no valid JSON: the text ends before its brackets are closed"),
        ("original_request_example", "key 'COMMENT_initialization' is given twice"),
    ],
)
def test_the_originals_sketches_of_a_format_say_why_they_are_no_problems(tmp_path: Path, name: str, words: str) -> None:
    with pytest.raises(RequestError) as caught:
        _plan(tmp_path, name, write_two_arms(tmp_path))
    assert str(caught.value) == f"{name}.json: {words}"


def test_a_sketch_with_valid_syntax_gets_a_line_for_each_key_that_no_version_of_trajopt_reads(tmp_path: Path) -> None:
    text = (DATA / "original_request_example.json").read_text().replace("COMMENT_initialization", "COMMENT_1", 1)
    (tmp_path / "sketch.json").write_text(text.replace("COMMENT_initialization", "COMMENT_2", 1))
    robot = write_two_arms(tmp_path)
    with pytest.raises(RequestError) as caught:
        plan(load_trajopt_request(tmp_path / "sketch.json", TrajoptFiles(str(robot), robot.with_suffix(".srdf"))))
    lines = str(caught.value).splitlines()
    for words in ("basic_info.n_steps", "basic_info.num_timesteps", "constraints[0].type", "constraints[1].type"):
        assert any(words in line for line in lines), (words, lines)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a": 1, // why\n}', "a comment"),
        ('{"a": [1, 2,]}', "a comma before ']'; remove it"),
        ('{"a": tru}', "Expecting value"),
        ("", "the text ends before its brackets are closed"),
    ],
)
def test_syntax_that_other_readers_tolerate_is_explained(text: str, words: str) -> None:
    with pytest.raises(RequestError, match="line 1: no valid JSON") as caught:
        parse_document(text, "problem.json")
    assert words in str(caught.value)
