"""Turning a valve: from the shipped scan, by a given circle, with either hand and in both modes."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from little_scan import little_scan
from shared_plans import copy_undrawn, plan_example, write_example
from stranger import Stranger

from perception import SeenPart, write_npz
from service.body.aims import Aims
from service.body.whole_body import WholeBody
from service.demands.hands import HANDS, PEG_RADIUS
from service.demands.valve.given import read_given_valve
from service.demands.valve.wheel import make_wheel
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.request.tasks.valve import ValveRequest
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.tasks.valve.plan import list_choices

EXAMPLES = Path(__file__).parents[2] / "examples"
TRUTH = json.loads((EXAMPLES / "data" / "valve_scan.json").read_text())["valve"]

SPOKES = [45.0, 135.0, 225.0, 315.0]


def request(valve: dict, cloud: Path | None = None, start: str = "reach_ready", **more):
    scene = {} if cloud is None else {"cloud": str(cloud)}
    return parse_request(
        {"robot": {"name": "atlas"}, "start": {"posture": start}, "scene": scene, "task": {"valve": valve}, **more}
    )


def given(centre=(0.68, 0.12, 1.1), radius=0.14, **more) -> dict:
    return {"centre": list(centre), "axis": [-1.0, 0.0, 0.0], "radius": radius, **more}


@pytest.fixture(scope="module")
def shipped():
    """The plan of the shipped request and scan, with its folder."""
    return plan_example("valve"), Stranger(write_example("valve"))


@pytest.fixture(scope="module")
def shipped_folder():
    """The folder of that plan."""
    return write_example("valve")


def pair_of(allowance: dict) -> tuple:
    """The two references of an allowance in a result."""
    return tuple(tuple(allowance[key][part] for part in ("owner", "link", "body")) for key in ("first", "second"))


def tool_path(stranger: Stranger, phase: str, frame: str) -> list:
    """Placements of a tool at the samples of a phase, and half-way between them."""
    part = next(p for p in stranger.data["phases"] if p["name"] == phase)
    rows = stranger.positions[part["first"] : part["last"] + 1]
    rows = np.concatenate([rows, 0.5 * (rows[1:] + rows[:-1])])
    order = np.argsort(np.concatenate([np.arange(len(rows) // 2 + 1), np.arange(len(rows) // 2) + 0.5]))
    return [stranger.placements(row)[frame] for row in rows[order]]


def test_the_shipped_scan_gives_a_certified_turn(shipped):
    result, _ = shipped
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert [phase.name for phase in result.motion.phases] == ["reach", "insert", "turn", "retract"]
    assert result.figures["turned_deg"] == pytest.approx(360.0, abs=0.5)


def test_the_peg_stays_at_its_place_in_the_wheel_within_1_mm(shipped):
    result, stranger = shipped
    seen = result.detections[0]
    centre, axis, radius = np.array(seen["centre"]), np.array(seen["axis"]), seen["rim_radius"]
    turns = []
    for pose in tool_path(stranger, "turn", "l_peg"):
        offset = pose.translation - centre
        height = offset @ axis
        turns.append((np.linalg.norm(offset - height * axis), height))
        assert -pose.rotation[:, 2] @ axis > np.cos(np.deg2rad(3.0))
    assert np.ptp(turns, axis=0).max() < 1e-3
    inner = radius - seen["tube_radius"]
    assert inner - 0.03 < np.mean(turns, axis=0)[0] < inner - 0.009
    assert np.linalg.norm(centre - TRUTH["centre"]) < 0.01
    assert abs(radius - TRUTH["rim_radius"]) < 5e-3


def test_on_the_true_wheel_the_peg_presses_one_spoke_within_2_mm_and_keeps_clear_of_the_rim(shipped):
    _, stranger = shipped
    axis = np.array(TRUTH["axis"]) / np.linalg.norm(TRUTH["axis"])
    right = np.cross([0.0, 0.0, 1.0], axis)
    up = np.cross(axis, right)
    part = next(p for p in stranger.data["phases"] if p["name"] == "turn")
    angles = stranger.data["movables"][0]["angles"]
    reach = TRUTH["spoke_radius"] + PEG_RADIUS
    gaps = []
    for row in range(part["first"], part["last"] + 1, 5):
        poses = stranger.placements(stranger.positions[row])
        first, last = poses["l_stub"].translation, poses["l_tool"].translation
        rod = first + np.linspace(0.0, 1.0, 120)[:, None] * (last - first) - TRUTH["centre"]
        x, y, z = rod @ right, rod @ up, rod @ axis
        rim = np.hypot(np.hypot(x, y) - TRUTH["rim_radius"], z).min()
        assert rim - TRUTH["tube_radius"] - PEG_RADIUS > 0.0
        nearest = []
        for angle in np.array(TRUTH["spoke_angles"]) + angles[row]:
            along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
            beyond = along - np.clip(along, 0.0, TRUTH["rim_radius"])
            nearest.append(np.sqrt(beyond**2 + across**2 + z**2).min() - reach)
        gaps.append(nearest)
    pressed, *others = np.array(gaps).T[np.argsort(np.min(gaps, axis=0))]
    assert np.abs(pressed).max() < 2e-3
    assert np.min(others) > 0.02


def test_the_wheel_turns_with_the_peg_and_the_hook_touches_only_a_spoke_and_the_rim(shipped):
    _, stranger = shipped
    movable = stranger.data["movables"][0]
    assert movable["angles"][0] == pytest.approx(0.0, abs=1e-9)
    assert movable["angles"][-1] == pytest.approx(2.0 * np.pi, abs=2e-3)
    touching = {pair_of(allowance) for phase in stranger.data["phases"] for allowance in phase["allowances"]}
    rim = {body["name"] for body in movable["bodies"] if "rim" in body["name"]}
    hook, feet = ("robot", "l_hook", None), [("robot", foot, None) for foot in ("l_foot", "r_foot")]
    standing = {(foot, ("scene", None, "floor")) for foot in feet}
    assert len(rim) == 20
    of_robot = {pair for pair in touching if pair[0][0] == "robot"}
    spokes = {pair[1] for pair in of_robot if pair[0] == hook and "/spoke/" in pair[1][2]}
    assert len(spokes) == 1
    assert of_robot == {(hook, ("mechanism", "valve", name)) for name in rim} | {(hook, *spokes)} | standing
    assert {second for _, second in touching - of_robot} == {("scene", None, "stem")}
    reach = stranger.data["phases"][0]
    assert {pair_of(allowance) for allowance in reach["allowances"]} & of_robot == standing


def test_dense_samples_of_the_turn_keep_clear_of_the_scene(shipped):
    result, stranger = shipped
    planted = {"l_foot", "r_foot"}
    clearance, pair = stranger.closest(
        stranger.rows(1, stride=12), lambda body, link, piece: link in planted and piece == "floor"
    )
    assert clearance >= result.certificate.min_clearance_m - 1e-6, pair


def test_the_whole_body_helps(shipped):
    _, stranger = shipped
    moved = dict(zip(stranger.names, np.ptp(stranger.positions, axis=0), strict=True))
    assert moved["base_x"] + moved["base_y"] + moved["base_z"] > 0.01
    assert max(moved[name] for name in moved if name.startswith("back_")) > 0.05
    assert max(moved[name] for name in moved if "_leg_" in name) > 0.05


def test_the_pressed_spoke_is_counted_in_the_scan(shipped):
    result, _ = shipped
    (check,) = [check for check in result.certificate.checks if check.name.startswith("coverage.pressed.")]
    assert check.name.startswith("coverage.pressed.spoke/")
    assert check.value >= check.limit == 4


def test_spokes_that_the_scan_shows_are_tried_first():
    """With four spokes of which only one was seen, every hand tries this one before the others."""
    turn = ValveRequest(**given(spokes_deg=SPOKES))
    valve = read_given_valve(turn)
    setup = prepare(request({"turn_deg": 90, **given()}))
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims())
    for shown in range(4):
        parts = tuple(
            SeenPart(f"spoke/{k}", ((0.1, 0.0),), (20,) if k == shown else (0,), (0,), 0.02) for k in range(4)
        )
        choices = list(list_choices(body, make_wheel(valve, turn, parts), list(HANDS.values()), turn))
        firsts = [choice.entry for choice in choices[::3]]
        assert firsts == [pytest.approx(np.deg2rad(SPOKES[shown]))] * len(firsts)


def edit_result(folder: Path, target: Path, edit: Callable[[dict], None]) -> Path:
    """Return a copy of a result's folder with its data changed."""
    copy_undrawn(folder, target)
    data = json.loads((target / "result.json").read_text())
    edit(data)
    (target / "result.json").write_text(json.dumps(data))
    return target


