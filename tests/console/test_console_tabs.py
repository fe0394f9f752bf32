"""Tabs follow the task files, and make the requests that these stand for."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cli.console.orders import PlanOrder
from service.cli.console.scans import move_hit
from service.cli.console.sessions import OperatorSession
from service.cli.console.tabs import list_tabs, make_request
from service.errors import RequestError
from service.request.file import parse_request

KNOCK = """
help: Knock.
parameters:
  far: {type: number, unit: m, default: 0.05, range: [0.01, 0.2], help: way of the hand}
task:
  steps:
    - move: {hand: right, by: {translation: "${[far, 0, 0]}"}, along: line, speed_m_s: 0.2}
"""
HIT: dict[str, Any] = {
    "hit": 3, "kind": "valve", "searched": "valve", "confidence": 0.9, "sizes": {"outer_radius": 0.13},
    "pose_world_object": [[1, 0, 0, 0.68], [0, 1, 0, 0.12], [0, 0, 1, 1.1], [0, 0, 0, 1]], "moved_m": [0.0, 0.0, 0.0],
}  # fmt: skip
BUTTON = {"n_buttons": 1.0, "button_0_x": 0.0, "button_0_y": 0.0, "button_0_radius": 0.02, "button_0_height": 0.0}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder of task files."""
    monkeypatch.setenv("SCOPT_TASKS", str(tmp_path))
    return tmp_path


def session(**hits: Any) -> OperatorSession:
    made = OperatorSession("key", "forgery", None)  # type: ignore[arg-type]
    made.hits.update({3: HIT, 4: {**HIT, "searched": "panel", "sizes": BUTTON, "hit": 4}})
    return made


def names() -> dict[str, dict[str, Any]]:
    return {tab["name"]: tab for tab in list_tabs()}


def test_a_new_file_in_the_users_folder_is_a_tab_at_once(folder: Path) -> None:
    assert "knock" not in names()
    (folder / "knock.yaml").write_text(KNOCK)
    tab = names()["knock"]
    assert tab["help"] == "Knock."
    assert [(one["name"], one["unit"], one["default"]) for one in tab["parameters"]] == [("far", "m", 0.05)]
    assert tab["errors"] == []


def test_a_file_with_an_error_is_a_tab_that_names_it_and_leaves_the_others_alone(folder: Path) -> None:
    (folder / "knock.yaml").write_text(KNOCK.replace("type: number", "type: nummer"))
    (folder / "torn.yaml").write_text("help: [")
    tabs = names()
    assert "parameters.far.type" in tabs["knock"]["errors"][0]
    assert "knock.yaml" in tabs["knock"]["errors"][0]
    assert "torn.yaml" in tabs["torn"]["errors"][0]
    assert tabs["valve"]["errors"] == []


def test_a_tab_knows_what_may_be_clicked_by_names_that_a_request_may_use(folder: Path) -> None:
    from perception import KINDS

    tabs = names()
    assert tabs["valve"]["kinds"] == ["valve"]
    assert tabs["door"]["kinds"] == ["door"]
    assert tabs["button"]["kinds"] == ["panel"]
    assert all(kind in KINDS for tab in tabs.values() for kind in tab["kinds"])


def test_a_task_looks_for_its_object_where_the_operator_accepted_one(folder: Path, tmp_path: Path) -> None:
    scan = Path(__file__).parents[2] / "examples" / "data" / "valve_scan.pcd"
    shutil.copy(scan, tmp_path / "a.pcd")
    order = PlanOrder(task="valve", values={"turn": 60}, robot="atlas", scan="a.pcd", hit=3)
    request = make_request(session(), (tmp_path,), order)
    assert request.section.near == (0.68, 0.12, 1.1)
    assert [cloud.file for cloud in request.scene.cloud_files] == [str(tmp_path / "a.pcd")]


