"""How much a message may hold: counted before it is looked at."""

from __future__ import annotations

import pytest
from google.protobuf.message import Message

from service.proto.planner.v1 import planner_pb2 as wire
from service.wire.message_checks import find_excess


def _poses(n: int) -> Message:
    message = wire.PlanRequest()
    for _ in range(n):
        message.request.goal.poses.add()
    return message


def _numbers(n: int) -> Message:
    return wire.PlanRequest(request={"start": {"positions": [0.0] * n}})  # type: ignore[arg-type]


def _joints(n: int) -> Message:
    return wire.PlanRequest(request={"goal": {"joints": {str(k): 0.0 for k in range(n)}}})  # type: ignore[arg-type]


def _terms(n: int) -> Message:
    message = wire.PlanRequest()
    message.request.task.trajopt.update({"costs": [0.0] * (n - 1)})
    return message


@pytest.mark.parametrize(
    ("made", "field"),
    [
        (_poses, "request.goal.poses"),
        (_numbers, "request.start.positions"),
        (_joints, "request.goal.joints"),
        (_terms, "request.task.trajopt"),
    ],
)
def test_as_many_entries_as_may_be_are_taken_and_one_more_names_its_list(made: object, field: str) -> None:
    assert find_excess(made(50), 50) == ""  # type: ignore[operator]
    assert find_excess(made(51), 50).startswith(f"{field}: too many entries")  # type: ignore[operator]


def test_entries_that_have_fields_are_fewer() -> None:
    assert find_excess(_poses(50), 100, 50) == ""
    assert find_excess(_poses(51), 100, 50).startswith("request.goal.poses: too many entries; expected at most 50 that")
    assert find_excess(_numbers(51), 100, 50) == ""


def test_entries_of_all_lists_count_together() -> None:
    message = wire.PlanRequest()
    for _ in range(10):
        message.request.scene.obstacles.add(size=[1.0] * 10)
    assert find_excess(message, 110) == ""
    assert find_excess(message, 109).startswith("request.scene.obstacles.size: ")
