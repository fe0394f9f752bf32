"""Numbers that JSON has no word for, anywhere in what a request takes as plain data."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest

from service.errors import RequestError, shown
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_request, request_hash
from service.wire.plain import fill, to_plain

PROBLEM: dict[str, Any] = {
    "basic_info": {"n_steps": 5, "manip": "larm"},
    "costs": [{"type": "joint_vel", "params": {"coeffs": [1.5, 2.5]}}],
    "init_info": {"type": "stationary"},
    "more": {"a": [0.5, {"b": 2.5}]},
}
PLACES = [("more", "a", 1, "b"), ("more", "a", 0), ("costs", 0, "params", "coeffs", 1), ("basic_info", "n_steps")]
HUGE = int("f" * 6000, 16)  # which YAML writes in hexadecimals and Python not in decimals


def _request(problem: dict[str, Any]) -> dict[str, Any]:
    return {"robot": {"name": "atlas"}, "task": {"trajopt": problem}}


def _with(place: tuple[str | int, ...], value: object) -> dict[str, Any]:
    problem = copy.deepcopy(PROBLEM)
    target: Any = problem
    for step in place[:-1]:
        target = target[step]
    target[place[-1]] = value
    return problem


def _path(place: tuple[str | int, ...]) -> str:
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)[1:]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, 10**400, HUGE], ids=["nan", "inf", "-inf", "1e400", "huge"]
)
def test_a_number_that_is_none_is_refused_in_one_line_that_names_its_place(
    place: tuple[str | int, ...], value: float
) -> None:
    with pytest.raises(RequestError) as refusal:
        parse_request(_request(_with(place, value)))
    (line,) = refusal.value.problems
    assert line.startswith(f"task.trajopt: a finite number is needed at {_path(place)}, got ")
    assert len(line) < 200


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_such_a_number_arrives_over_the_wire_to_be_refused(place: tuple[str | int, ...], value: float) -> None:
    message = MotionRequest()
    fill(message, _request(_with(place, value)))
    with pytest.raises(RequestError, match="a finite number is needed"):
        parse_request(to_plain(message))


def test_plain_data_comes_through_the_wire_as_it_was() -> None:
    message = MotionRequest()
    fill(message, _request(PROBLEM))
    sent, received = parse_request(_request(PROBLEM)), parse_request(to_plain(message))
    assert received.task is not None
    assert received.task.trajopt == PROBLEM
    assert request_hash(sent) == request_hash(received)


def test_plain_data_nested_deeper_than_anybody_writes_is_refused() -> None:
    deep: Any = 1.0
    for _ in range(40):
        deep = [deep]
    with pytest.raises(RequestError, match=r"task\.trajopt: nested deeper than 30 levels"):
        parse_request(_request({**PROBLEM, "more": deep}))


def test_an_integer_too_long_for_decimals_is_shown_in_hexadecimals() -> None:
    assert shown(HUGE) == "0x" + "f" * 57 + "…"
    with pytest.raises(RequestError, match=r"options.seed: .*, got 0xff"):
        parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "options": {"seed": HUGE}})


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_floor_at_a_height_that_no_double_comes_near_is_refused() -> None:
    scene = {"floor": 10**400}
    with pytest.raises(RequestError, match=r"scene.floor: expected true, false or a height in metres"):
        parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "scene": scene})
