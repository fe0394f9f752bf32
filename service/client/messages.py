"""What is sent, built from what a user has at hand."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping, Sequence
from os.path import isabs
from pathlib import Path
from types import MappingProxyType

from google.protobuf.message import Message

from service.client.clouds import is_sent
from service.client.connection import MAX_SENT_BYTES
from service.client.local import NOT_UPLOADED, cloud_problem
from service.errors import RequestError, shown
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneRequest,
    CloudsSpec,
    Decision,
    DetectRequest,
    KnownMesh,
    PlanRecord,
    PlanState,
    ReviewPlanRequest,
    VerifyRequest,
)
from service.proto.planner.v1.planner_pb2 import PlanRequest as PlanMessage
from service.proto.planner.v1.request_pb2 import CloudFile, MotionRequest
from service.proto.planner.v1.result_pb2 import FileChunk
from service.request.schema import PlanRequest
from service.result.folder import RESULT_NAME, ROBOT_NAME, TRAJECTORY_NAME, read_result
from service.wire.plain import fill
from service.wire.requests import request_to_message

Clouds = CloudsSpec | str | Path | Sequence[str | Path]
"""Clouds as the wire says them, or files here and ids of uploaded ones, in the world frame and metres."""

Meshes = Sequence[KnownMesh | str | Path]
"""Known objects as the wire says them, or files that are looked for everywhere in metres; those here are uploaded."""


def plan_message(
    request: PlanRequest | MotionRequest,
    request_id: str | None,
    with_files: bool,
    with_waypoints: bool,
) -> PlanMessage:
    """A request with an id, which makes it safe to ask again."""
    return PlanMessage(
        request_id=request_id or str(uuid.uuid4()),
        request=request if isinstance(request, MotionRequest) else request_to_message(request),
        with_files=with_files,
        with_waypoints=with_waypoints,
    )


def scene_message(
    clouds: CloudsSpec,
    detect: Iterable[str],
    hint: Sequence[float] | None,
    unknown: str | None,
    method: str | None,
    meshes: Meshes = (),
    update: str | Path | None = None,
    ids: Mapping[str, str] = MappingProxyType({}),
) -> BuildSceneRequest:
    """
    Args:
        ids: of meshes and of the scene to update that were uploaded, by the name they are given.

    Raises:
        RequestError: an option has a value that it cannot have.
    """
    known = [_named(one, ids) for one in meshes]
    before = None if update is None else ids.get(str(update), str(update))
    message = BuildSceneRequest(clouds=clouds, meshes=known, update=before)
    asked = {"detect": list(detect), "hint": list(hint or ()), "unknown": unknown, "method": method}
    fill(message, asked)
    return message


def detect_message(clouds: CloudsSpec, kind: str, hint: Sequence[float] | None) -> DetectRequest:
    """Objects of a kind in clouds."""
    return DetectRequest(clouds=clouds, kind=kind, hint=hint or ())


def local_cloud_files(clouds: Clouds) -> dict[str, Path]:
    """Those that are files here, by the name they are given.

    Raises:
        RequestError: one starts here and is not here.
    """
    if isinstance(clouds, CloudsSpec):
        return {}
    names = [str(cloud) for cloud in _listed(clouds)]
    found = [cloud_problem(f"clouds[{index}]", name, Path(name)) for index, name in enumerate(names)]
    problems = [problem for problem in found if problem]
    if problems:
        raise RequestError(problems)
    return {name: Path(name) for name in names if Path(name).is_file()}


def local_known_files(meshes: Meshes, update: str | Path | None) -> dict[str, Path]:
    """Meshes and the scene to update that are files here, by the name they are given.

    Raises:
        RequestError: one starts here and is not here, or cannot be uploaded.
    """
    named = {f"meshes[{k}].file": _as_mesh(one).file for k, one in enumerate(meshes)}
    not_sent = {field: name for field, name in named.items() if Path(name).is_file() and not is_sent(name)}
    sent = {field: name for field, name in named.items() if field not in not_sent}
    sent |= {} if update is None else {"update": str(update)}
    problems = [cloud_problem(field, name, Path(name)) for field, name in sent.items()]
    problems += [f"{field}: {shown(name)}: {NOT_UPLOADED}" for field, name in not_sent.items() if not isabs(name)]
    told = [problem for problem in problems if problem]
    if told:
        raise RequestError(told)
    return {name: Path(name) for name in sent.values() if Path(name).is_file()}


def _as_mesh(mesh: KnownMesh | str | Path) -> KnownMesh:
    return mesh if isinstance(mesh, KnownMesh) else KnownMesh(file=str(mesh))


def _named(mesh: KnownMesh | str | Path, ids: Mapping[str, str]) -> KnownMesh:
    """The mesh by its id, if it was uploaded, and then with the name of its file."""
    known = KnownMesh()
    known.CopyFrom(_as_mesh(mesh))
    if known.file in ids:
        if not known.name:
            known.name = Path(known.file).stem
        known.file = ids[known.file]
    return known


def clouds_message(clouds: Clouds, ids: dict[str, str]) -> CloudsSpec:
    """The clouds, those in ``ids`` named by their id."""
    if isinstance(clouds, CloudsSpec):
        return clouds
    names = [str(cloud) for cloud in _listed(clouds)]
    return CloudsSpec(clouds=[CloudFile(file=ids.get(name, name)) for name in names])


def check_size(message: Message) -> None:
    """
    Raises:
        RequestError: no server takes as much at once.
    """
    n_bytes = message.ByteSize()
    if n_bytes <= MAX_SENT_BYTES:
        return
    words = f"{_mib(n_bytes)} to send; a server takes at most {_mib(MAX_SENT_BYTES)} at once"
    if isinstance(message, VerifyRequest) and message.files:
        largest = max(message.files, key=lambda file: len(file.data))
        words = f"files: {words}, and {largest.path} alone has {_mib(len(largest.data))}; verify the folder here, or "
        words += "ask by the plan's id"
    raise RequestError(words)


def verify_message(plan: str | Path) -> VerifyRequest:
    """A plan by its id (a text), or a result folder here (a path) with the files that tell its motion.

    Raises:
        ResultError: it is no result folder.
    """
    if isinstance(plan, str):
        return VerifyRequest(plan_id=plan)
    read_result(plan)
    paths = [plan / RESULT_NAME, plan / TRAJECTORY_NAME, *sorted((plan / ROBOT_NAME).rglob("*"))]
    return VerifyRequest(
        files=[
            FileChunk(path=path.relative_to(plan).as_posix(), data=path.read_bytes(), is_last=True)
            for path in paths
            if path.is_file()
        ]
    )


def review_message(seen: PlanRecord, is_accepted: bool, comment: str) -> ReviewPlanRequest:
    """A review of the very trajectory and certificate that were seen.

    Raises:
        RequestError: the plan has not finished.
    """
    if seen.state != PlanState.PLAN_STATE_FINISHED:
        raise RequestError(f"plan {seen.plan_id} is not finished; only a finished plan is reviewed")
    return ReviewPlanRequest(
        plan_id=seen.plan_id,
        decision=Decision.DECISION_ACCEPTED if is_accepted else Decision.DECISION_REJECTED,
        comment=comment,
        trajectory_sha256=seen.result.trajectory.sha256,
        certificate_sha256=seen.result.certificate.sha256,
    )


def _mib(n_bytes: int) -> str:
    return f"{n_bytes / 2**20:.1f} MiB"


def _listed(clouds: str | Path | Sequence[str | Path]) -> Sequence[str | Path]:
    return (clouds,) if isinstance(clouds, str | Path) else clouds
