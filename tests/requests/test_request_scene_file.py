"""A scene's file to plan in: its pieces and its valve are those of the plan, and a file that is none says so."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.robot import RobotModel, load_robot
from service.errors import RequestError
from service.request.file import parse_request
from service.scan.scene_file import MOST_VERTICES, read_scene
from service.setup.prepare import PlanSetup, prepare

GOAL = {"posture": "stand"}
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
WHEEL = {"outer_radius": 0.2, "rim_radius": 0.185, "tube_radius": 0.015}


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


def _cube(name: str, centre: tuple[float, float, float], edge: float, kind: str = "clutter") -> dict[str, Any]:
    return {"name": name, "kind": kind, "vertices": (edge * (CUBE - 0.5) + centre).tolist()}


def _hit(x: float, confidence: float, **more: Any) -> dict[str, Any]:
    pose = [[0.0, 0.0, -1.0, x], [-1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 1.1], [0.0, 0.0, 0.0, 1.0]]
    return {"kind": "valve", "confidence": confidence, "pose_world_object": pose, "sizes": WHEEL, **more}


def _write(folder: Path, **parts: Any) -> Path:
    path = folder / "scene.json"
    path.write_text(json.dumps({"format": "scopt-scene/1", "pieces": [], **parts}))
    return path


def _prepare(atlas: RobotModel, folder: Path, scene: dict[str, Any], **more: Any) -> PlanSetup:
    request = {"robot": {"name": "atlas"}, **({"goal": GOAL} if "task" not in more else {}), "scene": scene, **more}
    return prepare(parse_request(request, folder), robot=atlas)


def _problem(path: Path) -> str:
    with pytest.raises(RequestError) as caught:
        read_scene(path, "scene.file")
    (line,) = caught.value.problems
    return line.replace(str(path), "FILE")


def test_pieces_of_the_file_are_the_scene(atlas: RobotModel, tmp_path: Path) -> None:
    _write(tmp_path, pieces=[_cube("floor", (0.0, 0.0, -5.0), 10.0, "floor"), _cube("wall/0", (3.0, 0.0, 1.0), 1.0)])
    box = {"name": "box", "type": "box", "size": [0.1, 0.1, 0.1], "position": [2.0, 0.0, 1.0]}
    setup = _prepare(atlas, tmp_path, {"file": "scene.json", "obstacles": [box]})
    assert [piece.name for piece in setup.scene.pieces] == ["box", "floor", "wall/0"]
    assert setup.scene.pieces[2].vertices == pytest.approx(CUBE - 0.5 + (3.0, 0.0, 1.0))


def test_valve_of_the_file_is_turned_and_its_wheel_may_be_touched(atlas: RobotModel, tmp_path: Path) -> None:
    pieces = [_cube("clutter/0", (0.8, 0.28, 1.1), 0.03), _cube("clutter/1", (0.9, 0.1, 1.1), 0.03)]
    _write(tmp_path, pieces=pieces, detections=[_hit(2.0, 0.4), _hit(0.8, 0.9)])
    setup = _prepare(atlas, tmp_path, {"file": "scene.json"}, task={"valve": {}})
    assert [piece.name for piece in setup.scene.pieces] == ["clutter/1", "floor"]  # on the rim; 10 cm behind it
    valve = setup.surroundings.valves[0]
    assert valve.confidence == 0.9
    assert valve.centre == pytest.approx([0.8, 0.1, 1.1])
    assert valve.axis == pytest.approx([-1.0, 0.0, 0.0])
    assert (valve.rim_radius, valve.outer_radius, valve.tube_radius) == (0.185, 0.2, 0.015)


def test_of_several_valves_the_one_near_the_hint_is_meant(atlas: RobotModel, tmp_path: Path) -> None:
    _write(tmp_path, detections=[_hit(0.8, 0.9), _hit(2.0, 0.8)])
    setup = _prepare(atlas, tmp_path, {"file": "scene.json", "hint": [1.9, 0.0, 1.0]}, task={"valve": {}})
    assert setup.surroundings.valves[0].centre[0] == 2.0


def test_a_valve_moved_by_hand_is_turned_where_it_was_moved_to_with_what_is_behind_it(
    atlas: RobotModel, tmp_path: Path
) -> None:
    pieces = [_cube("stem", (1.05, 0.1, 1.1), 0.03, "stem"), _cube("wall/0", (3.0, 0.0, 1.0), 1.0)]
    _write(tmp_path, pieces=pieces, detections=[_hit(0.8, 0.9)])
    task = {"valve": {"moved_m": [0.0, 0.03, 0.04]}}
    setup = _prepare(atlas, tmp_path, {"file": "scene.json"}, task=task)
    assert setup.surroundings.valves[0].centre == pytest.approx([0.8, 0.13, 1.14])
    middles = {piece.name: piece.vertices.mean(axis=0) for piece in setup.scene.pieces}
    assert middles["stem"] == pytest.approx([1.05, 0.13, 1.14])
    assert middles["wall/0"] == pytest.approx([3.0, 0.0, 1.0])
    assert "the valve was moved by hand by 0.050 m from where the scan shows it" in setup.notes


def test_a_goal_leaves_the_wheel_where_it_is(atlas: RobotModel, tmp_path: Path) -> None:
    _write(tmp_path, pieces=[_cube("clutter/0", (0.8, 0.28, 1.1), 0.03)], detections=[_hit(0.8, 0.9)])
    assert [p.name for p in _prepare(atlas, tmp_path, {"file": "scene.json"}).scene.pieces] == ["clutter/0", "floor"]


def test_robot_in_the_scene_is_told_how_it_is_left_out(atlas: RobotModel, tmp_path: Path) -> None:
    _write(tmp_path, pieces=[_cube("clutter/0", (0.0, 0.0, 1.0), 0.2)])
    with pytest.raises(RequestError, match=r"(?s)start is in collision.*scene\.file: .*--robot NAME"):
        _prepare(atlas, tmp_path, {"file": "scene.json"})


def test_file_and_cloud_exclude_each_other() -> None:
    scene = {"file": "scene.json", "cloud": "scan.pcd"}
    with pytest.raises(RequestError, match="scene: file and cloud exclude each other"):
        parse_request({"robot": {"name": "atlas"}, "goal": GOAL, "scene": scene})


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"format": None}, "is no scene, its format is None"),
        ({"format": "scopt-scene/9"}, "is no scene, its format is 'scopt-scene/9'; expected scopt-scene/1"),
        ({"pieces": 3}, "pieces: Input should be a valid list"),
        ({"pieces": [{"name": "a"}]}, "pieces.0.kind: Field required"),
        ({"pieces": [_cube("a", (0.0, 0.0, 0.0), 1.0)] * 2}, "pieces: piece names must be unique; repeated: a"),
        ({"pieces": [_cube("a", (0.0, 0.0, 0.0), float("nan"))]}, "pieces.0.vertices.0.0: Input should be"),
        ({"pieces": [_cube("a", (0.0, 0.0, 0.0), float("inf"))]}, "pieces.0.vertices.0.0: Input should be"),
        ({"pieces": [_cube("a", (0.0, 0.0, 0.0), 0.0)]}, "pieces: the vertices of 'a' lie in a plane"),
        ({"pieces": [{"name": "a", "kind": "", "vertices": [[0, 0, 0]] * 3}]}, "should have at least 4 items"),
        ({"pieces": [{"name": "a", "kind": "", "vertices": [[0, 0, 0]] * (MOST_VERTICES + 1)}]}, "should have at most"),
        ({"detections": [_hit(0.8, 1.5)]}, "detections.0.confidence: Input should be less than or equal to 1"),
        ({"detections": [_hit(0.8, 0.9, pose_world_object=[[1.0]])]}, "detections.0.pose_world_object"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, parts: dict[str, Any], words: str) -> None:
    line = _problem(_write(tmp_path, **parts))
    assert line.startswith("scene.file: FILE")
    assert words in line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            b"VERSION 0.7\nFIELDS x y z\n",
            "is no JSON; expected the file that 'scopt scene' writes, a scan goes into scene.cloud",
        ),
        (b"[1, 2]", "is no scene, its format is None; expected scopt-scene/1, a scan goes into scene.cloud"),
        (b"[" * 100_000, "is no JSON"),
        (b"\xff\xfe\x00", "is no JSON"),
        (b"", "is no JSON"),
    ],
)
def test_a_file_that_is_no_scene_says_so(tmp_path: Path, text: bytes, words: str) -> None:
    path = tmp_path / "scene.json"
    path.write_bytes(text)
    assert words in _problem(path)


def test_a_file_that_is_not_there_says_so(tmp_path: Path) -> None:
    assert _problem(tmp_path / "none.json") == "scene.file: FILE cannot be read: No such file or directory"


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=10,
)


@given(
    field=st.sampled_from(["pieces", "detections", "format"]),
    inner=st.sampled_from(["", "name", "kind", "vertices", "confidence", "pose_world_object", "sizes"]),
    value=JSON,
)
def test_whatever_a_file_holds_it_is_read_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, field: str, inner: str, value: Any
) -> None:
    whole = {"pieces": _cube("a", (0.0, 0.0, 0.0), 1.0), "detections": _hit(0.8, 0.9)}.get(field, {})
    parts = {field: [{**whole, inner: value}] if inner else value}
    path = _write(tmp_path_factory.getbasetemp(), **parts)
    try:
        read_scene(path, "scene.file").valves(None)
    except RequestError as error:
        (line,) = error.problems
        assert line.startswith("scene.file: ")
        assert "\n" not in line
