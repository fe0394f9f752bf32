"""An object goes from hand to hand in the air, and free motions end where what they carry rests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from shared_plans import write_undrawn

from benchmarks.attack.gantry_files import hand_over_request, pick_place_request, write_gantry, write_two_hands
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult
from service.simulation.run import execute_motion
from service.simulation.verdict import judge


@pytest.fixture(scope="module", name="request_data")
def _request(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return hand_over_request(write_two_hands(tmp_path_factory.mktemp("gantry")))


@pytest.fixture(scope="module", name="handed")
def _handed(request_data: dict[str, Any]) -> PlanResult:
    result = plan(parse_request(request_data))
    assert result.verdict.value == "CERTIFIED", result.explanation
    return result


def test_a_bar_goes_from_hand_to_hand_and_is_certified_anew(handed: PlanResult, tmp_path: Path) -> None:
    folder = write_undrawn(handed, tmp_path / "out")
    assert verify_result(folder)["verdict"] == "CERTIFIED"
    grips = {
        phase["name"]: [grip["fingers"][0] for carrier in phase["carriers"] for grip in carrier["grips"]]
        for phase in json.loads((folder / "result.json").read_text())["phases"]
    }
    right, left = "finger_1", "second_finger_1"
    assert grips["take over: close"] == [right]
    assert grips["give: open"] == grips["down"] == [left]
    assert grips["let go: open"] == []


def test_the_bar_is_at_its_place_in_physics(handed: PlanResult) -> None:
    assert handed.motion is not None
    for run in execute_motion(handed.motion, handed.request, "CERTIFIED", ""):
        assert judge(run.reference, run.record, run.model.physics).verdict == "DONE"


REFUSED = {
    "hand that holds it": ([2], {"hand": "right"}, "'bar' is in a hand already; expected the other one"),
    "hand that is elsewhere": ([3], {"hand": "left"}, None),
    "hand that is empty": ([5], {"hand": "right"}, "the left hand holds 'bar' then, not the right one"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_hands_that_hold_it_are_known_to_every_step(request_data: dict[str, Any], case: str) -> None:
    (index,), change, sentence = REFUSED[case]
    data = json.loads(json.dumps(request_data))
    step = data["task"]["steps"][index]
    step[next(key for key in step if key != "name")] |= change
    if sentence is None:  # the hand that took it last gives it back
        parse_request(data)
        return
    with pytest.raises(RequestError) as error:
        plan(parse_request(data))
    assert sentence in str(error.value)


def test_a_free_motion_ends_where_what_it_carries_rests(tmp_path: Path) -> None:
    request = pick_place_request(write_gantry(tmp_path))
    request["task"] = {
        "steps": [
            {"grasp": {"object": "block"}},
            {"move": {"poses": [{"link": "block", "position": [-0.1, 0.2, 0.44]}]}},
            {"release": {"object": "block"}},
        ]
    }
    result = plan(parse_request(request))
    assert result.verdict.value == "CERTIFIED", result.explanation


def test_a_second_hand_that_is_not_there_is_named(tmp_path: Path) -> None:
    request = pick_place_request(write_gantry(tmp_path))
    request["task"] = {"steps": [{"grasp": {"object": "block"}}, {"grasp": {"object": "block"}}]}
    result = plan(parse_request(request))
    assert "no hand is free to take block" in " ".join(result.explanation)
