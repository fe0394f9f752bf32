"""Valid-looking messages of the largest size, with as many names, parts and points as possible."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from google.protobuf.message import Message

from benchmarks.service import asks
from service.proto.planner.v1 import planner_pb2 as wire
from service.wire.entries import MAX_ENTRIES, MAX_MESSAGES

MOST = MAX_ENTRIES - 10_000  # entries of one message that the server still looks into
MANY = MAX_MESSAGES - 5_000  # of those that have fields themselves
TEXT_BYTES = 3_900_000  # a little less than a message may have
HEADER = b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH %d\nHEIGHT 1\nPOINTS %d\nDATA binary\n"


def large(cloud_id: str) -> Mapping[str, tuple[str, list[bytes]]]:
    """Return method and messages of one call each, by the field that is large.

    Args:
        cloud_id: of a small cloud on the server.
    """
    text = "n" * TEXT_BYTES
    clouds = wire.CloudsSpec(clouds=[{"file": cloud_id}], sensor=[0, 0, 1])  # type: ignore[list-item]
    many = wire.CloudsSpec(clouds=[{"file": cloud_id}] * 40_000)  # type: ignore[list-item]
    parts = [{"path": "result.json", "data": b" "}] * 160_000
    calls: dict[str, tuple[str, list[Message]]] = {
        "joints of a goal": ("Plan", [_plan(_joints)]),
        "joints of a start": ("Plan", [_plan(lambda it: it.start.joint_names.extend(f"j{k}" for k in range(MOST)))]),
        "obstacles": ("Plan", [_plan(_obstacles)]),
        "nameless obstacles": ("Plan", [_plan(lambda it: [it.scene.obstacles.add() for _ in range(MOST)])]),
        "corners of an obstacle": ("Plan", [_plan(_corners)]),
        "attached bodies": ("Plan", [_plan(_attached)]),
        "poses to keep": ("Plan", [_plan(lambda it: [it.keep.add(link=f"l{k}") for k in range(MANY)])]),
        "feet": ("Plan", [_plan(lambda it: it.options.feet.extend(f"f{k}" for k in range(MOST)))]),
        "numbers of a position": ("Plan", [_plan(lambda it: it.goal.poses.add().position.extend([0.5] * MOST))]),
        "steps of a TrajOpt problem": ("Plan", [_plan(_trajopt)]),
        "depth of a TrajOpt problem": ("Plan", [_plan(_deep)]),
        "name of a robot": ("Plan", [_plan(lambda it: setattr(it.robot, "name", text))]),
        "request_id": ("Plan", [asks.plan_request(asks.ARM_TURNS, text)]),
        "parts of files": ("Verify", [wire.VerifyRequest(files=[{"path": "a"}] * MOST)]),  # type: ignore[list-item]
        "parts of one file": ("Verify", [wire.VerifyRequest(files=parts)]),  # type: ignore[arg-type]
        "files": ("Verify", [wire.VerifyRequest(files=[{"path": f"{k}"} for k in range(MOST)])]),  # type: ignore[misc]
        "one file": ("Verify", [wire.VerifyRequest(files=[{"path": "result.json", "data": b"[" * TEXT_BYTES}])]),  # type: ignore[list-item]
        "path of a file": ("Verify", [wire.VerifyRequest(files=[{"path": "a/" * (TEXT_BYTES // 2)}])]),  # type: ignore[list-item]
        "kinds to look for": ("BuildScene", [wire.BuildSceneRequest(clouds=clouds, detect=["valve"] * MOST)]),
        "numbers of a hint": ("Detect", [wire.DetectRequest(clouds=clouds, kind="valve", hint=[1.0] * MOST)]),
        "kind": ("Detect", [wire.DetectRequest(clouds=clouds, kind=text)]),
        "times a cloud": ("BuildScene", [wire.BuildSceneRequest(clouds=many)]),
        "plan_id": ("GetPlan", [wire.GetPlanRequest(plan_id=text)]),
        "comment": ("ReviewPlan", [wire.ReviewPlanRequest(plan_id="0", decision=1, comment=text)]),
        "cloud that announces 2^60 bytes": ("UploadCloud", _upload(b"1 2 3\n", size_bytes=2**60)),
        "cloud that announces 60 MiB and has 6 bytes": ("UploadCloud", _upload(b"1 2 3\n", size_bytes=60 * 2**20)),
        "cloud that announces 6 bytes and has 3.9 MB": ("UploadCloud", _upload(bytes(TEXT_BYTES), size_bytes=6)),
        "cloud in pieces of one byte": ("UploadCloud", [_header(), *[_chunk(b"1")] * 3000]),
        "cloud of empty chunks": ("UploadCloud", [_header(), *[_chunk(b"")] * 3000]),
        "cloud that tells of 2,000,000,000 points": ("UploadCloud", _upload(HEADER % (2 * 10**9, 2 * 10**9), "pcd")),
    }
    return {name: (method, [one.SerializeToString() for one in sent]) for name, (method, sent) in calls.items()}


def _plan(change: Callable[[Any], object]) -> wire.PlanRequest:
    """Return a request that can be planned except for one field."""
    message = asks.plan_request(asks.ARM_TURNS)
    change(message.request)
    return message


def _joints(request: Any) -> None:
    for k in range(MANY):
        request.goal.joints[f"joint{k}"] = 0.1


def _obstacles(request: Any) -> None:
    for k in range(MANY):
        request.scene.obstacles.add(type=1, name=f"b{k}", size=[0.1] * 3)  # three entries more each


def _corners(request: Any) -> None:
    obstacle = request.scene.obstacles.add(type=5, name="heap")
    for k in range(MANY):
        obstacle.points.add(value=[1.0 + k / MANY, (k * k % 97) / 97, 0.5])


def _attached(request: Any) -> None:
    for k in range(MANY):
        request.attached.add(type=1, name=f"a{k}", link="link7", size=[0.1] * 3)


def _trajopt(request: Any) -> None:
    request.ClearField("goal")
    problem = request.task.trajopt
    problem["basic_info"] = {"n_steps": 10, "manip": "arm"}
    problem["costs"] = [{"type": "joint_vel", "params": {"coeffs": [1]}} for _ in range(MANY // 8)]


def _deep(request: Any) -> None:
    request.ClearField("goal")
    inner: dict[str, Any] = {"n_steps": 10}
    for _ in range(28):  # deeper, and no message can be read any more
        inner = {"a": inner}
    request.task.trajopt.update(inner)


def _header(suffix: str = "xyz", **more: Any) -> wire.UploadCloudRequest:
    return wire.UploadCloudRequest(header={"format": suffix, **more})  # type: ignore[arg-type]


def _chunk(data: bytes) -> wire.UploadCloudRequest:
    return wire.UploadCloudRequest(chunk=data)


def _upload(data: bytes, suffix: str = "xyz", **header: Any) -> list[Message]:
    return [_header(suffix, **header), _chunk(data)]
