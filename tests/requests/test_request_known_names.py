"""Wrong names are refused before a robot is loaded, in the words that the planner would use."""

from __future__ import annotations

from typing import Any

import pytest

from service.errors import MAX_PROBLEMS, RequestError
from service.request.file import parse_request
from service.request.known_names import RobotNames, find_name_problems
from service.setup.prepare import prepare
from service.work.look import list_names

ATLAS: dict[str, Any] = {
    "robot": {"name": "atlas"},
    "start": {"posture": "stand"},
    "goal": {"joints": {"l_arm_elx": 1.0}},
}


@pytest.fixture(scope="module")
def names() -> dict[str, RobotNames]:
    return {robot.name: robot for robot in list_names()}


@pytest.mark.parametrize(
    "change",
    [
        {"robot": {"name": "atlsa"}},
        {"start": {"posture": "stnd"}},
        {"start": {"joints": {"l_arm_elz": 0.0}}},
        {"goal": {"posture": "sit"}},
        {"goal": {"joints": {"elbow": 0.0, "l_arm_elx": 0.0}}},
        {"goal": {"poses": [{"link": "l_hnd", "position": [0.5, 0.2, 1.0]}]}},
        {"keep": [{"link": "l_hand", "relative_to": "r_hnd"}]},
        {"options": {"feet": ["l_fot"]}},
    ],
    ids=str,
)
def test_a_wrong_name_is_refused_in_the_words_of_the_planner(
    names: dict[str, RobotNames], change: dict[str, Any]
) -> None:
    data = {**ATLAS, **change}
    with pytest.raises(RequestError) as refused:
        prepare(parse_request(data))
    assert find_name_problems(data, names, names) == list(refused.value.problems)


@pytest.mark.parametrize(
    "data",
    [
        ATLAS,
        {**ATLAS, "start": {"base": {"position": [0, 0, 1]}, "joint_names": ["l_arm_elx"], "positions": [0.1]}},
        {**ATLAS, "attached": [{"name": "beam"}], "goal": {"poses": [{"link": "beam"}]}},
        {**ATLAS, "robot": {"urdf": "a.urdf"}, "start": {"posture": "any"}},
        {**ATLAS, "robot": {"name": "atlas", "hand": "gripper"}, "goal": {"joints": {"finger": 1.0}}},
        {**ATLAS, "robot": {"name": 7}},
        {**ATLAS, "robot": 7, "goal": [], "start": None, "keep": 1, "options": {"feet": 3}},
        {**ATLAS, "goal": {"joints": {"x" * 300: 0.0}, "poses": [3, {"link": None}]}},
    ],
    ids=lambda data: str(data)[-60:],
)
def test_what_may_be_right_or_is_wrong_in_another_way_is_left_to_others(
    names: dict[str, RobotNames], data: dict[str, Any]
) -> None:
    assert find_name_problems(data, names, names) == []


def test_of_many_wrong_names_the_first_are_named(names: dict[str, RobotNames]) -> None:
    joints = {f"joint{k}": 0.0 for k in range(100_000)}
    assert len(find_name_problems({**ATLAS, "goal": {"joints": joints}}, names, names)) == MAX_PROBLEMS
