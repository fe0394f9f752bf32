"""Messages of the calls, built from the arguments of the clients."""

from __future__ import annotations

import uuid
from collections.abc import AsyncIterable, AsyncIterator, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from types import MappingProxyType

from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from service.client.connection import MAX_SENT_BYTES
from service.client.known_objects import find_files, replace_by_id
from service.errors import RequestError, shown, would_do
from service.proto.planner.v1.execution_pb2 import CommandRequest, Order
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneRequest,
    CloudsSpec,
    Decision,
    DetectRequest,
    KnownMesh,
    ListPlansRequest,
    ListScenesRequest,
    PlanRecord,
    PlanState,
    Priority,
    ReviewPlanRequest,
    SimulatePlanRequest,
    VerifyRequest,
)
from service.proto.planner.v1.planner_pb2 import PlanRequest as PlanMessage
from service.proto.planner.v1.pose_pb2 import OpenPoseSession, PoseEvent, PoseSessionRequest
from service.proto.planner.v1.request_pb2 import CloudFile, MotionRequest
from service.proto.planner.v1.result_pb2 import FileChunk, Verdict
from service.request.formats import FORMAT
from service.request.schema import PlanRequest
from service.result.folder import RESULT_NAME, ROBOT_NAME, TRAJECTORY_NAME, read_result
from service.wire.plain import fill
from service.wire.requests import request_to_message

DAY_S = 86400.0
Clouds = CloudsSpec | str | Path | Sequence[str | Path]
"""A message, or local files and ids of uploads, in the world frame and metres."""


def make_plan_message(
    request: PlanRequest | MotionRequest,
    request_id: str | None,
    with_files: bool,
    with_waypoints: bool,
    is_batch: bool = False,
    is_direct: bool = False,
) -> PlanMessage:
    """Return the message of a request, with an id under which it can be sent again."""
    return PlanMessage(
        request_id=request_id or str(uuid.uuid4()),
        request=request if isinstance(request, MotionRequest) else request_to_message(request),
        with_files=with_files,
        known_format=FORMAT if with_files else 0,
        with_waypoints=with_waypoints,
        priority=Priority.PRIORITY_BATCH if is_batch else Priority.PRIORITY_INTERACTIVE,
        is_direct=is_direct,
    )


PoseEvents = Iterable[PoseEvent] | AsyncIterable[PoseEvent]
"""Events of a pose session, as the operator makes them."""


def make_pose_messages(
    request: PlanRequest | MotionRequest, events: PoseEvents, with_drawing: bool
) -> Iterator[PoseSessionRequest] | AsyncIterator[PoseSessionRequest]:
    """Return the messages of a pose session: it is opened, then every event is sent as it comes."""
    message = request if isinstance(request, MotionRequest) else request_to_message(request)
    first = PoseSessionRequest(open=OpenPoseSession(request=message, with_drawing=with_drawing))
    return _follow_later(first, events) if isinstance(events, AsyncIterable) else _follow(first, events)


def _follow(first: PoseSessionRequest, events: Iterable[PoseEvent]) -> Iterator[PoseSessionRequest]:
    yield first
    for event in events:
        yield PoseSessionRequest(event=event)


async def _follow_later(
    first: PoseSessionRequest, events: AsyncIterable[PoseEvent]
) -> AsyncIterator[PoseSessionRequest]:
    yield first
    async for event in events:
        yield PoseSessionRequest(event=event)


def make_scene_message(
    clouds: CloudsSpec,
    detect: Iterable[str],
    hint: Sequence[float] | None,
    unknown: str | None,
    method: str | None,
    meshes: Sequence[KnownMesh] = (),
    update: str | Path | None = None,
    ids: Mapping[str, str] = MappingProxyType({}),
) -> BuildSceneRequest:
    """Return the message of a scene to build.

    Args:
        ids: ids of the uploaded meshes and of the uploaded scene to update, by the names of their files.

    Raises:
        RequestError: an option has a wrong value.
    """
    known = [replace_by_id(mesh, ids) for mesh in meshes]
    before = None if update is None else ids.get(str(update), str(update))
    message = BuildSceneRequest(clouds=clouds, meshes=known, update=before)
    fill(message, {"detect": list(detect), "hint": list(hint or ()), "unknown": unknown, "method": method})
    return message


def make_detect_message(
    clouds: CloudsSpec,
    kind: str,
    hint: Sequence[float] | None,
    objects: Sequence[KnownMesh] = (),
    ids: Mapping[str, str] = MappingProxyType({}),
) -> DetectRequest:
    """Return the message of a detection.

    Args:
        ids: ids of the uploaded objects, by the names of their files.
    """
    given = [replace_by_id(item, ids) for item in objects]
    return DetectRequest(clouds=clouds, kind=kind, hint=hint or (), objects=given)


def find_cloud_files(clouds: Clouds) -> dict[str, Path]:
    """Return the local cloud files, by their names in ``clouds``.

    Raises:
        RequestError: a relative path does not exist, or is a folder.
    """
    if isinstance(clouds, CloudsSpec):
        return {}
    return find_files({f"clouds[{index}]": name for index, name in enumerate(_names(clouds))})


def make_clouds_message(clouds: Clouds, ids: dict[str, str]) -> CloudsSpec:
    """Return the message of clouds, with the ids of uploads in place of their files' names."""
    if isinstance(clouds, CloudsSpec):
        return clouds
    return CloudsSpec(clouds=[CloudFile(file=ids.get(name, name)) for name in _names(clouds)])