def test_a_fit_that_was_moved_by_hand_becomes_the_requests_object(folder: Path) -> None:
    opened = session()
    moved = move_hit(opened.hits, 3, (0.0, 0.02, -0.01))
    assert np.array(moved["pose_world_object"])[:3, 3] == pytest.approx([0.68, 0.14, 1.09])
    again = move_hit(opened.hits, moved["hit"], (0.0, 0.05, 0.0))
    assert np.array(again["pose_world_object"])[:3, 3] == pytest.approx([0.68, 0.17, 1.1])
    request = make_request(opened, (), PlanOrder(task="valve", values={}, robot="atlas", hit=again["hit"]))
    assert request.section.near == pytest.approx((0.68, 0.12, 1.1))  # where the scan shows it
    assert request.section.moved_m == (0.0, 0.05, 0.0)  # type: ignore[attr-defined]
    button = move_hit(opened.hits, 4, (0.0, 0.0, 0.1))
    press = make_request(opened, (), PlanOrder(task="button", values={}, robot="atlas", hit=button["hit"]))
    assert press.section.steps[0].press.at == pytest.approx((0.68, 0.12, 1.2))  # type: ignore[attr-defined]
    with pytest.raises(RequestError, match=r"moved_m: 0.4 m; expected at most 0.3 m"):
        move_hit(opened.hits, 3, (0.4, 0.0, 0.0))
    with pytest.raises(RequestError, match="object 99 is not known any more"):
        move_hit(opened.hits, 99, (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ({"valve": {"moved_m": [0.2, 0.2, 0.2]}}, "moved_m: 0.346 m; expected at most 0.3 m"),
        ({"valve": {"centre": [0.7, 0, 1], "moved_m": [0, 0, 0.1]}}, "correct centre instead"),
        (
            {"door": {"opens": "push", "leaf": {"hinge": [0.8, 0.5, 0], "edge": [0.8, -0.4, 0]}, "moved_m": [0, 0, 0]}},
            "correct leaf instead",
        ),
    ],
)
def test_a_correction_that_makes_no_sense_is_named(task: dict[str, Any], words: str) -> None:
    with pytest.raises(RequestError) as caught:
        parse_request({"robot": {"name": "atlas"}, "task": task})
    assert any(words in problem for problem in caught.value.problems)


def test_parameters_are_read_off_the_accepted_object_unless_the_operator_sets_them(folder: Path) -> None:
    request = make_request(session(), (), PlanOrder(task="button", values={}, robot="atlas", hit=4))
    press = request.section.steps[0].press  # type: ignore[attr-defined]
    assert tuple(press.at) == (0.68, 0.12, 1.1)
    own = PlanOrder(task="button", values={"at": [1, 0, 1]}, robot="atlas", hit=4)
    assert tuple(make_request(session(), (), own).section.steps[0].press.at) == (1, 0, 1)  # type: ignore[attr-defined]


def test_of_several_buttons_the_one_that_was_clicked_is_pressed_at_its_front(folder: Path) -> None:
    opened, order = session(), PlanOrder(task="button", values={}, robot="atlas", hit=5)
    lower = {"button_1_x": 0.01, "button_1_y": -0.06, "button_1_radius": 0.02, "button_1_height": 0.015}
    panel = {**opened.hits[4], "hit": 5, "sizes": {**BUTTON, **lower, "n_buttons": 2.0}}
    opened.hits[5] = {**panel, "clicked": [0.68, 0.08, 1.1]}
    request = make_request(opened, (), order)
    assert request.section.steps[0].press.at == pytest.approx((0.69, 0.06, 1.115))  # type: ignore[attr-defined]
    moved = move_hit(opened.hits, 5, (0.0, 0.1, 0.0))  # the button that was clicked goes along
    request = make_request(opened, (), replace(order, hit=moved["hit"]))
    assert request.section.steps[0].press.at == pytest.approx((0.69, 0.16, 1.115))  # type: ignore[attr-defined]
    opened.hits[5] = panel
    with pytest.raises(RequestError, match=r"values.at: the panel has 2 buttons, at 0.680, 0.120, 1.100; 0.690, 0.060"):
        make_request(opened, (), order)


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (PlanOrder(task="knock", values={"far": 3}, robot="atlas"), "task.with.far: expected 0.01 to 0.2 m, got 3"),
        (PlanOrder(task="knok", values={}, robot="atlas"), "unknown task 'knok'; expected knock"),
        (PlanOrder(task="../knock", values={}, robot="atlas"), "task.use"),
        (PlanOrder(task="knock", values={}, robot="atlas", scan="no.pcd"), "scan: there is no scan 'no.pcd' here"),
        (PlanOrder(task="knock", values={}, robot="atlas", scan="../../a.pcd"), "scan: there is no scan"),
        (PlanOrder(task="valve", values={}, robot="atlas", hit=99), "hit: object 99 is not known any more"),
        (PlanOrder(task="button", values={}, robot="atlas"), "task.with.at: is missing; middle of the button's front"),
    ],
)
def test_what_cannot_be_asked_for_is_named(folder: Path, order: PlanOrder, words: str) -> None:
    (folder / "knock.yaml").write_text(KNOCK)
    with pytest.raises(RequestError) as caught:
        make_request(session(), (folder,), order)
    assert any(words in problem for problem in caught.value.problems)
