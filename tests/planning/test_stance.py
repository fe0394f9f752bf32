"""The search for a place to stand: what it offers for a push door, what it refuses, and what it writes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from clocks import CountingClock
from given_mechanisms import drawer_request
from typer.testing import CliRunner

from scopt import EffortClock
from service import RequestError, StanceSearch, find_stance, load_request, parse_request
from service.cli.app import app
from service.planner import plan
from service.result.result import Verdict
from service.result.stance_output import describe_search, draw_search, write_request
from service.tasks.stances import search as stance_search

DOOR = {
    "open_deg": 30,
    "opens": "push",
    "leaf": {"hinge": [0.75, -0.45, 0.01], "edge": [0.75, 0.45, 0.01]},
    "handle": {"kind": "lever", "centre": [0.65, 0.38, 1.02]},
}
WALL = {"name": "wall", "type": "box", "size": [0.12, 1.2, 2.4], "position": [0.7, -1.1, 1.2]}
REQUEST = {
    "robot": {"name": "atlas"},
    "start": {"posture": "reach_ready"},
    "scene": {"obstacles": [WALL]},
    "task": {"door": DOOR},
}


@pytest.fixture(scope="module")
def search() -> StanceSearch:
    """Search with little effort."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stance_search, "ENOUGH_GOOD", 1)
        patch.setattr(stance_search, "FINE", 1)
        patch.setattr(stance_search, "FINE_ROUNDS", 1)
        return find_stance(parse_request(REQUEST), limit_s=300.0, clock=EffortClock())


def test_best_stance_opens_the_door_in_single_poses(search: StanceSearch) -> None:
    best = search.best
    assert search.is_complete
    assert best is not None
    assert best.outcome is not None
    assert np.rad2deg(best.outcome.reached) == pytest.approx(30.0)
    assert best.outcome.balance_m >= 0.02
    assert best.clearance_m >= 0.02


def test_a_drawer_of_a_file_has_a_place_to_stand_from_which_it_comes_out_whole(tmp_path: Path) -> None:
    data = drawer_request()
    (tmp_path / "drawer.urdf").write_text(data["task"]["mechanism"]["urdf"])
    data["task"]["mechanism"]["urdf"] = str(tmp_path / "drawer.urdf")
    away = float(data.get("start", {}).get("base", {}).get("position", [0.0])[0]) - 0.5
    data["start"] = {"posture": "reach_ready", "base": {"position": [away, 0.0, 0.9177]}}
    found = find_stance(parse_request(data), limit_s=300.0, clock=EffortClock(), radius_m=0.7, takes_first=True)
    best = found.best
    assert best is not None
    assert best.outcome is not None
    assert best.outcome.reached == pytest.approx(1.0), "a share of the way of the handle"
    assert not best.outcome.missing
    parts = describe_search(found)["candidates"][0]["parts"]
    assert parts["share"] == pytest.approx(1.0)
    assert parts["angle_deg"] is None
    ElementTree.fromstring(draw_search(found))
    data["start"]["base"] = {"position": list(best.position), "quaternion_wxyz": list(best.quaternion_wxyz)}
    assert plan(parse_request(data)).verdict is Verdict.CERTIFIED


def test_best_stance_comes_first_and_refused_ones_last(search: StanceSearch) -> None:
    scores = [candidate.score for candidate in search.candidates]
    assert scores == sorted(scores, reverse=True)
    assert all(candidate.score == 0.0 for candidate in search.candidates if candidate.refused)


def test_feet_stay_on_the_robots_side_of_the_leaf_and_flat(search: StanceSearch) -> None:
    best = search.best
    assert best is not None
    corners = np.concatenate(list(best.soles.values()))
    assert corners[:, 0].max() < 0.75 - 0.045
    assert np.ptp(corners[:, 2]) < 3e-3


def test_every_refusal_says_why(search: StanceSearch) -> None:
    for candidate in search.candidates:
        assert candidate.refused or candidate.outcome is not None
        assert all(len(line) > 10 for line in candidate.refused)