def test_a_scan_that_shows_nothing_at_the_peg_rules_out_the_certificate(shipped_folder, tmp_path):
    """The record says that rays passed; verification counts again from the detection's parts."""

    def empty(data: dict) -> None:
        for part in data["detections"][0]["parts"]:
            part["passes"], part["hits"] = part["hits"], [0] * len(part["hits"])

    again = verify_result(edit_result(shipped_folder, tmp_path / "out", empty))
    assert again["verdict"] == "FEASIBLE_AT_SAMPLES"
    assert any("pressed of phase 'turn'" in line for line in again["explanation"])


def test_counts_that_are_not_those_of_the_scan_are_refused(shipped_folder, tmp_path):
    def claim(data: dict) -> None:
        for phase in data["phases"]:
            for part in phase["pressed"]:
                part["n_points"] += 100

    with pytest.raises(ResultError, match="pressed of phase 'turn' are not the parts"):
        verify_result(edit_result(shipped_folder, tmp_path / "out", claim))


def test_a_result_without_counts_is_not_certified_anew(shipped_folder, tmp_path):
    """As an earlier release wrote it."""

    def forget(data: dict) -> None:
        del data["detections"][0]["parts"]
        for phase in data["phases"]:
            del phase["pressed"]

    again = verify_result(edit_result(shipped_folder, tmp_path / "out", forget))
    assert again["verdict"] == "FEASIBLE_AT_SAMPLES"
    assert any(check["name"].startswith("coverage.pressed.spoke/") for check in again["checks"])


