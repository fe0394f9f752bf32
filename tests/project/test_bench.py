"""Problem sets: reading, running, summary, resuming, and errors in files."""

import json

import numpy as np
import pytest
from planar_arm import write_planar_arm

from service.bench.bench import list_failures, run_bench, summarize_scenes
from service.bench.problem_set import BenchRobot, read_problems
from service.errors import RequestError
from service.start.robot import load_requested_robot


@pytest.fixture
def arm(tmp_path) -> BenchRobot:
    """Return an arm of two 0.3 m links that turn in a horizontal plane."""
    return BenchRobot(write_planar_arm(tmp_path, 2, 0.3, 0.03, limit=2.9))


def problem(number: int, scene: str, goal: list[float]) -> dict:
    post = {"name": "post", "type": "box", "position": [0.5, 0, 0], "quat_xyzw": [0, 0, 0, 1], "size": [0.1, 0.1, 0.1]}
    can = {"name": "post", "type": "cylinder", "position": [0, -2, 0], "quat_xyzw": [0, 0, 0, 1]}
    obstacles = [post, can | {"radius": 0.1, "length": 0.3}]
    return {"id": f"{scene}/{number}", "scene": scene, "start": [0.0, -0.9], "goal": goal, "obstacles": obstacles}


def write(folder, problems: list[dict]):
    file = folder / "set.json"
    # the joint order of the file differs from the robot's
    file.write_text(json.dumps({"joints": ["j1", "j0"], "problems": problems}))
    return file


def test_rows_say_what_was_certified_and_hold_the_path_in_the_files_joint_order(arm, tmp_path):
    file = write(tmp_path, [problem(1, "post", [0.2, 0.9]), problem(2, "post", [0.0, 0.0])])
    problems = read_problems(file, arm, {})
    rows = run_bench(
        problems, load_requested_robot(problems[0].request), tmp_path / "out.json", lambda name, done: None
    )
    first, second = rows
    assert first["success_claimed"]
    assert first["verdict"] == "CERTIFIED"
    np.testing.assert_allclose(first["path"][0], [0.0, -0.9], atol=1e-12)
    np.testing.assert_allclose(first["path"][-1], [0.2, 0.9], atol=1e-9)
    assert first["cpu_s"] > 0.0
    assert not second["success_claimed"]
    assert "the goal is in collision: l1 is" in second["reason"]
    assert [line[:3] for line in summarize_scenes(rows)] == [("post", "2", "1"), ("all", "2", "1")]
    assert summarize_scenes(rows)[-1][-1] == "1 INFEASIBLE"


def test_an_interrupted_run_goes_on_where_it_stopped(arm, tmp_path):
    file = write(tmp_path, [problem(1, "post", [0.2, 0.9])])
    problems = read_problems(file, arm, {})
    out = tmp_path / "out.json"
    out.write_text(json.dumps({"peer": "scopt", "results": [{"problem": "post/1", "scene": "post", "time_s": 7.0}]}))
    rows = run_bench(problems, load_requested_robot(problems[0].request), out, lambda name, done: None)
    assert rows == [{"problem": "post/1", "scene": "post", "time_s": 7.0}]


def test_the_limit_counts_per_scene(arm, tmp_path):
    file = write(tmp_path, [problem(k, scene, [0.2, 0.9]) for scene in ("a", "b") for k in range(3)])
    assert [p.name for p in read_problems(file, arm, {}, limit=2)] == ["a/0", "a/1", "b/0", "b/1"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read as JSON"),
        ("{}", "not a problem file: KeyError"),
        ('{"joints": ["j0"], "problems": [{"id": 1}]}', "not a problem file: KeyError"),
    ],
)
def test_files_of_another_form_are_refused_by_name(arm, tmp_path, text, message):
    file = tmp_path / "set.json"
    file.write_text(text)
    with pytest.raises(RequestError, match=message) as caught:
        read_problems(file, arm, {})
    assert str(file) in str(caught.value)


def test_a_folder_without_problems_is_refused(arm, tmp_path):
    with pytest.raises(RequestError, match="holds no problem files"):
        read_problems(tmp_path / "nowhere", arm, {})


def test_a_problem_that_is_refused_has_a_row_like_every_other(arm, tmp_path):
    inside = problem(1, "post", [0.2, 0.9]) | {"start": [0.0, 0.0]}
    beyond = problem(2, "post", [0.2, 9.0])
    problems = read_problems(write(tmp_path, [inside, beyond, problem(3, "post", [0.2, 0.9])]), arm, {})
    rows = run_bench(
        problems, load_requested_robot(problems[0].request), tmp_path / "out.json", lambda name, done: None
    )
    assert [row["verdict"] for row in rows] == ["INVALID_REQUEST", "INVALID_REQUEST", "CERTIFIED"]
    assert "start is in collision: l1 is" in rows[0]["reason"]
    assert rows[1]["reason"].startswith("goal.joints.j0: 9 is outside")
    assert [name for name, _, _ in list_failures(rows)] == ["post/1", "post/2"]
