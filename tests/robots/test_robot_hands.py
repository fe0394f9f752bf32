"""Robots by path whose request names their hands: the tasks use them, and the replay does too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from given_doors import door_request
from given_mechanisms import drawer_request
from given_wheels import wheel_request
from shared_plans import write_undrawn
from tiny_robots import atlas

import costs.robot.atlas
from service.demands.hands import HANDS, list_robot_hands
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import Verdict
from service.start.robot import load_requested_robot
from service.wire.requests import request_from_message, request_to_message

FOLDER = Path(costs.robot.atlas.__file__).parent
RENAMED = {"hook": "rod", "tool": "tip", "peg": "middle", "stub": "front"}
OURS = {
    side: {"link": f"{side[0]}_hand", **{key: f"{side[0]}_{name}" for key, name in RENAMED.items()}}
    for side in ("left", "right")
}
VALVE = wheel_request(turn_deg=20)["task"]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The bundled Atlas as files, its hands' frames renamed."""
    folder = tmp_path_factory.mktemp("robot")
    for name in ("atlas.urdf", "atlas.srdf"):
        text = (FOLDER / name).read_text()
        for side in ("l", "r"):
            for key, new in RENAMED.items():
                text = text.replace(f'"{side}_{key}"', f'"{side}_{new}"')
        (folder / name).write_text(text)
    files = {"urdf": str(folder / "atlas.urdf"), "srdf": str(folder / "atlas.srdf")}
    return {**files, "package_dirs": [str(FOLDER.parent)], "root": "floating", "hands": OURS}


@pytest.mark.parametrize(
    "request_data",
    [drawer_request(), door_request(x=0.75, open_deg=20.0), {**drawer_request(), "task": VALVE}],
    ids=["drawer", "door", "valve"],
)
def test_a_robot_by_path_does_every_task_with_the_hands_that_it_names(
    robot: dict[str, Any], request_data: dict[str, Any], tmp_path: Path
) -> None:
    result = plan(parse_request({**request_data, "robot": robot}))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    frames = {target.frame for phase in result.motion.phases for target in phase.targets if hasattr(target, "frame")}
    assert frames
    assert all(frame.split("_")[1] in RENAMED.values() for frame in frames)
    write_undrawn(result, tmp_path / "out")
    path = tmp_path / "request.json"
    path.write_text(json.dumps({**request_data, "robot": robot}))
    assert verify_result(tmp_path / "out", path)["verdict"] == "CERTIFIED"


def test_without_named_hands_the_same_robot_has_none(robot: dict[str, Any]) -> None:
    with pytest.raises(RequestError, match=r"has no hand with a rod, .*robot\.hands"):
        plan(parse_request({**drawer_request(), "robot": {**robot, "hands": {}}}))


def test_a_hand_without_a_peg_opens_no_drawer(robot: dict[str, Any]) -> None:
    hook_only = {"right": {key: OURS["right"][key] for key in ("link", "hook", "tool")}}
    with pytest.raises(RequestError, match="has no hand with a rod"):
        plan(parse_request({**drawer_request(), "robot": {**robot, "hands": hook_only}}))


def test_an_unknown_frame_of_a_hand_is_refused_by_its_field(robot: dict[str, Any]) -> None:
    wrong = {"left": {**OURS["left"], "peg": "l_peg"}}
    with pytest.raises(RequestError) as caught:
        load_requested_robot(parse_request({**drawer_request(), "robot": {**robot, "hands": wrong}}))
    assert caught.value.problems[0].startswith("robot.hands.left.peg: unknown link 'l_peg'; atlas has ")


def test_a_hand_of_neither_side_is_refused(robot: dict[str, Any]) -> None:
    with pytest.raises(RequestError, match=r"robot\.hands"):
        parse_request({**drawer_request(), "robot": {**robot, "hands": {"middle": OURS["left"]}}})


def test_hands_travel_with_the_request(robot: dict[str, Any]) -> None:
    request = parse_request({**drawer_request(), "robot": robot})
    assert request_from_message(request_to_message(request)) == request


def test_the_bundled_robot_keeps_its_hands() -> None:
    assert list_robot_hands(atlas()) == tuple(HANDS.values())