@pytest.mark.parametrize(
    ("valve", "phases"),
    [
        (given(turn_deg=-90, hand="right", centre=(0.68, -0.12, 1.1), spokes_deg=SPOKES), 4),
        (given(turn_deg=400, spokes_deg=SPOKES), 8),
    ],
)
def test_given_valves_are_turned_as_asked(valve, phases):
    result = plan(request(valve))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert len(result.motion.phases) == phases
    assert result.figures["turned_deg"] == pytest.approx(valve["turn_deg"], abs=1.0)
    assert any("given by the request, shown by no scan: spoke/" in note for note in result.certificate.notes)


def test_a_spoke_that_nobody_knows_of_is_no_ground_for_a_certificate():
    """A wheel that is given by its rim alone: the plan is made, and names the field that is missing."""
    result = plan(request(given(turn_deg=60)))
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    assert len(result.explanation) == 1
    assert "the spoke that the hand presses is assumed" in result.explanation[0]
    assert "spokes_deg" in result.explanation[0]


def test_a_valve_out_of_reach_comes_with_the_shift_that_would_help():
    bar = {"direction": [0.0, 0.0, 1.0], "length_m": 0.22}  # which a hand can turn in fewer ways than a wheel
    far = {"centre": [1.45, 0.12, 1.1], "axis": [-1.0, 0.0, 0.0], "lever": bar, "hand": "left", "turn_deg": 45}
    result = plan(request(far, options={"starts": 1}))
    assert result.verdict is Verdict.NOT_FOUND
    assert any("moving the pelvis" in line and "forward" in line for line in result.explanation), result.explanation
    assert result.motion is not None


def test_a_valve_beyond_any_reach_is_infeasible():
    result = plan(request(given(centre=(5.0, 0.12, 1.1))))
    assert result.verdict is Verdict.INFEASIBLE
    assert "cannot reach" in result.explanation[0]


def test_a_scan_without_a_valve_says_so(tmp_path):
    write_npz(tmp_path / "scan.npz", little_scan())
    result = plan(request({"turn_deg": 90}, tmp_path / "scan.npz"))
    assert result.verdict is Verdict.NOT_FOUND
    assert "no valve was found" in result.explanation[0]


def test_the_valve_of_another_scan_is_turned_without_a_certificate(shared_data):
    """Its spokes are not resolved between a thick rim and a large hub: the peg presses one that is assumed."""
    result = plan(request({"turn_deg": 90, "torque_nm": 5.0}, shared_data / "scenes" / "valve_a" / "scan0.pcd"))
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES, result.explanation
    assert ["the spoke that the hand presses is assumed" in line for line in result.explanation] == [True]
    assert result.figures["turned_deg"] == pytest.approx(90.0, abs=0.5)


def test_a_start_inside_the_wheel_is_told_with_link_and_depth():
    with pytest.raises(RequestError, match=r"start is in collision: l_hook is 0\.00\d m inside valve/rim/\d+"):
        plan(request(given(centre=(0.59, 0.1, 1.17), radius=0.2, turn_deg=-90)))


def test_a_wheel_too_hard_to_turn_says_that_the_ground_does_not_hold():
    result = plan(request(given(torque_nm=200.0)))
    assert result.verdict is Verdict.NOT_FOUND
    assert any("the ground does not hold the robot under the loads" in line for line in result.explanation)
