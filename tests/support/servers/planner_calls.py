"""Requests to a planner server, and what it answers, in the few words tests need."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import grpc
from google.rpc.error_details_pb2 import BadRequest
from google.rpc.status_pb2 import Status

from service.proto.planner.v1 import planner_pb2 as wire
from service.request.file import parse_request
from service.wire.requests import request_to_message

DETAILS = "grpc-status-details-bin"
LONGEST_S = 1200.0  # longer than any test waits; servers of tests allow it
QUICK = {"robot": {"name": "atlas"}, "start": {"posture": "stand"}, "goal": {"joints": {"l_arm_elx": 1.2}}}
# One joint that a post is in the way of: the search for a way around it goes on until it is ended.
ARM = ("l_arm_shx", "l_arm_ely", "l_arm_elx", "l_arm_wry", "l_arm_wrx", "l_arm_wry2")
ENDLESS = {
    "robot": {
        "name": "atlas",
        "root": "fixed",
        "locked": dict.fromkeys(("back_bkz", "back_bky", "back_bkx", *ARM), 0.0),
    },
    "start": {"joints": {"l_arm_shz": -0.5}},
    "scene": {
        "obstacles": [{"type": "box", "name": "post", "size": [0.03, 0.03, 2.0], "position": [0.0, 0.8, 0.0]}],
    },
    "goal": {"joints": {"l_arm_shz": 0.5}},
    "options": {"time_limit_s": LONGEST_S},
}


def search_for(seconds: float) -> dict[str, Any]:
    """A request that keeps a worker busy for so long, and then finds nothing."""
    return {**ENDLESS, "options": {"time_limit_s": seconds}}


def plan_request(request: dict[str, Any] | None = None, **more: Any) -> wire.PlanRequest:
    """The message of a request; that of ``QUICK`` where none is given."""
    return wire.PlanRequest(request=request_to_message(parse_request(request or QUICK)), **more)


def uploaded(data: bytes, *, chunk_bytes: int = 2**18, **header: Any) -> Iterator[wire.UploadCloudRequest]:
    """The messages that bring a cloud."""
    yield wire.UploadCloudRequest(header=wire.CloudHeader(**{"format": "xyz", **header}))
    for start in range(0, len(data), chunk_bytes):
        yield wire.UploadCloudRequest(chunk=data[start : start + chunk_bytes])


def finished(responses: Any) -> wire.PlanFinished:
    """How a plan ended."""
    (one,) = [response.finished for response in responses if response.WhichOneof("event") == "finished"]
    return one


def wait_for(call: Any, event: str) -> wire.PlanResponse:
    """The next response of a kind."""
    for response in call:
        if response.WhichOneof("event") == event:
            return response
    raise AssertionError(f"no {event}")


def refusal(call: Callable[[], Any]) -> tuple[str, str, dict[str, str]]:
    """Code, text, and violations by field of a call that is refused; ``OK`` and nothing if it is not."""
    try:
        answer = call()
        if isinstance(answer, grpc.Call) or hasattr(answer, "__next__"):
            list(answer)
    except grpc.RpcError as error:
        code, text = error.code().name, error.details()  # type: ignore[attr-defined]
        return code, text, violations(error)
    return "OK", "", {}


def violations(error: grpc.RpcError) -> dict[str, str]:
    """Descriptions by field."""
    for key, value in error.trailing_metadata() or ():  # type: ignore[attr-defined]
        detail = BadRequest()
        if key == DETAILS and Status.FromString(value).details[0].Unpack(detail):
            return {one.field: one.description for one in detail.field_violations}
    return {}
