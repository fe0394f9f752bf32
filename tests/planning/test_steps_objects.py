"""Steps that take objects: a peg out of a hole into another, what is refused, replay and physics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_plans import write_undrawn
from stranger import load_checker

from benchmarks.attack.gantry_files import pick_place_request, write_gantry
from benchmarks.attack.step_requests import DEPTH, FROM, INTO, TOP, peg_request
from service.demands.regions import SMALLEST_TURN
from service.demands.steps.compile import LEVEL_DEG
from service.demands.steps.extent import NamedStep
from service.errors import RequestError
from service.motion.hand_sag import list_short_hands
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.simulation.run import execute_folder
from service.simulation.verdict import judge
from service.verify import find_times, place_frames, split_motion


@pytest.fixture(scope="module", name="urdf")
def _urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gantry(tmp_path_factory.mktemp("gantry"))


@pytest.fixture(scope="module", name="folder")
def _folder(urdf: Path) -> Path:
    result = plan(parse_request(peg_request(urdf)))
    assert result.verdict.value == "CERTIFIED", result.explanation
    return write_undrawn(result, urdf.parent / "out")


def test_a_peg_goes_from_hole_to_hole_and_is_certified_anew(folder: Path) -> None:
    assert verify_result(folder)["verdict"] == "CERTIFIED"
    checks = {
        check["name"]: check for check in json.loads((folder / "result.json").read_text())["certificate"]["checks"]
    }
    assert checks["way.in.peg"]["limit"] == 1e-3
    assert checks["keep.in.peg.world"]["limit"] == pytest.approx(0.002)  # chamfer and half of the clearance
    assert checks["keep.in.peg.world.rotation"]["limit"] == pytest.approx(0.002 / (0.6 * 0.042))
    assert checks["jam.in.peg"]["basis"] == "proof"
    assert 0.0 < checks["jam.in.peg"]["value"] < checks["jam.in.peg"]["limit"] == 12.0
    assert "jam.out.peg" not in checks  # what is drawn out is not pressed in
    assert {"rests.take: close.peg", "grip.across.peg", "rests.let go: open.peg"} <= checks.keys()
    level = max(np.deg2rad(LEVEL_DEG), SMALLEST_TURN)  # it is put down later
    assert checks["target.across.peg.rotation"]["limit"] == pytest.approx(level)


def test_grips_hold_what_the_object_presses(folder: Path, urdf: Path) -> None:
    data = json.loads((folder / "result.json").read_text())
    checks = {check["name"]: check for check in data["certificate"]["checks"]}
    # Two pads of 40 N hold 24 N by a friction of 0.3: 3.9 N of weight, and 12 N of a hole that holds the peg back.
    least = (0.4 * 9.81 + 12.0) / 24.0
    share = checks["carried.out.peg"]["value"]
    assert least < share < 1.3 * least  # the force acts up to 4 mm beside the peg's axis
    assert share > checks["carried.across.peg"]["value"] + 12.0 / 24.0 - 0.02
    result = plan(parse_request(peg_request(urdf, out={"force_n": 30.0})))
    assert result.verdict.value not in ("CERTIFIED", "FEASIBLE_AT_SAMPLES")
    assert any("do not hold peg of 0.4 kg, which presses with up to 30 N" in line for line in result.explanation)


def test_a_stranger_finds_that_the_peg_does_not_jam_and_what_would_make_it_jam(folder: Path) -> None:
    checker, data = load_checker(), json.loads((folder / "result.json").read_text())
    parts = checker.split(checker.Replay(checker.read_model(folder, data), data), data)
    replay, phase = next((own, phase) for own, _, phases in parts for phase in phases if phase["name"] == "in")
    (hole,) = [target for target in phase["targets"] if target["kind"] == "hole"]
    assert checker.target(replay, phase, hole)[0]
    beside = {**hole, "position": [hole["position"][0] + 1e-3, *hole["position"][1:]]}  # 10 N across, 6 of friction
    assert checker.target(replay, phase, beside)[0]
    for change in ({"force_n": 5.0}, {"stiffness_n_m": 1e6}, {"friction": 3.0}):
        assert not checker.target(replay, phase, {**beside, **change})[0]


def test_an_object_that_may_jam_has_no_certificate(urdf: Path) -> None:
    result = plan(parse_request(peg_request(urdf, **{"in": {"force_n": 0.0}})))
    assert result.verdict.value == "FEASIBLE_AT_SAMPLES"
    assert "not shown that peg does not jam during in" in " ".join(result.explanation)
    assert "force_n is 0 N" in " ".join(result.explanation)


def test_what_a_later_step_releases_is_known_to_every_step_before(urdf: Path) -> None:
    named = NamedStep.list_all(parse_request(peg_request(urdf)).section)  # type: ignore[arg-type]
    (last,) = [k for k, own in enumerate(named) if own.step.release is not None]
    assert [own.sets_down for own in named] == [{"peg"} if k < last else set() for k in range(len(named))]
    assert [own.lands for own in named] == [(("peg",) if k == last - 1 else ()) for k in range(len(named))]


def test_a_plan_goes_on_with_what_the_hand_holds(urdf: Path) -> None:
    request = peg_request(urdf)
    steps = request["task"]["steps"]
    request["task"]["steps"] = [*steps[:2], {"wait": "until it is clear"}, *steps[2:]]
    before = plan(parse_request(request)).motion
    assert before is not None
    last, q = split_motion(before)[-1], before.curve.positions[-1]
    pose = place_frames(last.robot, q, ["peg"])["peg"]
    request["start"] = {"joints": dict(zip(before.robot.joint_names, q.tolist(), strict=True))}
    request["scene"]["objects"][0] |= {"position": pose[:3, 3].tolist(), "quaternion_wxyz": [1, 0, 0, 0]}
    up = {"name": "up", "screw": {"frame": "peg", "translation_m": 0.02, "rotation_deg": 90, "rate_deg_s": 30}}
    # 7 N hold its weight, and not what the fastest motion upwards adds.
    gently = {"name": "gently", "move": {"frame": "peg", "by": {"translation": [0, 0, 0.05]}, "along": "line"}}
    request["task"]["steps"] = [{"hold": {"object": "peg", "hand": "right", "force_n": 7}}, gently, up]
    after = plan(parse_request(request))
    assert after.verdict.value == "CERTIFIED", after.explanation
    assert after.motion is not None
    assert after.certificate is not None
    assert [carrier.link for carrier in after.motion.phases[0].carriers] == ["hand"]
    assert after.motion.law is not None
    borders = [after.motion.phases[1].first, after.motion.phases[1].last]
    assert 3.0 <= float(np.diff(find_times(after.motion.law, np.array(borders)))[0]) < 4.0  # a quarter turn at 30 deg/s
    swung = next(check for check in after.certificate.checks if check.name == "swung.gently.peg")
    assert 0.9 < swung.value <= 1.0


def test_the_peg_is_in_the_other_hole_in_physics(folder: Path) -> None:
    pytest.importorskip("mujoco")
    (run,) = execute_folder(folder)
    judged = judge(run.reference, run.record, run.model.physics)
    assert (judged.verdict, judged.reasons) == ("DONE", ())
    motion = run.reference.motion
    # The hand presses what it carries along its hole, and nothing that moves.
    assert list_short_hands(motion, dict.fromkeys(motion.robot.joint_names, 1e4)) == ()
    track = run.record.objects["peg"]
    np.testing.assert_allclose(track[-1, :3], [*INTO, TOP + 0.07], atol=3e-3)
    assert track[:, 2].max() > TOP + DEPTH + 0.07  # it was out of the hole in between


STUCK = {
    "an axis off by 20 deg": ({"in": {"axis": [0.0, float(np.sin(np.deg2rad(20))), -float(np.cos(np.deg2rad(20)))]}},
        "peg is turned by 20.0 deg against the axis; beyond 4.5 deg it wedges at a friction of 0.6"),
    "a hole beside the peg": ({"in": {"at": [INTO[0] + 0.01, INTO[1], TOP]}},
        "peg is 10.0 mm beside the hole's axis; within 2.0 mm (chamfer_m and half of clearance_m) it finds into it"),
}  # fmt: skip


@pytest.mark.parametrize("case", STUCK)
def test_what_does_not_fit_ends_the_plan_with_a_sentence(urdf: Path, case: str) -> None:
    changes, sentence = STUCK[case]
    result = plan(parse_request(peg_request(urdf, **changes)))
    assert result.verdict.value == "NOT_FOUND"
    assert f"step 'in': {sentence}" in result.explanation


REFUSED = {
    "put before it is taken": ([{"release": {"object": "peg"}}], "no hand holds 'peg' then; grasp it before"),
    "moved after it is put": (
        [{"grasp": {"object": "peg"}}, {"release": {"object": "peg"}},
         {"move": {"frame": "peg", "by": {"translation": [0, 0, 0.1]}, "along": "line"}}],
        "no hand holds 'peg' then; grasp it before",
    ),
    "taken twice": (2 * [{"grasp": {"object": "peg", "hand": "right"}}], "'peg' is in a hand already"),
    "unknown": ([{"grasp": {"object": "cup"}}], "unknown object 'cup'; the scene has peg"),
    "no such hand": ([{"grasp": {"object": "peg", "hand": "left"}}], "left needs a hand with two fingers that slide"),
    "held late": (
        [{"move": {"posture": "stand"}}, {"hold": {"object": "peg", "hand": "right"}}],
        "task.steps[1].hold: comes after another step; expected first",
    ),
    "pressed with a full hand": (
        [{"hold": {"object": "peg", "hand": "right"}},
         {"press": {"at": [INTO[0], INTO[1], 0.6], "normal": [0, 0, 1], "force_n": 5}}],
        "task.steps[1].hand: the right hand holds an object; expected a hand that is free",
    ),
    "held alone": ([{"hold": {"object": "peg", "hand": "right"}}], "nothing moves; expected a step after 'hold'"),
    "two hands": ([{"grasp": {"object": "peg", "hand": "both"}}], "both needs two hands with two fingers that slide"),
    "no such grasp": ([{"grasp": {"object": "peg", "grasp": 3}}], "peg has no grasps, numbered from 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_steps_that_need_what_is_not_held_are_refused(urdf: Path, case: str) -> None:
    steps, sentence = REFUSED[case]
    request = peg_request(urdf)
    request["task"] = {"steps": steps}
    with pytest.raises(RequestError) as error:
        plan(parse_request(request))
    assert sentence in str(error.value)


def test_a_grasp_that_the_gripper_cannot_make_is_impossible(urdf: Path) -> None:
    request = peg_request(urdf)
    request["scene"]["objects"][0]["size"] = [0.12, 0.12, 0.14]
    request["scene"]["obstacles"] = request["scene"]["obstacles"][:1]
    for step in request["task"]["steps"]:
        for fit in ("insert", "withdraw"):
            if fit in step:
                step[fit]["pieces"] = []
    result = plan(parse_request(request))
    assert result.verdict.value == "INFEASIBLE"
    assert "step 'take': peg is 120 mm wide; the right gripper opens to 88 mm" in result.explanation


def _stack_request(urdf: Path, *names: str) -> dict[str, Any]:
    """Return a request that takes blocks of a stack in an order, and puts each on what was put before."""
    request = peg_request(urdf)
    table = next(piece for piece in request["scene"]["obstacles"] if piece["name"] == "table")
    size = {"type": "box", "size": [0.04, 0.04, 0.06], "mass_kg": 0.3}
    request["scene"] = {
        **request["scene"],
        "obstacles": [table],
        "objects": [
            {"name": name, **size, "position": [*FROM, TOP + 0.03 + 0.06 * k]}
            for k, name in enumerate(("lower", "upper"))
        ],
    }
    request["task"] = {"steps": []}
    for k, name in enumerate(names):
        height = TOP + 0.03 + 0.06 * k
        request["task"]["steps"] += [
            {"grasp": {"object": name}},
            {"move": {"frame": name, "by": {"translation": [0, 0, 0.05]}, "along": "line"}},
            {"move": {"poses": [{"link": name, "position": [*INTO, height + 0.05]}]}},
            {"move": {"poses": [{"link": name, "position": [*INTO, height]}], "along": "line"}},
            {"release": {"object": name}},
        ]
    return request


def test_a_stack_is_taken_apart_from_above_and_built_again(urdf: Path) -> None:
    result = plan(parse_request(_stack_request(urdf, "upper", "lower")))
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert result.certificate is not None
    last = next(check for check in result.certificate.checks if check.name == "rests.10 release: leave.lower")
    assert "lower rests on upper" in last.text
    under = plan(parse_request(_stack_request(urdf, "lower", "upper")))
    assert under.verdict.value == "INFEASIBLE"
    assert any("lower is under upper; that has to be taken away first" in line for line in under.explanation)


def test_a_held_block_wipes_a_table_round_a_corner_without_a_rest(urdf: Path, tmp_path: Path) -> None:
    request = pick_place_request(urdf)
    face = {"point": [0, 0, TOP], "normal": [0, 0, 1], "pieces": ["table"]}
    corners = [[0.1, -0.2, TOP], [0.1, 0.2, TOP], [-0.1, 0.2, TOP]]
    wipe = {"frame": "block", "tool_axis": "-z", "face": face, "polyline": corners, "depth_m": -0.04, "thrust_n": 8.0,
            "blend_m": 0.03}  # fmt: skip
    up = {"frame": "block", "by": {"translation": [0, 0, 0.1]}, "along": "line"}
    request["task"] = {"steps": [{"grasp": {"object": "block"}}, {"move": up}, {"name": "wipe", "follow": wipe}]}
    result = plan(parse_request(request))
    assert result.verdict.value == "CERTIFIED", result.explanation
    motion = result.motion
    assert motion is not None
    for phase in motion.phases:
        if phase.name in ("wipe: corner 1", "wipe: path 2"):  # rounding tilts the ways that meet there
            knot = int(np.abs(motion.curve.knots - phase.first).argmin())
            assert np.abs(motion.curve.tangents[knot, :2]).max() > 0.5
    assert verify_result(write_undrawn(result, tmp_path / "out"))["verdict"] == "CERTIFIED"