def check_size(message: Message) -> None:
    """
    Raises:
        RequestError: the message is larger than any server accepts.
    """
    n_bytes = message.ByteSize()
    if n_bytes <= MAX_SENT_BYTES:
        return
    problem = f"the message has {_mib(n_bytes)}; a server accepts at most {_mib(MAX_SENT_BYTES)}"
    if isinstance(message, VerifyRequest | SimulatePlanRequest) and message.files:
        largest = max(message.files, key=lambda file: len(file.data))
        problem = (
            f"files: {problem} and {largest.path} alone has {_mib(len(largest.data))}; verify the folder here, or "
        )
        problem += "give the plan's id"
    raise RequestError(problem)


def make_verify_message(plan: str | Path) -> VerifyRequest:
    """Return the message for a plan's id (str), or for a local result folder (``Path``) with the files of its motion.

    Raises:
        ResultError: the folder is no result folder.
    """
    return VerifyRequest(plan_id=plan) if isinstance(plan, str) else VerifyRequest(files=_read_motion_files(plan))


def make_simulation_message(plan: str | Path, options: Mapping[str, float]) -> SimulatePlanRequest:
    """Return the message for a plan's id (str), or for a local result folder (``Path``), with options by field name.

    Raises:
        ResultError: the folder is no result folder.
        RequestError: an option is unknown.
    """
    message = SimulatePlanRequest(plan_id=plan) if isinstance(plan, str) else SimulatePlanRequest()
    known = sorted(set(SimulatePlanRequest.DESCRIPTOR.fields_by_name) - {"plan_id", "files"})
    for name, value in options.items():
        if name not in known:
            raise RequestError(f"{name}: unknown option of a simulation; expected {', '.join(known)}")
        setattr(message, name, value)
    if isinstance(plan, Path):
        message.files.extend(_read_motion_files(plan))
    return message


def _read_motion_files(folder: Path) -> list[FileChunk]:
    """Return the files of a result folder that describe its motion (ResultError where it is no result folder)."""
    read_result(folder)
    paths = [folder / RESULT_NAME, folder / TRAJECTORY_NAME, *sorted((folder / ROBOT_NAME).rglob("*"))]
    return [
        FileChunk(path=path.relative_to(folder).as_posix(), data=path.read_bytes(), is_last=True)
        for path in paths
        if path.is_file()
    ]


def make_list_message(state: str, since: datetime | None, task: str, needs_review: bool) -> ListPlansRequest:
    """Return the message for a list of plans.

    Raises:
        RequestError: ``state`` is no state of a plan.
    """
    names = [name.removeprefix("PLAN_STATE_").lower() for name in list(PlanState.keys())[1:]]
    if state and state not in names:
        raise RequestError(f"state: unknown state {shown(state)}; expected {would_do(state, names)}")
    return ListPlansRequest(
        state=f"PLAN_STATE_{state.upper()}" if state else None,
        since=_stamp(since),
        task=task,
        needs_review=needs_review,
    )


def make_scene_list_message(since: datetime | None) -> ListScenesRequest:
    """Return the message for a list of scenes."""
    return ListScenesRequest(since=_stamp(since))


def _stamp(time: datetime | None) -> Timestamp | None:
    """Return the message of a time, which is UTC unless it says otherwise."""
    if time is None:
        return None
    stamp = Timestamp()
    stamp.FromDatetime(time)
    return stamp


def make_command_message(
    order: str, lease: str, revision: int, speed: float, link: str = "", offset_m: Iterable[float] = ()
) -> CommandRequest:
    """Return the message of an order by its name, such as ``pause``.

    Raises:
        RequestError: there is no such order, or a value belongs to another one.
    """
    names = [name.removeprefix("ORDER_").lower() for name in list(Order.keys())[1:]]
    if order not in names:
        raise RequestError(f"order: unknown order {shown(order)}; expected {would_do(order, names)}")
    if speed and order != "speed":
        raise RequestError(f"speed: is of the order speed, and this is {order}")
    if link and order != "shift":
        raise RequestError(f"link: is of the order shift, and this is {order}")
    return CommandRequest(
        order=f"ORDER_{order.upper()}",
        lease=lease,
        expected_revision=revision,
        speed=speed,
        link=link,
        offset_m=offset_m,
    )


def make_review_message(
    seen: PlanRecord, is_accepted: bool, comment: str, despite: str = "", valid_days: float | None = None
) -> ReviewPlanRequest:
    """Return the review of exactly the trajectory, certificate, page and verdict of a record.

    Raises:
        RequestError: the plan has not finished, ``despite`` is no verdict, or something belongs to acceptances only.
    """
    if seen.state != PlanState.PLAN_STATE_FINISHED:
        raise RequestError(f"plan {seen.plan_id} is not finished; expected a finished plan")
    if not is_accepted and (despite or valid_days is not None):
        raise RequestError(f"{'despite' if despite else 'valid_days'}: is of an acceptance, and this is a rejection")
    names = [name.removeprefix("VERDICT_") for name in list(Verdict.keys())[1:]]
    if despite and despite not in names:
        raise RequestError(f"despite: unknown verdict {shown(despite)}; expected {would_do(despite, names)}")
    return ReviewPlanRequest(
        plan_id=seen.plan_id,
        decision=Decision.DECISION_ACCEPTED if is_accepted else Decision.DECISION_REJECTED,
        comment=comment,
        trajectory_sha256=seen.result.trajectory.sha256,
        certificate_sha256=seen.result.certificate.sha256,
        page_sha256=seen.page_sha256,
        verdict=seen.result.verdict,
        despite=f"VERDICT_{despite}" if despite else None,
        valid_s=None if valid_days is None else valid_days * DAY_S,
    )


def _mib(n_bytes: int) -> str:
    return f"{n_bytes / 2**20:.1f} MiB"


def _names(clouds: str | Path | Sequence[str | Path]) -> list[str]:
    return [str(cloud) for cloud in ((clouds,) if isinstance(clouds, str | Path) else clouds)]