def test_json_has_a_base_that_a_request_accepts(search: StanceSearch) -> None:
    data = json.loads(json.dumps(describe_search(search), allow_nan=False))
    request = parse_request({**REQUEST, "start": {"posture": "reach_ready", "base": data["best"]}})
    assert request.start.base is not None
    assert search.best is not None
    np.testing.assert_allclose(request.start.base.position, search.best.start[:3], atol=1e-4)
    first = data["candidates"][0]
    assert set(first) == {"base", "yaw_deg", "score", "refused", "parts", "hold", "missing"}
    assert set(first["parts"]) == {
        "angle_deg",
        "asked_deg",
        "balance_m",
        "reach_m",
        "clearance_m",
        "torque_share",
        "share",
    }


def test_picture_is_svg_with_the_wall_the_leaf_and_the_soles(search: StanceSearch) -> None:
    root = ElementTree.fromstring(draw_search(search))
    titles = {title.text for title in root.iter("{http://www.w3.org/2000/svg}title")}
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert {"wall", "at the start", "at the end"} <= titles
    assert any(title is not None and title.startswith("1: score") for title in titles)


def test_written_request_stands_at_the_best_place_and_finds_its_files(search: StanceSearch, tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    source = tmp_path / "door.yaml"
    source.write_text(yaml.safe_dump({**REQUEST, "scene": {"cloud": "scan.pcd"}}))
    assert search.best is not None
    write_request(source, search.best, tmp_path / "deep" / "out.yaml")
    written = load_request(tmp_path / "deep" / "out.yaml")
    assert written.scene.cloud == "../scan.pcd"
    assert written.start.posture == "reach_ready"
    assert written.start.base is not None
    assert written.start.base.position == pytest.approx(search.best.position)


def test_the_requests_own_place_is_checked_first(search: StanceSearch) -> None:
    assert any(np.allclose(candidate.base, 0.0) for candidate in search.candidates)


def test_a_place_that_has_all_poses_ends_the_search_for_a_first_one(search: StanceSearch) -> None:
    assert search.best is not None
    base = {"position": list(search.best.position), "quaternion_wxyz": list(search.best.quaternion_wxyz)}
    request = parse_request({**REQUEST, "start": {"posture": "reach_ready", "base": base}})
    first = find_stance(request, limit_s=300.0, clock=EffortClock(), takes_first=True)
    assert [candidate.outcome.missing for candidate in first.candidates if candidate.outcome] == [""]
    assert len(first.candidates) == 1


def test_stance_for_a_goal_is_refused() -> None:
    request = parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "reach_ready"}})
    with pytest.raises(RequestError, match=r"expected task.door, task.valve or task.mechanism"):
        find_stance(request)


def test_stance_of_a_fixed_robot_is_refused() -> None:
    request = parse_request(REQUEST)
    with pytest.raises(RequestError, match="is fixed and plants no feet"):
        find_stance(replace(request, robot=replace(request.robot, root="fixed")))


def test_nothing_in_reach_is_a_result_with_a_reason() -> None:
    far = {**DOOR, "leaf": {"hinge": [5.75, -0.45, 0.01], "edge": [5.75, 0.45, 0.01]}}
    far["handle"] = {"kind": "lever", "centre": [5.65, 0.38, 1.02]}
    search = find_stance(parse_request({**REQUEST, "task": {"door": far}}))
    assert search.best is None
    assert search.is_complete
    assert "no place within 1 m" in search.notes[-1]


def test_command_refuses_a_goal_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "goal.yaml"
    path.write_text("robot: {name: atlas}\ngoal: {posture: reach_ready}\n")
    done = CliRunner().invoke(app, ["stance", str(path), "--json", "--out", str(tmp_path / "out")])
    assert done.exit_code == 3
    assert "expected task.door, task.valve or task.mechanism" in json.loads(done.stdout)["explanation"][0]


def test_time_limit_ends_the_search_with_what_it_has() -> None:
    search = find_stance(parse_request(REQUEST), limit_s=0.3, clock=CountingClock(0.01))
    assert not search.is_complete


def test_command_says_that_no_place_was_examined_in_time(tmp_path: Path) -> None:
    path = tmp_path / "door.yaml"
    path.write_text(json.dumps(REQUEST))
    done = CliRunner().invoke(app, ["stance", str(path), "--time-limit", "0.1", "--out", str(tmp_path / "out")])
    assert done.exit_code == 5
    assert "no place to stand was found: none could be examined within 0.1 s; raise --time-limit" in done.stdout
