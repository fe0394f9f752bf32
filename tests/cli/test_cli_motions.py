"""``scopt task`` and ``scopt move``: what they list, and the requests that they plan."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.motions import move, task
from service.cli.motions.move import WhereOptions, read_move_request
from service.cli.motions.task import read_settings, read_task_request
from service.request.file import parse_request


def run(*arguments: str) -> str:
    outcome = CliRunner().invoke(app, list(arguments))
    assert outcome.exit_code == 0, outcome.output
    return outcome.output


@pytest.fixture(name="planned")
def _planned(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Requests that commands would plan."""
    requests: list[Any] = []

    def keep(read: Any, folder: Path, planning: Any, *, as_json: bool) -> str:
        requests.append(read()[0])
        return "CERTIFIED"

    monkeypatch.setattr(move, "plan_and_write", keep)
    monkeypatch.setattr(task, "plan_and_write", keep)
    return requests


def test_the_shipped_tasks_are_listed_with_their_help() -> None:
    listed = json.loads(run("task", "list", "--json"))["tasks"]
    assert {"valve", "door", "button", "lever", "wipe", "drill"} <= {entry["name"] for entry in listed}
    assert all(entry["help"].endswith(".") for entry in listed)


def test_a_task_is_shown_with_range_default_and_unit_of_its_parameters() -> None:
    radius = json.loads(run("task", "show", "drill", "--json"))["parameters"]["radius"]
    assert (radius["unit"], radius["default"], radius["expected"]) == ("m", "0.2", "0.02 to 0.35")
    assert "of a detected panel" in run("task", "show", "button")


@pytest.mark.parametrize(
    ("text", "value"),
    [("a=0.2", 0.2), ("a=left", "left"), ("a=1,-2,3", [1.0, -2.0, 3.0]), ("a=[wall]", ["wall"]), ("a=x,y", ["x", "y"])],
)
def test_settings_are_numbers_texts_and_lists(text: str, value: object) -> None:
    assert read_settings([text]) == {"a": value}


def test_a_task_runs_with_its_settings(planned: list[Any]) -> None:
    run("task", "run", "button", "--set", "at=0.7,-0.2,1.2", "--set", "force=12")
    with_values = {"use": "button", "with": {"at": [0.7, -0.2, 1.2], "force": 12.0}}
    assert planned == [parse_request({"robot": {"name": "atlas"}, "task": with_values}, Path.cwd())]


def test_a_task_runs_in_the_scene_of_a_request(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text(
        "robot: {name: atlas}\ngoal: {posture: stand}\n"
        "scene: {obstacles: [{name: wall, type: box, size: [1, 1, 1], position: [2, 0, 1]}]}\n"
    )
    settings = ("centre=0.8,0,1", "wall=[wall]")
    request = read_task_request("drill", settings, None, tmp_path / "base.yaml", "atlas")
    assert request.goal is None
    assert [obstacle.name for obstacle in request.scene.obstacles] == ["wall"]
    assert [body.name for body in request.attached] == ["drill", "bit"]
    assert request.start.posture == "reach_ready"


LINE = {"hand": "right", "other_hand": "keep", "free_axis": "none"}


@pytest.mark.parametrize(
    ("arguments", "step"),
    [
        (["line", "--hand", "right", "--by", "0", "0", "0.1", "--speed", "0.2"],
         {"move": {**LINE, "by": {"translation": [0, 0, 0.1]}, "along": "line", "speed_m_s": 0.2}}),
        (["line", "--hand", "both", "--rotate", "0", "0", "10", "--axes", "hand", "--other-hand", "lock"],
         {"move": {"hand": "both", "other_hand": "lock", "by": {"rotation_deg": [0, 0, 10], "axes": "hand"},
                   "along": "line"}}),
        (["circle", "--hand", "right", "--centre", "0.7", "0", "1.2", "--angle", "90", "--keeps"],
         {"move": {**LINE, "along": "arc",
                   "arc": {"centre": [0.7, 0, 1.2], "axis": [1, 0, 0], "angle_deg": 90, "turns": False}}}),
        (["plunge", "--frame", "r_tool", "--by", "0.05", "--free-axis", "z"],
         {"screw": {"frame": "r_tool", "axes": "hand", "translation_m": 0.05, "free_axis": "z"}}),
        (["nudge", "Up", "--hand", "left"],
         {"move": {"hand": "left", "by": {"translation": [0, 0, 0.01]}, "along": "line"}}),
        (["nudge", "o", "--hand", "right", "--touch-force", "20", "--touch", "wall"],
         {"touch": {"hand": "right", "direction": [1, 0, 0], "window_m": [0, 0.01], "force_n": 20,
                    "pieces": ["wall"]}}),
        (["nudge", "q", "--neck", "neck_ry=0.1"], {"move": {"joints": {"neck_ry": 0.08}, "along": "joint_cubic"}}),
        (["joints", "--set", "r_arm_elx=-1.2", "--duration", "2"],
         {"move": {"joints": {"r_arm_elx": -1.2}, "along": "joint_cubic", "duration_s": 2}}),
        (["body", "--pelvis", "0", "0", "-0.05", "--torso", "0", "0", "10", "--hands", "along"],
         {"body": {"pelvis_m": [0, 0, -0.05], "torso_rpy_deg": [0, 0, 10], "hands": "along"}}),
        (["preset", "reach_ready"], {"move": {"posture": "reach_ready"}}),
    ],
)  # fmt: skip
def test_a_word_stands_for_one_step(planned: list[Any], arguments: list[str], step: dict[str, Any]) -> None:
    run("move", *arguments)
    assert planned == [parse_request({"robot": {"name": "atlas"}, "task": {"steps": [step]}}, Path.cwd())]


def test_the_neck_turns_by_degrees(planned: list[Any]) -> None:
    run("move", "neck", "--angle", "20")
    assert planned[0].task.steps[0].move.joints == {"neck_ry": pytest.approx(0.349066, abs=1e-6)}


def test_a_motion_begins_at_the_state_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "state.yaml").write_text("posture: reach_ready\n")
    step = {"move": {"posture": "stand"}}
    request = read_move_request(step, WhereOptions(state=tmp_path / "state.yaml"))
    assert request.start.posture == "reach_ready"


def test_freeze_keeps_every_joint_above_the_legs(planned: list[Any], tmp_path: Path) -> None:
    state = tmp_path / "state.yaml"
    state.write_text("posture: reach_ready\njoints: {r_arm_elx: -0.7}\n")
    run("move", "freeze", "--state", str(state))
    (step,) = planned[0].task.steps
    assert step.move.joints["r_arm_elx"] == -0.7
    assert {"back_bkz", "neck_ry", "l_arm_wry2"} <= step.move.joints.keys()
    assert not any("leg" in name for name in step.move.joints)
