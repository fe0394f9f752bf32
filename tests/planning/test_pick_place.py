"""Taking an object and putting it elsewhere: plans, what forbids them in a sentence, replay and physics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_plans import write_undrawn

from benchmarks.attack.gantry_files import pick_place_request, write_gantry
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult
from service.simulation.run import execute_folder
from service.simulation.verdict import judge, measure_objects

ON_ITS_SIDE = [0.7071067811865476, 0.7071067811865476, 0.0, 0.0]


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gantry(tmp_path_factory.mktemp("gantry"))


@pytest.fixture(scope="module")
def folder(gantry: Path) -> Path:
    """A result whose block is moved."""
    result = ask(gantry)
    assert result.verdict.value == "CERTIFIED", result.explanation
    return write_undrawn(result, gantry.parent / "out")


def ask(gantry: Path, **changes: Any) -> PlanResult:
    return plan(parse_request(pick_place_request(gantry, **changes)))


def test_a_result_is_certified_anew(folder: Path) -> None:
    again = verify_result(folder)
    assert again["verdict"] == "CERTIFIED", again["explanation"]
    data = json.loads((folder / "result.json").read_text())
    names = {check["name"] for check in data["certificate"]["checks"]}
    assert {"rests.grasp: close.block", "grip.lift.block", "carried.carry.block", "swung.lower.block"} <= names
    assert data["figures"]["moved_block_m"] == pytest.approx(np.hypot(0.2, 0.4), abs=1e-3)
    assert [phase["carriers"][0]["link"] for phase in data["phases"]] == [None, None, None, *["hand"] * 3, None, None]


def test_the_block_is_at_its_place_in_physics(folder: Path) -> None:
    pytest.importorskip("mujoco")
    (run,) = execute_folder(folder)
    judged = judge(run.reference, run.record, run.model.physics)
    assert (judged.verdict, judged.reasons) == ("DONE", ())
    (end,) = measure_objects(run.reference, run.record)
    assert end.off_m < 5e-3
    highest = run.record.objects["block"][:, 2].max()
    assert highest > 0.44 + 0.05


def change(folder: Path, target: Path, edit: Any) -> Path:
    data = json.loads((folder / "result.json").read_text())
    edit(data)
    target.mkdir()
    for path in folder.rglob("*"):
        if path.is_file() and path.name not in ("result.json", "manifest.json"):
            copy = target / path.relative_to(folder)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    (target / "result.json").write_text(json.dumps(data))
    return target


def _halve(data: dict[str, Any]) -> None:
    data["objects"][0]["mass_kg"] *= 0.5


def _swap(data: dict[str, Any]) -> None:
    data["phases"][4]["carriers"][0] = {"object": "block", "link": None, "grips": []}


def _tighten(data: dict[str, Any]) -> None:
    data["phases"][4]["carriers"][0]["grips"][0]["force_n"] = 400.0


def _shift(data: dict[str, Any]) -> None:
    data["objects"][0]["start"]["position"][0] += 0.02


def _place(data: dict[str, Any]) -> None:
    data["request"]["task"]["pick_place"]["to"]["position"][0] += 0.02


@pytest.mark.parametrize("edit", [_halve, _swap, _tighten, _shift, _place])
def test_a_changed_record_is_not_believed(folder: Path, tmp_path: Path, edit: Any) -> None:
    try:
        again = verify_result(change(folder, tmp_path / "out", edit))
    except ResultError:
        return
    assert again["verdict"] != "CERTIFIED"


def test_a_follower_finger_closes_with_its_leader(tmp_path: Path) -> None:
    urdf = write_gantry(tmp_path, follows=True)
    result = plan(parse_request(pick_place_request(urdf, follows=True)))
    assert result.verdict.value == "CERTIFIED", result.explanation


def test_a_cylinder_is_led_over_a_wall(gantry: Path) -> None:
    wall = {"type": "box", "name": "wall", "size": [0.5, 0.02, 0.15], "position": [0.0, 0.0, 0.475]}
    can = {"type": "cylinder", "radius": 0.03, "height": 0.08, "size": None}
    request = pick_place_request(gantry, obstacles=[wall], block=can)
    del request["scene"]["objects"][0]["size"]
    result = plan(parse_request(request))
    assert result.verdict.value == "CERTIFIED", result.explanation


def test_a_given_grasp_is_taken(gantry: Path) -> None:
    down = {"position": [0.0, 0.0, 0.03], "quaternion_wxyz": [0.0, 1.0, 0.0, 0.0]}
    result = ask(gantry, block={"grasps": [down]})
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert result.notes[-1] == "block is taken by the right hand at grasp 0"


def test_fingers_without_friction_hold_nothing(gantry: Path) -> None:
    request = {**pick_place_request(gantry), "options": {"hand_friction": [0.0, 0.6]}}
    result = plan(parse_request(request))
    assert result.verdict.value == "INFEASIBLE"
    assert any("would have to press without end at a friction of 0" in line for line in result.explanation)


IMPOSSIBLE = {
    "out of reach": (
        {"to": {"position": [9.0, 0.2, 0.04]}},
        "block is out of reach at [9.0, 0.2, 0.12] ('carry'): tool cannot reach",
    ),
    "too heavy to grip": (
        {"block": {"mass_kg": 5.0}},
        "each finger would have to press with 82 N at a friction of 0.3",
    ),
    "gripped too hard": ({"grip_n": 150.0}, "the fingers of the right hand press with at most 100 N"),
    "too wide": ({"block": {"size": [0.2, 0.2, 0.08]}}, "block is 200 mm wide; the right gripper opens to 88 mm"),
    "under another": (
        {"obstacles": [{"type": "box", "name": "lid", "size": [0.1, 0.1, 0.02], "position": [0.1, -0.2, 0.49]}]},
        "block is under lid; that has to be taken away first",
    ),
    "grasp in the table": (
        {"block": {"grasps": [{"position": [0.0, 0.0, -0.035], "quaternion_wxyz": [0.0, 1.0, 0.0, 0.0]}]}},
        "grasp 0 of block would have finger_1 15 mm inside table where it is",
    ),
    "in the air": (
        {"block": {"position": [0.1, -0.2, 0.5]}},
        "block does not rest where it is: nothing is within 3 mm",
    ),
    "over the edge": (
        {"to": {"position": [-0.41, 0.2, 0.44]}},
        "block does not rest where it is put, at [-0.41, 0.2, 0.44]: table would let it tip or slide",
    ),
    "no place": (
        {"obstacles": [{"type": "box", "name": "box", "size": [0.1, 0.1, 0.1], "position": [-0.1, 0.2, 0.45]}]},
        "there is no place for block where it is put, at [-0.1, 0.2, 0.44]: it would be",
    ),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_what_cannot_be_done_is_named(gantry: Path, case: str) -> None:
    changes, sentence = IMPOSSIBLE[case]
    result = ask(gantry, **changes)
    assert result.verdict.value == "INFEASIBLE"
    assert sentence in result.explanation[0]


def test_joints_that_cannot_hold_the_object_are_named(tmp_path: Path) -> None:
    urdf = write_gantry(tmp_path)
    text = urdf.read_text()
    urdf.write_text(text.replace('velocity="1" effort="500.0"', 'velocity="1" effort="60.0"'))
    result = ask(urdf, block={"mass_kg": 4.0}, grip_n=90.0)
    assert result.verdict.value == "NOT_FOUND"
    assert any("block of 4 kg is too heavy there: z needs" in line for line in result.explanation)


def test_names_that_are_not_there_are_refused(gantry: Path) -> None:
    with pytest.raises(RequestError, match=r"task\.pick_place\.object: unknown object 'brick'; the scene has block"):
        ask(gantry, object="brick")
    with pytest.raises(RequestError, match=r"task\.pick_place\.hand: left needs a hand with two fingers that slide"):
        ask(gantry, hand="left")
    request = pick_place_request(gantry, block={"name": "hand"}, object="hand")
    with pytest.raises(RequestError, match=r"scene.objects\[0\].name: 'hand' is a link of gantry"):
        plan(parse_request(request))


def test_an_object_that_no_task_moves_is_an_obstacle(gantry: Path) -> None:
    request = pick_place_request(gantry)
    del request["task"]
    request["goal"] = {"joints": {"x": 0.1, "y": -0.2, "z": -0.5, "yaw": 0.0, "grip_1": 0.01, "grip_2": 0.01}}
    result = plan(parse_request(request))
    assert result.verdict.value != "CERTIFIED"
    assert "block" in " ".join(result.explanation)
