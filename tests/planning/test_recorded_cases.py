"""Recorded holds and lies: what is certified is done in physics, and what is false is refused, or named."""

from __future__ import annotations

from pathlib import Path

import pytest

from service import certify, read_trajectory
from service.errors import RequestError
from service.planner import plan
from service.request.file import load_request, request_hash
from service.result.result import Verdict

DONE = (
    "button_150",
    "door_ajar",
    "leverb_90",
    "rail_push_right_side",
)
REFUSED = {
    "circle_114_20": "jams",
    "hose_push_turn": "jams",
    "rail_push_wrong_side": "would have to pull",
}
LOOSE = {"hose_turn": "push", "plugb_100": "across"}  # joints without friction that the leaving hand could drag
UNSTATED = ("beam_8kg_35", "drill_115_20")  # a beam in two hands, and a drill's way, with what the request says of them
FALSE = {
    "door_float": "in front of the leaf's face",
    "hatch": "gravity moves it",
    "peg_front": "would have to pull",
    "solid": "inside fixture/cupboard",
}


@pytest.mark.parametrize("name", [*DONE, *UNSTATED])
def test_a_certified_hold_is_done_in_physics(shared_cases: Path, name: str) -> None:
    pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'scopt[sim]'")
    from service.simulation.options import SimulationOptions
    from service.simulation.report import make_report
    from service.simulation.run import execute_motion

    result = plan(load_request(shared_cases / "holds" / f"{name}.yaml"))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.motion is not None
    # Its kinds are done at the lower end of the hands' friction in execution/test_simulation_kinds.py; many jam above.
    friction = None if name == "door_ajar" else result.request.options.hand_friction[1]
    options = SimulationOptions(hand_friction=friction, settle_s=0.3, after_s=1.0)
    runs = execute_motion(result.motion, result.request, "CERTIFIED", request_hash(result.request), options)
    report, _ = make_report(runs)
    assert report["verdict"] == "DONE", report["explanation"]
    if name == "door_ajar":
        (leaf,) = report["mechanism"]
        assert leaf["share"] == pytest.approx(1.0, abs=0.05)
    if name.startswith("button"):
        assert any("needs torque feed-forward" in note for note in result.notes)


@pytest.mark.parametrize(("name", "words"), REFUSED.items())
def test_a_hold_that_moves_nothing_is_refused(shared_cases: Path, name: str, words: str) -> None:
    result = plan(load_request(shared_cases / "holds" / f"{name}.yaml"))
    assert result.verdict is Verdict.INFEASIBLE
    assert words in result.explanation[0]


@pytest.mark.parametrize(("name", "joint"), LOOSE.items())
def test_a_joint_that_nothing_brings_to_rest_is_named(shared_cases: Path, name: str, joint: str) -> None:
    with pytest.raises(RequestError, match=f"nothing brings {joint} to rest once the hand has gone"):
        plan(load_request(shared_cases / "holds" / f"{name}.yaml"))


def test_a_beam_too_heavy_for_the_hand_that_carries_it_is_refused_with_the_joint(shared_cases: Path) -> None:
    with pytest.raises(RequestError, match=r"start: l_arm_wry needs 27\.76 N m at rest, its effort limit is 25 N m"):
        plan(load_request(shared_cases / "holds" / "beam_10kg_90.yaml"))


@pytest.mark.parametrize(("name", "words"), FALSE.items())
def test_a_lie_is_refused_with_what_is_wrong(shared_cases: Path, name: str, words: str) -> None:
    request = load_request(shared_cases / "lies" / name / "request.yaml")
    if name == "peg_front":
        result = plan(request)
        assert result.verdict is Verdict.INFEASIBLE
        assert words in result.explanation[0]
        return
    with pytest.raises(RequestError, match=words):
        plan(request)


def test_a_joint_of_velocity_0_is_named(shared_cases: Path) -> None:
    result = plan(load_request(shared_cases / "lies" / "vel0" / "request.yaml"))
    assert any("velocity limits are 0 (slide)" in note for note in result.notes)


def test_a_base_that_another_planner_moves_is_no_part_of_a_robot_that_stands(shared_cases: Path) -> None:
    folder = shared_cases / "lies" / "certify_multi"
    outcome = certify(read_trajectory(folder / "plan.json"), load_request(folder / "request.yaml"))
    assert not outcome.is_certified
    assert any("base" in failure for failure in outcome.failures)
