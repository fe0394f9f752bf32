"""Verified anew, a result is held to its request: every edit that a liar would make is noticed."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from given_wheels import wheel_request
from shared_plans import copy_undrawn, write_example, write_once, write_undrawn

from service.errors import DamagedResultError, RequestError, ResultError
from service.planner import plan
from service.replay.replay import read_motion, verify_result
from service.request.file import parse_request
from service.result.folder import read_result
from service.result.result import Verdict
from service.verify.hashes import promises_hash

EXAMPLES = Path(__file__).parents[2] / "examples"
CARRY = EXAMPLES / "requests" / "carry.yaml"
VALVE = wheel_request()


@pytest.fixture(scope="module")
def carried() -> Path:
    """A beam carried with both hands: feet, kept poses, something attached, obstacles, a goal."""
    return write_example("carry")


@pytest.fixture(scope="module")
def turned() -> Path:
    """A valve given by its circle, turned by 60 degrees."""
    return write_once(parse_request(VALVE))


def _planned(request: Any, folder: Path) -> Path:
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    return write_undrawn(result, folder / "out")


def test_a_result_is_certified_for_the_request_in_its_folder(carried: Path, turned: Path) -> None:
    recorded = read_result(carried)
    again = verify_result(carried)
    assert (again["verdict"], again["held_to"]) == ("CERTIFIED", "for the request in this folder")
    assert again["min_clearance_m"] == pytest.approx(recorded["min_clearance_m"], abs=1e-6)
    assert again["notes"] == recorded["certificate"]["notes"]
    assert verify_result(turned)["verdict"] == "CERTIFIED"


def test_a_result_is_certified_for_the_request_that_the_user_gives(carried: Path, tmp_path: Path) -> None:
    assert verify_result(carried, CARRY)["held_to"] == "for carry.yaml"
    other = tmp_path / "mine.yaml"
    other.write_text(CARRY.read_text().replace("position: [0.75, 0.0, 1.35]", "position: [0.75, 0.0, 1.25]"))
    again = verify_result(carried, other)
    assert again["verdict"] == "NOT_FOUND"
    assert "targets of phase 'reach' are not those of the request" in again["explanation"]
    other.write_text(CARRY.read_text().replace("position: [0.70, 0.55, 0.8]", "position: [0.70, 0.60, 0.8]"))
    with pytest.raises(ResultError, match="left_post of the scene is not where the request has it"):
        verify_result(carried, other)


def test_a_cloud_that_the_request_does_not_have_is_refused(carried: Path, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="the request's scene has no scan"):
        verify_result(carried, CARRY, [tmp_path / "scan.pcd"])


def _sample(data: dict[str, Any]) -> None:
    data["trajectory"]["positions"][3][20] += 1e-4


def _knot(data: dict[str, Any]) -> None:
    data["curve"]["positions"][1][20] += 5e-6


def _no_targets(data: dict[str, Any]) -> None:
    for phase in data["phases"]:
        phase["targets"] = []


def _loose_feet(data: dict[str, Any]) -> None:
    for phase in data["phases"]:
        for contact in phase["contacts"]:
            contact["tolerance_m"] = 0.1


def _allow(data: dict[str, Any]) -> None:
    arm = {"owner": "robot", "link": "l_larm", "body": None}
    rail = {"owner": "scene", "link": None, "body": "rail"}
    data["phases"][0]["allowances"].append({"first": arm, "second": rail, "depth": 0.5})


def _kept(data: dict[str, Any]) -> None:
    (kept,) = [target for target in data["phases"][0]["targets"] if target["kind"] == "relative_pose"]
    kept["position"][0] += 1e-4


def _goal(data: dict[str, Any]) -> None:
    data["request"]["goal"]["poses"][0]["position"][2] -= 0.3


def _wall(data: dict[str, Any]) -> None:
    wall = {"name": "wall", "type": "box", "size": [0.1, 3.0, 3.0], "position": [0.9, 0.0, 1.5]}
    data["request"]["scene"]["obstacles"].append(wall)
    data["request"] = _canonical(data["request"])


def _no_rail(data: dict[str, Any]) -> None:
    data["pieces"] = [piece for piece in data["pieces"] if piece["name"] != "rail"]
    data["request"]["scene"]["obstacles"] = data["request"]["scene"]["obstacles"][1:]


def _emptied(data: dict[str, Any]) -> None:
    data.update(certificate=None, pieces=[])
    for phase in data["phases"]:
        phase.update(targets=[], contacts=[])


def _target(data: dict[str, Any]) -> None:
    data["phases"][-1]["targets"][0]["position"][0] += 0.004


def _margin(data: dict[str, Any]) -> None:
    data["phases"][0]["support"]["margin_m"] = 0.0


def _settle(data: dict[str, Any]) -> None:
    data["phases"][0]["name"] = "settle"
    data["phases"][0]["support"]["margin_m"] = 0.0


def _feet(data: dict[str, Any]) -> None:
    data["phases"][0]["contacts"].pop()


def _failed_check(data: dict[str, Any]) -> None:
    for source in (data, data["certificate"]):
        source["checks"][0]["ok"] = False


def _no_exempt(data: dict[str, Any]) -> None:
    for source in (data, data["certificate"]):
        source["exempt"] = []


def _nothing_left_out(data: dict[str, Any]) -> None:
    for source in (data, data["certificate"]):
        source["coverage"]["left_out"] = []


def _canonical(request: dict[str, Any]) -> dict[str, Any]:
    from service.request.file import to_json

    return to_json(parse_request(request))


EDITS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "a sample": (_sample, "trajectory.positions are not on the curve"),
    "the times": (lambda data: data["trajectory"]["times"].append(99.0), "trajectory.times are not"),
    "the curve": (_knot, "trajectory.positions are not on the curve"),
    "a body": (lambda data: data["bodies"].pop(), "bodies are not those"),
    "an ignored pair": (lambda data: data["ignored_pairs"].append(["l_hand", "r_hand"]), "ignored_pairs are not those"),
    "the robot's hash": (lambda data: data["robot"].update(sha256="sha256:0"), "robot.sha256"),
    "a claim": (lambda data: data.update(min_clearance_m=0.5), "min_clearance_m of result.json is 0.5"),
    "a number": (lambda data: data["curve"]["positions"][0].__setitem__(0, None), "not finite"),
    "a phase": (lambda data: data["phases"][0].update(first=1), "must begin at"),
    "the targets": (_no_targets, "targets of phase 'reach' are not those of the request"),
    "a target": (_target, "targets of phase 'reach' are not those of the request"),
    "a kept pose": (_kept, "targets of phase 'reach' are not those of the request"),
    "a tolerance": (_loose_feet, "contacts of phase 'reach' are not those of the request"),
    "the feet": (_feet, "contacts of phase 'reach' are not those of the request"),
    "a margin": (_margin, "support of phase 'reach' are not those of the request"),
    "a settling phase": (_settle, "support of phase 'settle' are not those of the request"),
    "an allowance": (_allow, "allowances of phase 'reach' are not those of the request"),
    "the request's goal": (_goal, "targets of phase 'reach' are not those of the request"),
    "an obstacle more in the request": (_wall, "the scene lacks wall"),
    "a piece": (lambda data: data["pieces"].pop(0), "the scene lacks rail"),
    "the certificate": (lambda data: data.update(certificate=None), "there is no certificate"),
    "everything": (_emptied, "there is no certificate"),
    "the status": (lambda data: data["certificate"].update(status="VIOLATED"), "certificate says 'VIOLATED'"),
    "the start": (lambda data: data["request"]["start"].update(posture="stand"), "starts .* away from the request's"),
    "the feet of the request": (lambda data: data["request"]["options"].update(feet=["l_foot"]), "contacts of phase"),
    "what is not checked": (lambda data: data["waived"].append("balance"), "the record waives other checks"),
    "a drawn ZMP": (lambda data: data.update(zmp=[data["zmp"][0]] * len(data["zmp"])), "zmp is not the motion's"),
    "a drawn centre of mass": (lambda data: data["com"][5].__setitem__(0, 0.0), "com is not"),
    "a check's value": (lambda data: data["certificate"]["checks"][1].update(value=0.9), "checks of result.json and"),
    "a failed check": (_failed_check, "checks are not those of the motion"),
    "the pairs that touch": (_no_exempt, "exempt pairs are not those of the motion"),
    "what was left out": (_nothing_left_out, "coverage.left_out is not what the verifier leaves out"),
    "the pace": (lambda data: data["request"]["options"].update(velocity_scale=0.01), "% of the speed limits"),
    "a promise of time": (lambda data: data["curve"].update(law=None), "no time law"),
}  # fmt: skip


def _circle(data: dict[str, Any]) -> None:
    for phase in data["phases"]:
        for target in phase["targets"]:
            if target["kind"] == "circle":
                target["centre"][1] += 0.004


def _valve(data: dict[str, Any]) -> None:
    data["request"]["task"]["valve"]["centre"][1] += 0.004


def _wheel(data: dict[str, Any]) -> None:
    data["movables"][0]["axis"] = [-1.0, 0.0, 1e-3]


def _deeper(data: dict[str, Any]) -> None:
    for phase in data["phases"]:
        for allowance in phase["allowances"]:
            allowance["depth"] += 0.005


def _latch(data: dict[str, Any]) -> None:
    data["releases"] = [{"joint": "valve_turn", "latch": "neck_ry", "latch_at": 0.1, "free_beyond": 0.0}]


def _by_whom(data: dict[str, Any]) -> None:
    for phase in data["phases"]:
        if phase["name"] == "reach":
            phase["allowances"] = data["phases"][-1]["allowances"]


TURN_EDITS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "the circle": (_circle, "targets of phase 'turn' are not those of the request"),
    "the valve": (_valve, "the task's mechanism does not move as the request demands"),
    "the wheel's axis": (_wheel, "the task's mechanism does not move as the request demands"),
    "the sense": (lambda data: data["request"]["task"]["valve"].update(turn_deg=-60.0), "targets of phase 'turn'"),
    "the hand": (lambda data: data["request"]["task"]["valve"].update(hand="right"), "no hand that the task permits"),
    "how deep the hook may be": (_deeper, "allowances of phase 'reach' are not those of the request"),
    "a latch of the wheel": (_latch, "the releases of the mechanism's latches are not those of the request"),
    "when the hook may touch": (_by_whom, "allowances of phase 'reach' are not those of the request"),
    "the angle of its figures": (lambda data: data["figures"].update(turned_deg=360.0), "figures.turned_deg is 360"),
    "the turn's name": (lambda data: data["phases"][2].update(name="hold"), "valve_turn moves in phase 'hold'"),
}


def forge(source: Path, target: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of a result without its drawings, with an edit, and the public hashes made to fit it."""
    copy_undrawn(source, target)
    data = read_result(target)
    edit(data)
    canonical = json.dumps(data["request"], sort_keys=True, separators=(",", ":"))
    data["request_hash"] = "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
    if data["certificate"] is not None:
        try:
            motion = read_motion(data, target)
        except ResultError:
            pass
        else:
            data["certificate"]["promises_sha256"] = promises_hash(motion.phases, motion.releases)
    (target / "result.json").write_text(json.dumps(data))
    return target


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_is_noticed_though_the_motion_holds(carried: Path, tmp_path: Path, name: str) -> None:
    edit, problem = EDITS[name]
    assert _is_noticed(forge(carried, tmp_path / "forged", edit), problem)


