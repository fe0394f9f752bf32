"""The client for asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Iterable, Sequence
from contextlib import aclosing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import grpc
from google.protobuf.message import Message

from service.client.answers import FinishedPlan, PlanReader, SceneReader, StoredPlan, StoredReader
from service.client.clouds import CloudParts, cloud_to_send, local_files, with_ids
from service.client.connection import OPTIONS
from service.client.errors import planner_error
from service.client.local import askable
from service.client.messages import (
    Clouds,
    Meshes,
    check_size,
    clouds_message,
    detect_message,
    local_cloud_files,
    local_known_files,
    plan_message,
    review_message,
    scene_message,
    verify_message,
)
from service.client.names import of_upload
from service.client.received import received_files
from service.client.retry import Attempts
from service.client.settings import ClientSettings
from service.client.steps import LastStep
from service.proto.planner.v1.planner_pb2 import (
    BuiltScene,
    CloudsSpec,
    DetectResponse,
    GetPlanRequest,
    GetSceneRequest,
    GetSceneResponse,
    GetStatusRequest,
    GetStatusResponse,
    ListRobotsRequest,
    PlanRecord,
    PlanResponse,
    Review,
    RobotInfo,
    VerifyResponse,
)
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.schema import PlanRequest


class AsyncPlannerClient(ClientSettings):
    """Calls a planning server from one event loop; as ``PlannerClient``, whose docstrings say what the methods do.

    Every method raises ``PlannerError`` when the call comes to nothing, and ``RequestError`` for what is wrong before
    anything is sent. See ``ClientSettings`` for the arguments.
    """

    def __init__(self, target: str, **settings: Any) -> None:
        super().__init__(target, **settings)
        self._channel = (
            grpc.aio.insecure_channel(target, OPTIONS)
            if self._credentials is None
            else grpc.aio.secure_channel(target, self._credentials, OPTIONS)
        )
        self._stub = PlannerServiceStub(self._channel)  # type: ignore[no-untyped-call]

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Hang up; calls under way are cancelled."""
        await self._channel.close(None)

    async def plan(
        self,
        request: PlanRequest | MotionRequest,
        *,
        request_id: str | None = None,
        out: str | Path | None = None,
        on_progress: Callable[[PlanResponse], None] | None = None,
        with_waypoints: bool = False,
        deadline_s: float | None = None,
    ) -> FinishedPlan:
        """Have a request planned, and wait for the verdict; cancelling the task stops the plan."""
        folder = None if out is None else Path(out)
        with received_files(folder) as files:
            reader = PlanReader(files, folder)
            events = self.plan_events(
                request,
                request_id=request_id,
                with_files=files is not None,
                with_waypoints=with_waypoints,
                deadline_s=deadline_s,
            )
            async with aclosing(events):
                async for event in events:
                    reader.take(event)
                    if on_progress is not None and event.WhichOneof("event") not in ("finished", "file"):
                        on_progress(event)
            return reader.finished()

    async def plan_events(
        self,
        request: PlanRequest | MotionRequest,
        *,
        request_id: str | None = None,
        with_files: bool = False,
        with_waypoints: bool = False,
        deadline_s: float | None = None,
    ) -> AsyncGenerator[PlanResponse, None]:
        """All that the server tells of a plan; ``accepted`` comes first, and again when it was tried again.

        Closing the iterator stops the plan.
        """
        attempts = self._attempts(deadline_s)
        if isinstance(request, PlanRequest):
            request = await self.with_uploads(request, deadline_s=attempts.timeout_s)
        message = plan_message(request, request_id, with_files, with_waypoints)
        async with aclosing(self._stream("Plan", message, attempts)) as events:
            async for event in events:
                yield event

    async def with_uploads(self, request: PlanRequest, *, deadline_s: float | None = None) -> PlanRequest:
        """The request, its clouds and its scene that are files of this machine uploaded and named by their ids.

        Its other paths that start here are told from the root where the server is this machine.
        """
        request = askable(request, self._connection.is_this_machine)
        attempts = self._attempts(deadline_s)
        ids = {
            name: await self.upload_cloud(path, deadline_s=attempts.timeout_s)
            for name, path in local_files(request).items()
        }
        return with_ids(request, ids)

    async def upload_cloud(self, path: str | Path, *, deadline_s: float | None = None) -> str:
        """Bring a cloud; returns its id. One that the server has is recognised by its hash and not sent again."""
        cloud = await asyncio.to_thread(cloud_to_send, path)
        attempts = self._attempts(self._upload_time_s(cloud) if deadline_s is None else deadline_s)
        while True:
            parts = CloudParts(cloud)
            try:
                answer = await self._stub.UploadCloud(parts, **self._call_options(attempts))
            except grpc.RpcError as error:
                if parts.error is not None:
                    raise parts.error from None
                delay = self._wait_s(attempts, of_upload(planner_error(error), cloud.path))
            else:
                self._names.remember(answer.cloud_id, cloud.path)
                return str(answer.cloud_id)
            await asyncio.sleep(delay)

    async def build_scene(
        self,
        clouds: Clouds,
        *,
        detect: Iterable[str] = (),
        hint: Sequence[float] | None = None,
        unknown: str | None = None,
        method: str | None = None,
        meshes: Meshes = (),
        update: str | Path | None = None,
        on_step: Callable[[str], None] | None = None,
        deadline_s: float | None = None,
    ) -> BuiltScene:
        """Turn clouds into pieces, floor and objects; the options are those of ``scopt scene``.

        Meshes are known objects; ``update`` is an earlier scene, a file here or its id. Files here are uploaded.
        """
        files = local_known_files(meshes, update)
        ids = {name: await self.upload_cloud(path) for name, path in files.items()}
        given = await self._clouds(clouds)
        message = scene_message(given, detect, hint, unknown, method, meshes, update, ids)
        reader = SceneReader()
        async with aclosing(self._stream("BuildScene", message, self._attempts(deadline_s))) as events:
            async for event in events:
                reader.take(event)
                if on_step is not None and event.step:
                    on_step(event.step)
        return reader.finished()

    async def get_scene(self, scene_id: str) -> BuiltScene:
        """A scene that was built before, also before the server was restarted."""
        stored: GetSceneResponse = await self._ask("GetScene", GetSceneRequest(scene_id=scene_id), self._timeout_s)
        return stored.scene

    async def detect(
        self, clouds: Clouds, kind: str, *, hint: Sequence[float] | None = None, deadline_s: float | None = None
    ) -> DetectResponse:
        """Find objects of a kind, best first."""
        message = detect_message(await self._clouds(clouds), kind, hint)
        found: DetectResponse = await self._ask("Detect", message, deadline_s)
        return found

    async def verify(self, plan: str | Path, *, deadline_s: float | None = None) -> VerifyResponse:
        """Have a motion checked anew: that of a plan by its id (a text), or of a result folder here (a path)."""
        checked: VerifyResponse = await self._ask("Verify", verify_message(plan), deadline_s)
        return checked

    async def robots(self) -> tuple[RobotInfo, ...]:
        """The robots that can be named."""
        return tuple((await self._ask("ListRobots", ListRobotsRequest(), self._timeout_s)).robots)

    async def get_plan(
        self, plan_id: str, *, out: str | Path | None = None, deadline_s: float | None = None
    ) -> StoredPlan:
        """A plan and its reviews; with ``out``, its files are put into that folder."""
        folder = None if out is None else Path(out)
        message = GetPlanRequest(plan_id=plan_id, with_files=out is not None)
        attempts = self._attempts(self._timeout_s if deadline_s is None else deadline_s)
        with received_files(folder) as files:
            reader = StoredReader(files, folder)
            async with aclosing(self._stream("GetPlan", message, attempts)) as parts:
                async for part in parts:
                    reader.take(part)
            return reader.finished()

    async def review(self, seen: PlanRecord, *, accept: bool, comment: str = "") -> Review:
        """Accept or reject the very trajectory and certificate that ``get_plan`` has shown."""
        message = review_message(seen, accept, comment)
        review: Review = (await self._ask("ReviewPlan", message, self._timeout_s, is_repeatable=False)).review
        return review

    async def status(self) -> GetStatusResponse:
        """What the server is doing."""
        status: GetStatusResponse = await self._ask("GetStatus", GetStatusRequest(), self._timeout_s)
        return status

    async def _clouds(self, clouds: Clouds) -> CloudsSpec:
        ids = {name: await self.upload_cloud(path) for name, path in local_cloud_files(clouds).items()}
        return clouds_message(clouds, ids)

    async def _ask(self, method: str, message: Message, deadline_s: float | None, is_repeatable: bool = True) -> Any:
        check_size(message)
        attempts = self._attempts(deadline_s, is_repeatable)
        while True:
            try:
                return await getattr(self._stub, method)(message, **self._call_options(attempts))
            except grpc.RpcError as error:
                delay = self._wait_s(attempts, planner_error(error))
            await asyncio.sleep(delay)

    async def _stream(self, method: str, message: Message, attempts: Attempts) -> AsyncGenerator[Any, None]:
        check_size(message)
        step = LastStep()
        while True:
            call = getattr(self._stub, method)(message, **self._call_options(attempts))
            try:
                async for event in call:
                    step.take(event)
                    yield event
                return
            except grpc.RpcError as error:
                delay = self._wait_s(attempts, planner_error(error), step)
            finally:
                call.cancel()
            await asyncio.sleep(delay)
