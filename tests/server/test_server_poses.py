"""Pose sessions of a real server."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from planner_calls import refusal
from planner_server import planner_server

from service.client import PlannerClient
from service.proto.planner.v1 import pose_pb2 as wire
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.wire.plain import fill

pytestmark = pytest.mark.filterwarnings("error")
WALL = {"type": "box", "name": "wall", "size": [0.1, 3.0, 2.0], "position": [0.65, 0.0, 1.0]}
ATLAS = {"robot": {"name": "atlas"}, "scene": {"obstacles": [WALL]}}
BYTES = 1000  # of an answer
HAND = (0.327, -0.406, 0.798)  # where the right hand is at first [m]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerClient]:
    with (
        planner_server(tmp_path_factory.mktemp("data"), workers=1) as started,
        PlannerClient(started.address) as client,
    ):
        yield client


class Operator:
    """Sends one event after the other and takes the answers."""

    def __init__(self, client: PlannerClient, request: dict[str, Any] | None = None) -> None:
        self._events: queue.SimpleQueue[wire.PoseEvent | None] = queue.SimpleQueue()
        message = MotionRequest()
        fill(message, request or ATLAS)
        self._answers = client.pose_session(message, iter(self._events.get, None))
        self.opened = next(self._answers).opened
        self._number = 0

    def send(self, **event: Any) -> int:
        self._number += 1
        self._events.put(wire.PoseEvent(number=self._number, **event))
        return self._number

    def ask(self, **event: Any) -> wire.SessionPose:
        """The answer to an event."""
        number, pose = self.send(**event), self.take()
        assert pose.number == number
        return pose

    def take(self) -> wire.SessionPose:
        pose = next(self._answers).pose
        assert pose.ByteSize() <= BYTES
        return pose

    def end(self) -> None:
        self._events.put(None)
        assert list(self._answers) == []


def _lead(x: float, **more: Any) -> dict[str, Any]:
    target = wire.DragTarget(link="r_hand", position=[HAND[0] + x, *HAND[1:]])
    return {"drag": wire.Drag(targets=[target], **more)}


def _numbers(pose: wire.SessionPose) -> list[float]:
    return [*pose.base, *pose.positions]


def test_a_session_leads_stops_undoes_and_takes_a_given_pose(client: PlannerClient) -> None:
    operator = Operator(client)
    opened = operator.opened
    assert {"l_hand", "r_hand", "pelvis", "utorso"} <= set(opened.links)
    assert list(opened.feet) == ["l_foot", "r_foot"]
    assert len(opened.joint_names) == len(opened.pose.positions)
    assert opened.pose.is_checked
    assert opened.pose.revision == 1
    for k in range(1, 10):
        led = operator.ask(**_lead(0.05 * k, is_last=k == 9))
    assert led.is_checked
    assert led.undo_steps == 1
    assert led.miss_m[0] > 0.1
    assert led.stops[-1].kind == wire.POSE_STOP_KIND_REACH
    assert any(stop.kind == wire.POSE_STOP_KIND_PAIR and "wall" in stop.names for stop in led.stops)
    back = operator.ask(undo=wire.UndoPose())
    assert _numbers(back) == _numbers(opened.pose)
    assert back.revision > led.revision
    assert _numbers(operator.ask(redo=wire.RedoPose())) == _numbers(led)
    given = wire.SetPose()
    base = {"position": list(back.base[:3]), "quaternion_wxyz": list(back.base[3:])}
    names = list(opened.joint_names)
    fill(given.pose, {"joint_names": names, "positions": list(back.positions), "base": base})
    assert _numbers(operator.ask(set=given)) == _numbers(back)
    operator.end()


def test_a_preview_comes_before_the_checked_pose(client: PlannerClient) -> None:
    operator = Operator(client)
    number = operator.send(with_preview=True, **_lead(0.02))
    preview, checked = operator.take(), operator.take()
    assert (preview.number, checked.number) == (number, number)
    assert (preview.is_checked, checked.is_checked) == (False, True)
    assert preview.revision == 1
    assert checked.revision == 2
    operator.end()


def test_of_drags_that_arrive_together_the_newest_is_answered(client: PlannerClient) -> None:
    operator = Operator(client)
    numbers = [operator.send(**_lead(0.001 * k)) for k in range(1, 41)]
    last = operator.send(undo=wire.UndoPose())
    answered = [operator.take()]
    while answered[-1].number != last:
        answered.append(operator.take())
    own = [pose.number for pose in answered]
    assert own == sorted(own)
    assert numbers[-1] in own
    assert len(own) < len(numbers)
    assert _numbers(answered[-1]) == _numbers(operator.opened.pose)
    operator.end()


@pytest.mark.parametrize(
    ("event", "sentence"),
    [
        ({}, "order: expected drag, undo, redo or set"),
        ({"undo": wire.UndoPose()}, "undo: there is no earlier pose"),
        ({"redo": wire.RedoPose()}, "redo: nothing was undone"),
        ({"drag": wire.Drag(targets=[wire.DragTarget(link="hnd", position=[0, 0, 1])])}, "unknown link 'hnd'"),
        ({"drag": wire.Drag(targets=[wire.DragTarget(link="r_hand", position=[0, 0])])}, "expected 3 finite numbers"),
        (
            {"drag": wire.Drag(targets=[wire.DragTarget(link="r_hand", position=[0, 0, np.nan])])},
            "expected 3 finite numbers",
        ),
        ({"drag": wire.Drag(joints={"l_arm_elz": 0.0})}, "unknown joint 'l_arm_elz'"),
    ],
)
def test_a_wrong_event_is_answered_by_a_sentence_and_the_session_goes_on(
    client: PlannerClient, event: dict[str, Any], sentence: str
) -> None:
    operator = Operator(client)
    refused = operator.ask(**event)
    assert sentence in refused.refusal
    assert _numbers(refused) == _numbers(operator.opened.pose)
    assert operator.ask(**_lead(0.01)).refusal == ""
    operator.end()


def test_a_session_that_cannot_be_opened_is_refused_by_its_field(client: PlannerClient) -> None:
    stub = client._calls._transport._stub

    def told(*messages: wire.PoseSessionRequest) -> tuple[str, str, dict[str, str]]:
        return refusal(lambda: list(stub.PoseSession(iter(messages), timeout=240)))

    code, text, _ = told(wire.PoseSessionRequest(event=wire.PoseEvent(number=1)))
    assert (code, text) == ("INVALID_ARGUMENT", "open: the first message of a pose session needs it")
    unknown = MotionRequest()
    fill(unknown, {"robot": {"name": "atlsa"}})
    code, _, fields = told(wire.PoseSessionRequest(open=wire.OpenPoseSession(request=unknown)))
    assert code == "INVALID_ARGUMENT"
    assert list(fields) == ["open.request.robot.name"]
    inside = MotionRequest()
    fill(inside, {**ATLAS, "scene": {"obstacles": [{**WALL, "position": [0.3, 0.0, 1.0]}]}})
    code, text, _ = told(wire.PoseSessionRequest(open=wire.OpenPoseSession(request=inside)))
    assert code == "INVALID_ARGUMENT"
    assert "start is in collision" in text