@pytest.mark.parametrize("name", TURN_EDITS)
def test_an_edit_of_a_turn_is_noticed_though_the_motion_holds(turned: Path, tmp_path: Path, name: str) -> None:
    edit, problem = TURN_EDITS[name]
    assert _is_noticed(forge(turned, tmp_path / "forged", edit), problem)


def _is_noticed(folder: Path, problem: str) -> bool:
    """Whether the folder is not certified, and a line says what is wrong with it."""
    try:
        again = verify_result(folder)
    except ResultError as error:
        lines = str(error).splitlines()
    else:
        assert again["verdict"] != "CERTIFIED"
        lines = again["explanation"]
    assert any(re.search(problem, line) for line in lines), lines
    return True


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "",
        lambda text: text.replace("base_x", "base_q", 1),
        lambda text: text.replace("\n", "\n# as planned\n", 1),
        lambda text: text.splitlines()[0],
        lambda text: "\n".join([text.splitlines()[0], *text.splitlines()[1:3], *text.splitlines()[2:]]),
    ],
    ids=["empty", "other columns", "a comment", "no rows", "a row twice"],
)
def test_a_changed_table_of_samples_is_noticed(carried: Path, tmp_path: Path, change: Callable[[str], str]) -> None:
    folder = forge(carried, tmp_path / "forged", lambda data: None)
    table = folder / "trajectory.csv"
    table.write_text(change(table.read_text()))
    assert _is_noticed(folder, r"trajectory\.csv does not hold samples of the curve")


def test_an_obstacle_left_out_of_the_request_is_noticed_by_who_knows_the_request(carried: Path, tmp_path: Path) -> None:
    folder = forge(carried, tmp_path / "forged", _no_rail)
    with pytest.raises(ResultError, match="the scene lacks rail"):
        verify_result(folder, CARRY)


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("request_format", 3, "request_format: expected 2, got 3"),
        ("request_defaults", {}, r"request_defaults: \w+\.\w+ is missing"),
        (
            "request_defaults",
            {"Options.hand_friction": [1.0, 1.0]},
            r"expected .*, got \[1.0, 1.0\]",
        ),
        ("request_defaults", None, r"request_defaults: \w+\.\w+ is missing"),
    ],
)
def test_defaults_that_no_version_had_are_damage(
    carried: Path, tmp_path: Path, key: str, value: object, problem: str
) -> None:
    copy = shutil.copytree(carried, tmp_path / "copy")
    data = json.loads((copy / "result.json").read_text())
    data[key] = {**data[key], **value} if value and isinstance(value, dict) else value
    (copy / "result.json").write_text(json.dumps(data))
    with pytest.raises(DamagedResultError, match=problem):
        verify_result(copy)
