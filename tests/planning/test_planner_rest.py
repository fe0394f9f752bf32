"""The rest of a task is planned again from the robot's state, and held to what the earlier plan chose."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from given_doors import door_request
from given_mechanisms import drawer_request
from given_wheels import wheel_request
from shared_plans import copy_undrawn, write_once, write_undrawn
from tiny_robots import atlas
from typer.testing import CliRunner

from perception import Cloud, PerceptionError, make_cloud, write_npz
from service.cli.app import app
from service.demands.valve.demand import turn_back
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.replay import verify_result
from service.replay.rest import hash_plan, make_rest_request, read_recorded_scan
from service.request.file import parse_request, to_json
from service.request.resume import NominalPhase, NominalRequest, ResumeRequest
from service.request.schema import PlanRequest
from service.result.folder import read_result
from service.result.result import PlanResult, Verdict
from service.scan.scene_file import wheel_from_circle
from service.setup.world import read_surroundings
from service.start.standing import place_bodies
from service.wire.hashes import hash_certificate
from service.wire.requests import request_from_message, request_to_message

VALVE = wheel_request()


@pytest.fixture(scope="module")
def opened() -> Path:
    """A door with a lever, pushed open by 30 degrees."""
    return write_once(parse_request(door_request()))


@pytest.fixture(scope="module")
def turned() -> Path:
    """A valve turned by 60 degrees."""
    return write_once(parse_request(VALVE))


@pytest.fixture(scope="module")
def pulled() -> Path:
    """A drawer pulled out by 0.25 m."""
    return write_once(parse_request(drawer_request()))


def _write(result: PlanResult, folder: Path) -> Path:
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    return write_undrawn(result, folder / "out")


def _state(folder: Path, phase: str, share: float, **changes: float) -> dict[str, Any]:
    """The state of a recorded motion within a phase, with some joints moved."""
    data = read_result(folder)
    row = next(entry for entry in data["phases"] if entry["name"] == phase)
    at = round(row["first"] + share * (row["last"] - row["first"]))
    values = dict(zip(data["trajectory"]["joint_names"], data["trajectory"]["positions"][at], strict=True))
    base = [values.pop(f"base_{name}") for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    joints = {name: value + changes.get(name, 0.0) for name, value in values.items()}
    mechanism = {movable["joint"]: movable["angles"][at] for movable in data["movables"]}
    return {
        "joints": joints,
        "base": {"position": base[:3], "quaternion_wxyz": base[3:]},
        "mechanism": mechanism,
    }


def _rest(folder: Path, phase: str, state: dict[str, Any], tmp_path: Path) -> PlanRequest:
    file = tmp_path / "state.yaml"
    file.write_text(yaml.safe_dump(state))
    return make_rest_request(folder, phase, file)


def test_a_door_is_opened_on_from_the_middle_of_a_phase(opened: Path, tmp_path: Path) -> None:
    state = _state(opened, "open", 0.5)
    request = _rest(opened, "open", state, tmp_path)
    result = plan(request)
    again = _write(result, tmp_path)
    motion, certificate = result.motion, result.certificate
    assert motion is not None
    assert certificate is not None
    assert certificate.continues_sha256 == hash_plan(read_result(opened))
    start = dict(zip(motion.robot.joint_names, motion.curve.positions[0], strict=True))
    assert all(start[name] == pytest.approx(value, abs=1e-9) for name, value in state["joints"].items())
    assert all(start[name] == pytest.approx(value, abs=1e-9) for name, value in state["mechanism"].items())
    assert [phase.name for phase in motion.phases] == ["open", "let the handle go", "retract"]
    assert verify_result(again)["verdict"] == "CERTIFIED"


def test_a_hand_that_slipped_takes_hold_again(opened: Path, tmp_path: Path) -> None:
    state = _state(opened, "open", 0.7, l_arm_elx=0.01, l_arm_shx=-0.008)
    result = plan(_rest(opened, "open", state, tmp_path))
    again = _write(result, tmp_path)
    assert [phase.name for phase in result.phases][:2] == ["take hold", "open"]
    assert verify_result(again)["verdict"] == "CERTIFIED"


def test_a_hand_that_is_away_reaches_for_the_handle_first(opened: Path, tmp_path: Path) -> None:
    state = _state(opened, "reach", 0.3)
    result = plan(_rest(opened, "open", state, tmp_path))
    assert [phase.name for phase in result.phases][:4] == ["reach", "approach", "turn the handle", "open"]
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_the_rest_of_a_line_begins_where_the_hand_is(opened: Path, tmp_path: Path) -> None:
    result = plan(_rest(opened, "retract", _state(opened, "retract", 0.5), tmp_path))
    assert [phase.name for phase in result.phases] == ["retract"]
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_a_valve_that_moved_is_turned_with_the_earlier_motion_repaired(turned: Path, tmp_path: Path) -> None:
    request = _rest(turned, "reach", _state(turned, "reach", 0.0), tmp_path)
    assert request.task is not None
    assert request.task.valve is not None
    assert request.resume is not None
    nominal = request.resume.nominal
    assert nominal is not None
    valve = replace(request.task.valve, centre=(0.684, 0.127, 1.094), axis=(-1.0, 0.03, 0.03))
    result = plan(replace(request, task=replace(request.task, valve=valve)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.motion is not None
    assert result.motion.robot.joint_names == nominal.joint_names
    assert verify_result(_write(result, tmp_path))["verdict"] == "CERTIFIED"
    turn = next(phase for phase in result.motion.phases if phase.name == "turn")
    earlier = np.array(nominal.phases["turn"].positions).reshape(-1, len(nominal.joint_names))
    ends = result.motion.curve(np.array([turn.first, turn.last]))
    assert np.abs(ends - earlier[[0, -1]]).max() < 0.2


@pytest.mark.parametrize("change", ["other joints", "far away"])
def test_an_earlier_motion_that_does_not_fit_is_not_needed(change: str, turned: Path, tmp_path: Path) -> None:
    request = _rest(turned, "turn", _state(turned, "turn", 0.4), tmp_path)
    assert request.resume is not None
    nominal = request.resume.nominal
    assert nominal is not None
    if change == "other joints":
        nominal = replace(nominal, joint_names=(*nominal.joint_names[:-1], "of_another_robot"))
    else:
        phases = {name: NominalPhase(tuple(np.zeros(len(p.positions)))) for name, p in nominal.phases.items()}
        nominal = replace(nominal, phases=phases)
    result = plan(replace(request, resume=replace(request.resume, nominal=nominal)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation


@pytest.mark.parametrize(
    ("names", "positions", "words"),
    [
        (["a", "b"], [1, 2, 3], "'turn' has 3 positions"),
        (["a", "a"], [1, 2], "a name twice"),
        (["a"], [], "0 positions"),
    ],
)
def test_an_earlier_motion_has_every_joint_at_every_waypoint(
    names: list[str], positions: list[float], words: str
) -> None:
    resume = {"phase": "turn", "plan": f"sha256:{64 * '0'}"}
    nominal = {"joint_names": names, "phases": {"turn": {"positions": positions}}}
    with pytest.raises(RequestError, match=words):
        parse_request({**VALVE, "resume": {**resume, "nominal": nominal}})


@pytest.mark.parametrize(("phase", "first"), [("turn", "turn"), ("insert", "insert")])
def test_a_valve_is_turned_on(phase: str, first: str, turned: Path, tmp_path: Path) -> None:
    state = _state(turned, phase, 0.4)
    result = plan(_rest(turned, phase, state, tmp_path))
    again = _write(result, tmp_path)
    assert result.phases[0].name == first
    rest = 60.0 - np.rad2deg(state["mechanism"]["valve_turn"])
    assert result.figures["turned_deg"] == pytest.approx(rest, abs=3.0)
    assert verify_result(again)["verdict"] == "CERTIFIED"


def test_the_rest_can_be_planned_again_itself(turned: Path, tmp_path: Path) -> None:
    first = _write(plan(_rest(turned, "turn", _state(turned, "turn", 0.3), tmp_path)), tmp_path)
    request = _rest(first, "turn", _state(first, "turn", 0.5), tmp_path)
    assert request.resume is not None
    assert request.resume.plan == hash_plan(read_result(first)) != hash_plan(read_result(turned))
    assert request.resume.stroke == _rest(turned, "turn", _state(turned, "turn", 0.3), tmp_path).resume.stroke


def test_a_given_mechanism_is_moved_on(pulled: Path, tmp_path: Path) -> None:
    request = _rest(pulled, "move slide", _state(pulled, "move slide", 0.4), tmp_path)
    assert request.resume is not None
    assert request.resume.hold is not None
    assert request_from_message(request_to_message(request)) == request
    again = _write(plan(request), tmp_path)
    data = read_result(again)
    assert data["phases"][0]["name"] == "move slide"
    assert data["figures"]["slide_m"] == pytest.approx(0.25, abs=1e-3)
    assert verify_result(again)["verdict"] == "CERTIFIED"
    other = replace(request, resume=replace(request.resume, hold=None))
    with pytest.raises(RequestError, match=r"resume.hold: is missing"):
        plan(other)


def test_the_motion_to_a_goal_starts_anew(tmp_path: Path) -> None:
    goal = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}}
    reached = _write(plan(parse_request(goal)), tmp_path)
    request = _rest(reached, "reach", _state(reached, "reach", 0.5), tmp_path)
    result = plan(request)
    assert result.certificate is not None
    assert result.certificate.continues_sha256 == hash_plan(read_result(reached))
    assert verify_result(_write(result, tmp_path / "rest"))["verdict"] == "CERTIFIED"
    with pytest.raises(RequestError, match="unknown phase 'turn'; the plan has reach"):
        _rest(reached, "turn", _state(reached, "reach", 0.5), tmp_path)


def test_the_earlier_scan_is_not_read_again(tmp_path: Path) -> None:
    corners = [[x, y, z] for x in (1.9, 2.0) for y in (-0.1, 0.1) for z in (0.0, 1.0)]
    scene = tmp_path / "scene.json"
    scene.write_text(
        json.dumps({"format": "scopt-scene/1", "pieces": [{"name": "post", "kind": "obstacle", "vertices": corners}]})
    )
    request = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}, "scene": {"file": str(scene)}}
    reached = _write(plan(parse_request(request)), tmp_path)
    scene.unlink()
    rest = _rest(reached, "reach", _state(reached, "reach", 0.5), tmp_path)
    around = read_recorded_scan(reached, rest)
    assert around is not None
    assert [piece.name for piece in around.pieces if piece.kind == "obstacle"] == ["post"]
    result = plan(rest, around=around)
    assert result.verdict is Verdict.CERTIFIED
    assert "post" in [piece.name for piece in result.scene.pieces]


def test_a_new_scan_shows_the_spokes_turned() -> None:
    valve = replace(wheel_from_circle(np.zeros(3), np.array([-1.0, 0.0, 0.0]), 0.14, 0.01), spoke_angles=(0.5, 2.5))
    resume = ResumeRequest(phase="turn", plan="sha256:" + 64 * "0", mechanism={"valve_turn": 0.4})
    assert turn_back(valve, resume) is valve
    again = turn_back(valve, replace(resume, is_rescanned=True))
    assert again.spoke_angles == pytest.approx((0.1, 2.1))


def test_the_cited_hash_is_the_one_that_a_server_tells(tmp_path: Path) -> None:
    result = plan(parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}}))
    assert result.certificate is not None
    told = hash_certificate(result.certificate.to_json().encode())
    assert hash_plan(read_result(_write(result, tmp_path))) == f"sha256:{told}"


def test_a_message_says_the_same(opened: Path, tmp_path: Path) -> None:
    request = _rest(opened, "open", _state(opened, "open", 0.5), tmp_path)
    assert to_json(request_from_message(request_to_message(request))) == to_json(request)


def _set_joint(name: str, value: float) -> Callable[[dict[str, Any]], None]:
    return lambda state: state["joints"].update({name: value})


@pytest.mark.parametrize(
    ("phase", "change", "problem"),
    [
        ("opening", lambda state: None, "unknown phase 'opening'; the task has reach, approach, turn the handle, open"),
        ("open", _set_joint("l_arm_elx", 9.0), "l_arm_elx: 9 is outside the joint's limits"),
        ("open", lambda state: state["joints"].pop("l_arm_elx"), "joints: l_arm_elx missing"),
        ("open", lambda state: state.pop("base"), "base: is missing"),
        ("open", lambda state: state["mechanism"].pop("door_handle"), "door_handle missing"),
        ("open", lambda state: state["mechanism"].update(door_opening=1.0), "outside the travel of phase 'open'"),
        ("open", lambda state: state.update(plan="sha256:" + 64 * "0"), "is not the plan in"),
        ("open", lambda state: state.update(plan="0"), "a hash is needed"),
        ("let the handle go", _set_joint("l_arm_elx", 1.4), "from its place in 'let the handle go'"),
        ("open", lambda state: state["base"]["position"].__setitem__(0, 0.2), "start is"),
    ],
)
def test_a_state_that_does_not_fit_is_refused(
    phase: str, change: Callable[[dict[str, Any]], None], problem: str, opened: Path, tmp_path: Path
) -> None:
    state = _state(opened, "open", 0.5)
    change(state)
    with pytest.raises(RequestError, match=problem):
        plan(_rest(opened, phase, state, tmp_path))


def test_a_hand_in_the_leaf_is_refused(opened: Path, tmp_path: Path) -> None:
    state = _state(opened, "open", 0.5)
    state["mechanism"]["door_opening"] = 0.05
    with pytest.raises(RequestError, match=r"start is in collision: l_.* inside door/"):
        plan(_rest(opened, "open", state, tmp_path))


def test_choices_that_the_task_forbids_are_refused(opened: Path, tmp_path: Path) -> None:
    request = _rest(opened, "open", _state(opened, "open", 0.5), tmp_path)
    assert request.resume is not None
    assert request.resume.handle is not None
    far = replace(request.resume, handle=replace(request.resume.handle, grip_m=0.5))
    with pytest.raises(RequestError, match=r"resume.handle.grip_m: 0.500; expected 0.100 to 0.120"):
        plan(replace(request, resume=far))
    wide = replace(request.resume, handle=replace(request.resume.handle, until_rad=1.0))
    with pytest.raises(RequestError, match="expected the 30 deg of the task"):
        plan(replace(request, resume=wide))
    with pytest.raises(RequestError, match=r"resume.handle: is missing"):
        plan(replace(request, resume=replace(request.resume, handle=None)))


def _cite_another(data: dict[str, Any]) -> None:
    data["continues"] = data["certificate"]["continues_sha256"] = "sha256:" + 64 * "1"


def _forget_in_certificate(data: dict[str, Any]) -> None:
    data["certificate"]["continues_sha256"] = None


def _start_elsewhere(data: dict[str, Any]) -> None:
    data["request"]["resume"]["mechanism"]["valve_turn"] += 0.1


@pytest.mark.parametrize("lie", [_cite_another, _forget_in_certificate, _start_elsewhere])
def test_a_lie_about_the_earlier_plan_is_noticed(
    lie: Callable[[dict[str, Any]], None], turned: Path, tmp_path: Path
) -> None:
    folder = _write(plan(_rest(turned, "retract", _state(turned, "retract", 0.0), tmp_path)), tmp_path)
    forged = tmp_path / "forged"
    copy_undrawn(folder, forged)
    data = read_result(forged)
    lie(data)
    (forged / "result.json").write_text(json.dumps(data))
    with pytest.raises(ResultError):
        verify_result(forged)


def test_the_command_plans_the_rest(turned: Path, tmp_path: Path) -> None:
    file = tmp_path / "state.json"
    file.write_text(json.dumps(_state(turned, "turn", 0.5)))
    out = tmp_path / "rest"
    arguments = ["plan", "--from-phase", "turn", "--state", str(file), str(turned), "-o", str(out), "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.stderr
    assert [phase["name"] for phase in json.loads(done.stdout)["phases"]] == ["turn", "retract"]
    assert CliRunner().invoke(app, ["plan", "--from-phase", "turn", str(turned)]).exit_code == 2


@pytest.mark.parametrize("is_rescanned", [False, True])
def test_the_scan_of_an_earlier_plan_shows_the_robot_where_that_plan_began(is_rescanned: bool, tmp_path: Path) -> None:
    write_npz(tmp_path / "cloud.npz", make_cloud(np.ones((9, 3)), np.zeros(3)))
    robot = atlas()
    later = np.zeros(robot.n)
    earlier = later + 0.1
    still = (0.0,) * robot.n
    phases = {
        "turn": NominalPhase(tuple(later.tolist()), (1.0,), still),
        "reach": NominalPhase(tuple(earlier.tolist()), (0.0,), still),
    }
    nominal = NominalRequest(robot.joint_names, phases)
    resume = ResumeRequest("turn", "sha256:" + 64 * "0", is_rescanned=is_rescanned, nominal=nominal)
    request = parse_request({**wheel_request(), "scene": {"cloud": "cloud.npz"}}, tmp_path)
    hulls: list[np.ndarray] = []

    def see(cloud: Cloud, *, robot_hulls: list[np.ndarray], **others: Any) -> None:
        hulls.extend(robot_hulls)
        raise PerceptionError("seen enough")

    with pytest.raises(RequestError, match="seen enough"):
        read_surroundings(replace(request, resume=resume), robot, later, {}, see)
    bodies = place_bodies(robot, later if is_rescanned else earlier)
    np.testing.assert_allclose(hulls[0], bodies[0][1])
