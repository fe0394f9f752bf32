"""A server with busy workers: light calls and refusals do not wait, and clients share what is left."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import grpc
import pytest
from planner_calls import ENDLESS, QUICK, plan_request, refusal, wait_for
from planner_server import ServerProcess, planner_server

from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.trust import Role, make_token
from service.wire.plain import fill


@pytest.fixture(scope="module")
def tokens(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Token of each client, and ``file``."""
    lines = {name: make_token(name, list(Role)) for name in ("greedy", "polite")}
    file = tmp_path_factory.mktemp("tokens") / "tokens.yaml"
    file.write_text("\n".join(line for _, line in lines.values()))
    file.chmod(0o600)
    return {**{name: token for name, (token, _) in lines.items()}, "file": str(file)}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, tokens: dict[str, str]) -> Iterator[ServerProcess]:
    folder = tmp_path_factory.mktemp("server") / "data"
    with planner_server(folder, "--queue", "4", "--tokens", tokens["file"]) as started:
        yield started


@pytest.fixture
def stub(server: ServerProcess) -> Iterator[PlannerServiceStub]:
    with grpc.insecure_channel(server.address) as channel:
        yield PlannerServiceStub(channel)  # type: ignore[no-untyped-call]


def _as(tokens: dict[str, str], name: str) -> list[tuple[str, str]]:
    return [("authorization", f"Bearer {tokens[name]}")]


def test_light_calls_and_refusals_do_not_wait_and_a_polite_client_goes_first(
    stub: PlannerServiceStub, tokens: dict[str, str]
) -> None:
    greedy, polite = _as(tokens, "greedy"), _as(tokens, "polite")
    stub.ListRobots(wire.ListRobotsRequest(), timeout=240, metadata=greedy)  # names are known from now on
    calls = [stub.Plan(plan_request(ENDLESS), timeout=240, metadata=greedy)]
    wait_for(calls[0], "progress")
    calls += [stub.Plan(plan_request(ENDLESS), timeout=240, metadata=greedy) for _ in range(3)]
    for call in calls[1:]:
        wait_for(call, "queued")
    assert stub.ListRobots(wire.ListRobotsRequest(), timeout=120, metadata=polite).robots[0].name == "atlas"
    wrong = {
        "robot": {"name": "atlas"},
        "start": {"posture": "stnd"},
        "goal": {"joints": {"l_arm_elz": 0.1}},
        "options": {"time_limit_s": 5000.0, "starts": 3},
    }
    for robot, fields in {
        "atlas": {"request.start.posture", "request.goal.joints", "request.options.time_limit_s"},
        "atlsa": {"request.robot.name", "request.options.time_limit_s"},
    }.items():
        message = _message({**wrong, "robot": {"name": robot}})
        code, _, found = refusal(lambda sent=message: list(stub.Plan(sent, timeout=120, metadata=polite)))
        assert (code, set(found)) == ("INVALID_ARGUMENT", fields)
    assert all(call.is_active() for call in calls)  # what was asked meanwhile did not wait for them
    quick = stub.Plan(plan_request(QUICK), timeout=240, metadata=polite)
    wait_for(quick, "queued")
    calls[0].cancel()
    assert wait_for(quick, "finished")
    assert all(call.is_active() for call in calls[1:])
    for call in calls:
        call.cancel()


def test_a_field_of_a_newer_client_is_ignored_and_said_to_be(stub: PlannerServiceStub, tokens: dict[str, str]) -> None:
    message = plan_request(QUICK)
    newer = wire.PlanRequest.FromString(message.SerializeToString() + b"\xf8\x3e\x01" + b"\x12\x03\xfa\x3f\x00")
    responses = list(stub.Plan(newer, timeout=240, metadata=_as(tokens, "polite")))
    ignored = [
        "field_1007: field number 1007 of PlanRequest is unknown to this server and was ignored; "
        "the client is newer than the server",
        "request.field_1023: field number 1023 of MotionRequest is unknown to this server and was ignored; "
        "the client is newer than the server",
    ]
    assert list(responses[0].accepted.warnings) == ignored
    assert list(responses[-1].finished.result.notes)[:2] == ignored
    status = wire.GetStatusRequest.FromString(b"\xf8\x3e\x01")
    _, call = stub.GetStatus.with_call(status, timeout=120, metadata=_as(tokens, "polite"))
    assert [value for key, value in call.trailing_metadata() if key == "scopt-warning"] == [
        "field_1007: field number 1007 of GetStatusRequest is unknown to this server and was ignored; "
        "the client is newer than the server"
    ]


def test_an_unknown_priority_is_refused(stub: PlannerServiceStub, tokens: dict[str, str]) -> None:
    message = plan_request(QUICK, priority=7)
    code, _, found = refusal(lambda: list(stub.Plan(message, timeout=120, metadata=_as(tokens, "polite"))))
    assert (code, set(found)) == ("INVALID_ARGUMENT", {"priority"})


def _message(request: dict[str, Any]) -> wire.PlanRequest:
    """The message of a wrong request."""
    message = wire.PlanRequest()
    fill(message.request, request)
    return message
