"""Asyncio client, which holds every call of the planning service."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Callable, Iterable, Mapping, Sequence
from contextlib import aclosing
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Self

import grpc
from google.protobuf.message import Message

from service.client.answers import FinishedPlan, PlanReader, SceneReader, StoredPlan, StoredReader, WatchReader
from service.client.connection import Connection
from service.client.error_texts import LastStep, UploadNames, explain_unreachable, name_uploaded_file
from service.client.errors import PlannerError, read_error
from service.client.known_objects import Objects, find_object_files, make_object_messages
from service.client.local_files import UploadParts, find_local_files, hash_file, replace_by_ids, resolve_paths
from service.client.messages import (
    Clouds,
    PoseEvents,
    check_size,
    find_cloud_files,
    make_clouds_message,
    make_command_message,
    make_detect_message,
    make_list_message,
    make_plan_message,
    make_pose_messages,
    make_review_message,
    make_scene_list_message,
    make_scene_message,
    make_simulation_message,
    make_verify_message,
)
from service.client.received import receive_files
from service.client.retry import Attempts, Retry, check_seconds
from service.client.transport import AsyncTransport, Transport
from service.errors import RequestError
from service.proto.planner.v1.execution_pb2 import (
    CommandRequest,
    CommandResponse,
    ExecuteRequest,
    ExecuteResponse,
    Order,
    WatchRequest,
    WatchResponse,
)
from service.proto.planner.v1.planner_pb2 import (
    BuiltScene,
    CloudsSpec,
    Decision,
    DetectResponse,
    GetPlanRequest,
    GetSceneRequest,
    GetSceneResponse,
    GetStatusRequest,
    GetStatusResponse,
    ListPlansRequest,
    ListRobotsRequest,
    ListScenesRequest,
    PlanRecord,
    PlanResponse,
    PlanSummary,
    Review,
    RobotInfo,
    SceneSummary,
    SimulatePlanResponse,
    VerifyResponse,
)
from service.proto.planner.v1.pose_pb2 import PoseSessionResponse
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.formats import FORMAT
from service.request.schema import PlanRequest

SLOWEST_UPLOAD = 1e6  # [bytes/s]
PAGE_SIZE = 100  # of lists


class AsyncPlannerClient:
    """Asyncio client of a planning server, for one event loop; made inside of a coroutine.

    Every method raises ``PlannerError`` for a failed call, and ``RequestError`` for wrong arguments before anything is
    sent. Cancelling a task cancels its call on the server.
    """

    _transport_type: ClassVar[type[Transport]] = AsyncTransport

    def __init__(
        self,
        target: str,
        *,
        tls_ca: str | Path | None = None,
        tls_cert: str | Path | None = None,
        tls_key: str | Path | None = None,
        token: str | None = None,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        on_retry: Callable[[PlannerError, float], None] | None = None,
    ) -> None:
        """Open a channel; the server is reached by the first call.

        Args:
            target: ``HOST:PORT`` or ``unix:PATH``.
            tls_ca: PEM file of the authority that the server's certificate comes from; the system's authorities by
                default. Any of the three TLS files turns TLS on.
            tls_cert: PEM file of the client's certificate, for servers that require one; needs ``tls_key``.
            tls_key: PEM file of its unencrypted private key.
            token: bearer token of the client; without TLS it is only sent to this machine.
            timeout_s: limit [s] of calls that answer at once, and of uploads in addition to their size at 1 MB/s.
                Planning, scenes, detection and verification have the server's limits or their ``deadline_s``.
            retry: number of attempts and delays between them; ``Retry()`` by default.
            on_retry: called with the error and the delay [s] before another attempt.

        Raises:
            TypeError: an argument is unknown or of a wrong type.
            RequestError: the values contradict each other, or a file cannot be read.
        """
        check_seconds("timeout_s", timeout_s)
        self._connection = Connection(target, tls_ca, tls_cert, tls_key, token)
        self._transport = self._transport_type(self._connection)
        self._timeout_s = timeout_s
        self._retry = retry or Retry()
        self._on_retry = on_retry
        self._upload_names = UploadNames()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection; open calls are cancelled."""
        await self._transport.close()

    async def plan(
        self,
        request: PlanRequest | MotionRequest,
        *,
        request_id: str | None = None,
        out: str | Path | None = None,
        on_progress: Callable[[PlanResponse], None] | None = None,
        with_waypoints: bool = False,
        is_batch: bool = False,
        is_direct: bool = False,
        deadline_s: float | None = None,
    ) -> FinishedPlan:
        """Plan a request and wait for the verdict; an exception or a cancelled task in the meantime stops the plan.

        Args:
            request: local cloud, mesh and scene files that a ``PlanRequest`` names are uploaded first.
            request_id: an earlier request's id, to get that plan; by default a new one.
            out: folder for the result's files, as ``scopt plan`` writes it; by default none are sent.
            on_progress: called with the acceptance, the place in the queue, every step and every iteration.
            with_waypoints: whether iterations include their waypoints.
            is_batch: whether interactive requests go first.
            is_direct: whether it is a direct move, which waits for no decision.
            deadline_s: time limit [s] of uploads, queue and plan together; None for no limit.

        Raises:
            ResultError: ``out`` holds something other than an earlier result, or cannot be written.
        """
        folder = None if out is None else Path(out)
        with receive_files(folder) as files:
            reader = PlanReader(files, folder)
            events = self.plan_events(
                request,
                request_id=request_id,
                with_files=files is not None,
                with_waypoints=with_waypoints,
                is_batch=is_batch,
                is_direct=is_direct,
                deadline_s=deadline_s,
            )
            async with aclosing(events):
                async for event in events:
                    reader.take(event)
                    if on_progress is not None and event.WhichOneof("event") not in ("finished", "file"):
                        on_progress(event)
            return reader.finish()

    async def plan_events(
        self,
        request: PlanRequest | MotionRequest,
        *,
        request_id: str | None = None,
        with_files: bool = False,
        with_waypoints: bool = False,
        is_batch: bool = False,
        is_direct: bool = False,
        deadline_s: float | None = None,
    ) -> AsyncGenerator[PlanResponse, None]:
        """Yield every event of a plan, ``accepted`` first and again after each retry; closing the iterator stops it.

        The arguments are those of ``plan``; ``with_files`` asks for the result's files as events.
        """
        attempts = Attempts(self._retry, deadline_s)
        if isinstance(request, PlanRequest):
            request = await self.with_uploads(request, deadline_s=attempts.timeout_s)
        message = make_plan_message(request, request_id, with_files, with_waypoints, is_batch, is_direct)
        async with aclosing(self._stream("Plan", message, attempts)) as events:
            async for event in events:
                yield event

    async def with_uploads(self, request: PlanRequest, *, deadline_s: float | None = None) -> PlanRequest:
        """Upload a request's local clouds, meshes and scene; return the request with their ids.

        Its other relative paths become absolute if the server is this machine.
        """
        request = resolve_paths(request, self._connection.is_this_machine)
        attempts = Attempts(self._retry, deadline_s)
        ids = {
            name: await self.upload_cloud(path, deadline_s=attempts.timeout_s)
            for name, path in find_local_files(request).items()
        }
        return replace_by_ids(request, ids)

    async def upload_cloud(self, path: str | Path, *, deadline_s: float | None = None) -> str:
        """Upload a cloud, mesh or scene file and return its id; files the server has are not sent again.

        Args:
            deadline_s: time limit [s]; by default ``timeout_s`` and 1 s per MB.
        """
        upload = await self._transport.run(hash_file, path)
        upload_time_s = self._timeout_s + upload.n_bytes / SLOWEST_UPLOAD
        attempts = Attempts(self._retry, upload_time_s if deadline_s is None else deadline_s)
        while True:
            parts = UploadParts(upload)
            try:
                answer = await self._transport.call("UploadCloud", parts, attempts.start())
            except grpc.RpcError as error:
                if parts.error is not None:
                    raise parts.error from None
                delay_s = self._use_attempt(attempts, name_uploaded_file(read_error(error), upload.path))
            else:
                self._upload_names.add(answer.cloud_id, upload.path)
                return str(answer.cloud_id)
            await self._transport.sleep(delay_s)

    async def build_scene(
        self,
        clouds: Clouds,
        *,
        detect: Iterable[str] = (),
        hint: Sequence[float] | None = None,
        unknown: str | None = None,
        method: str | None = None,
        meshes: Objects = (),
        update: str | Path | None = None,
        on_step: Callable[[str], None] | None = None,
        deadline_s: float | None = None,
    ) -> BuiltScene:
        """Turn clouds into pieces, floor and objects, with the options of ``scopt scene``.

        Args:
            clouds: local files, which are uploaded, ids of uploads, or a ``CloudsSpec``.
            meshes: known objects: local files, which are uploaded, ids, lines of parameters, or ``KnownMesh``.
            update: earlier scene to update: a local file or its id.
            on_step: called with the name of each step.
            deadline_s: time limit [s] after the uploads; None for no limit.
        """
        known = make_object_messages(meshes, "meshes")
        ids = await self._upload_files(find_object_files(known, "meshes", update))
        spec = await self._upload_clouds(clouds)
        message = make_scene_message(spec, detect, hint, unknown, method, known, update, ids)
        reader = SceneReader()
        async with aclosing(self._stream("BuildScene", message, Attempts(self._retry, deadline_s))) as events:
            async for event in events:
                reader.take(event)
                if on_step is not None and event.step:
                    on_step(event.step)
        return reader.finish()

    async def get_scene(self, scene_id: str) -> BuiltScene:
        """Return a scene that was built before, also before the server was restarted."""
        reply: GetSceneResponse = await self._call("GetScene", GetSceneRequest(scene_id=scene_id), self._timeout_s)
        return reply.scene

    async def detect(
        self,
        clouds: Clouds,
        kind: str,
        *,
        hint: Sequence[float] | None = None,
        objects: Objects = (),
        deadline_s: float | None = None,
    ) -> DetectResponse:
        """Find objects of a kind, best first.

        Args:
            kind: as for ``scopt detect``; ``object`` for the given objects.
            hint: a position near the object in the world frame [m].
            objects: with kind ``object``: lines such as ``wheel radius=0.3 rim_radius=0.02 spokes=5``, local mesh and
                object files, ids of uploads, or ``KnownMesh``.
        """
        given = make_object_messages(objects, "objects")
        ids = await self._upload_files(find_object_files(given, "objects"))
        message = make_detect_message(await self._upload_clouds(clouds), kind, hint, given, ids)
        reply: DetectResponse = await self._call("Detect", message, deadline_s)
        return reply

    async def verify(self, plan: str | Path, *, deadline_s: float | None = None) -> VerifyResponse:
        """Verify a motion again: that of a plan on the server (id as str) or of a local result folder (``Path``)."""
        reply: VerifyResponse = await self._call("Verify", make_verify_message(plan), deadline_s)
        return reply

    async def simulate(
        self, plan: str | Path, options: Mapping[str, float] | None = None, *, deadline_s: float | None = None
    ) -> SimulatePlanResponse:
        """Carry out a motion in physics: that of a plan on the server (id as str) or of a local folder (``Path``).

        ``options`` are the fields of ``SimulatePlanRequest``: friction, feed_forward, stiffness_scale, noise, delay_ms,
        joint_friction, seed, perturb, hand_friction.
        """
        message = make_simulation_message(plan, options or {})
        reply: SimulatePlanResponse = await self._call("SimulatePlan", message, deadline_s)
        return reply

    async def robots(self) -> tuple[RobotInfo, ...]:
        """Return the robots that a request can name."""
        return tuple((await self._call("ListRobots", ListRobotsRequest(), self._timeout_s)).robots)

    async def get_plan(
        self, plan_id: str, *, out: str | Path | None = None, deadline_s: float | None = None
    ) -> StoredPlan:
        """Return a plan and its reviews; with ``out``, write its files into that folder."""
        folder = None if out is None else Path(out)
        message = GetPlanRequest(plan_id=plan_id, with_files=out is not None, known_format=FORMAT)
        attempts = Attempts(self._retry, self._timeout_s if deadline_s is None else deadline_s)
        with receive_files(folder) as files:
            reader = StoredReader(files, folder)
            async with aclosing(self._stream("GetPlan", message, attempts)) as parts:
                async for part in parts:
                    reader.take(part)
            return reader.finish()

    async def list_plans(
        self,
        *,
        state: str = "",
        since: datetime | None = None,
        task: str = "",
        needs_review: bool = False,
        limit: int | None = None,
    ) -> AsyncGenerator[PlanSummary, None]:
        """Yield stored plans, newest first: the client's own, or those of all for the roles review and admin.

        Args:
            state: ``queued``, ``running``, ``finished`` or ``lost``; empty for any.
            since: when their requests were accepted, at the earliest; UTC unless it says otherwise.
            task: kind of task; empty for any.
            needs_review: only those that wait for a decision.
            limit: greatest number of plans; None for all.
        """
        message = make_list_message(state, since, task, needs_review)
        async for plan in self._pages("ListPlans", message, "plans", limit):
            yield plan

    async def list_scenes(
        self, *, since: datetime | None = None, limit: int | None = None
    ) -> AsyncGenerator[SceneSummary, None]:
        """Yield stored scenes, newest first: the client's own, or those of all for the roles review and admin.

        Args:
            since: when they were built, at the earliest; UTC unless it says otherwise.
            limit: greatest number of scenes; None for all.
        """
        async for scene in self._pages("ListScenes", make_scene_list_message(since), "scenes", limit):
            yield scene

    async def _pages(
        self, method: str, message: ListPlansRequest | ListScenesRequest, field: str, limit: int | None
    ) -> AsyncGenerator[Any, None]:
        """Yield the entries of all pages, ``limit`` at most."""
        n_left = math.inf if limit is None else limit
        while n_left > 0:
            message.page_size = int(min(n_left, PAGE_SIZE))
            page = await self._call(method, message, self._timeout_s)
            for entry in getattr(page, field):
                yield entry
            n_left -= len(getattr(page, field))
            message.page_token = page.next_page_token
            if not page.next_page_token:
                return

    async def review(
        self, seen: PlanRecord, *, accept: bool, comment: str = "", despite: str = "", valid_days: float | None = None
    ) -> Review:
        """Accept or reject exactly the trajectory, certificate, page and verdict of the record of ``get_plan``.

        Args:
            seen: record of the plan.
            accept: whether the robot may carry it out.
            comment: reason of the decision.
            despite: the plan's verdict, to accept a plan that is not ``CERTIFIED``.
            valid_days: validity of an acceptance; None for the server's 30 days.
        """
        message = make_review_message(seen, accept, comment, despite, valid_days)
        review: Review = (await self._call("ReviewPlan", message, self._timeout_s, is_repeatable=False)).review
        return review

    async def revoke(self, seen: PlanRecord, *, comment: str = "") -> Review:
        """Withdraw the approval of a plan.

        Raises:
            RequestError: the newest review of the record accepts nothing.
        """
        if not seen.reviews or seen.reviews[-1].decision != Decision.DECISION_ACCEPTED:
            raise RequestError(f"plan {seen.plan_id} is not approved; there is nothing to revoke")
        return await self.review(seen, accept=False, comment=comment)

    async def pose_session(
        self,
        request: PlanRequest | MotionRequest,
        events: PoseEvents,
        *,
        with_drawing: bool = False,
        deadline_s: float | None = None,
    ) -> AsyncGenerator[PoseSessionResponse, None]:
        """Yield ``opened``, then a pose for every event of an operator; closing the iterator ends the session.

        Args:
            request: robot, surroundings and first pose; local files that a ``PlanRequest`` names are uploaded first.
            events: with growing numbers, each as the operator makes it; asynchronous for this client, an iterator that
                may wait for the blocking one. Its end ends the session.
            with_drawing: whether ``opened`` has the robot's shapes.
            deadline_s: time limit [s] of the whole session; None for no limit.
        """
        if isinstance(request, PlanRequest):
            request = await self.with_uploads(request)
        messages = make_pose_messages(request, events, with_drawing)
        attempts = Attempts(self._retry, deadline_s, is_repeatable=False)
        try:
            async with aclosing(self._transport.stream("PoseSession", messages, attempts.start())) as answers:
                async for answer in answers:
                    yield answer
        except grpc.RpcError as error:
            self._use_attempt(attempts, read_error(error))

    async def take_control(self, station: str = "", *, takes_over: bool = False) -> CommandResponse:
        """Take control of the server's robot; returns the lease that orders name, and the revision.

        Args:
            station: what others are told beside the client's name, such as ``console``.
            takes_over: whether to take it from whoever has it.
        """
        order = Order.ORDER_TAKE_OVER if takes_over else Order.ORDER_TAKE_CONTROL
        message = CommandRequest(order=order, station=station)
        response: CommandResponse = await self._call("Command", message, self._timeout_s, is_repeatable=False)
        return response

    async def command(
        self,
        order: str,
        *,
        lease: str = "",
        revision: int = 0,
        speed: float = 0.0,
        link: str = "",
        offset_m: Iterable[float] = (),
    ) -> CommandResponse:
        """Give the server's robot an order.

        Args:
            order: ``start``, ``pause``, ``resume``, ``stop``, ``abort``, ``speed``, ``shift`` or ``release_control``.
            lease: from ``take_control``; to stop it needs none.
            revision: of the state that the operator has seen.
            speed: with ``speed``, share of real time.
            link: with ``shift``, the foot or hand.
            offset_m: with ``shift``, displacement of its target from the plan, in world axes [m].
        """
        message = make_command_message(order, lease, revision, speed, link, offset_m)
        response: CommandResponse = await self._call("Command", message, self._timeout_s, is_repeatable=False)
        return response

    async def execute(
        self,
        plan_id: str,
        trajectory_sha256: str,
        *,
        lease: str,
        revision: int,
        approval: bytes = b"",
        start_tolerance: float | None = None,
        waits_for_start: bool = False,
        is_placed: bool = False,
        accepted_scan_age_s: float | None = None,
        lets_go: Iterable[str] = (),
    ) -> ExecuteResponse:
        """Have the server's robot carry out exactly the trajectory that was looked at; the plan is verified before.

        Args:
            plan_id: of a certified plan with files.
            trajectory_sha256: of the trajectory that was looked at.
            lease: from ``take_control``.
            revision: of the state that the operator has seen.
            approval: signed statement of the acceptance that the operator relies on.
            start_tolerance: how far each joint may be from the plan's start [rad, m]; None for the server's.
            waits_for_start: whether the plan's clock waits for the order ``start``.
            is_placed: whether a simulated robot is put at the plan's start first.
            accepted_scan_age_s: age up to which the plan's scan was found to be right still [s].
            lets_go: objects that the plan's hands may let go, each confirmed by name.
        """
        message = ExecuteRequest(
            plan_id=plan_id,
            trajectory_sha256=trajectory_sha256,
            approval=approval,
            start_tolerance=start_tolerance,
            lease=lease,
            expected_revision=revision,
            waits_for_start=waits_for_start,
            is_placed=is_placed,
            accepted_scan_age_s=accepted_scan_age_s,
            lets_go=lets_go,
        )
        response: ExecuteResponse = await self._call("Execute", message, None, is_repeatable=False)
        return response

    async def watch(self, *, lease: str = "", rate_hz: float | None = None) -> AsyncGenerator[WatchResponse, None]:
        """Yield the whole state of the server's robot, and again after every change.

        Args:
            lease: of the operator whose presence this shows; the robot may hold when the iterator is closed.
            rate_hz: greatest number of poses a second; None for the server's 10.
        """
        reader = WatchReader()
        message = WatchRequest(lease=lease, rate_hz=rate_hz)
        async with aclosing(self._stream("Watch", message, Attempts(self._retry, None))) as changes:
            async for change in changes:
                yield reader.take(change)

    async def status(self) -> GetStatusResponse:
        """Return the server's workers, queue, verdict counts and latencies."""
        status: GetStatusResponse = await self._call("GetStatus", GetStatusRequest(), self._timeout_s)
        return status

    async def _upload_clouds(self, clouds: Clouds) -> CloudsSpec:
        return make_clouds_message(clouds, await self._upload_files(find_cloud_files(clouds)))

    async def _upload_files(self, files: Mapping[str, Path]) -> dict[str, str]:
        """Upload local files; return their ids by their names."""
        return {name: await self.upload_cloud(path) for name, path in files.items()}

    async def _call(self, method: str, message: Message, deadline_s: float | None, is_repeatable: bool = True) -> Any:
        check_size(message)
        attempts = Attempts(self._retry, deadline_s, is_repeatable)
        while True:
            try:
                return await self._transport.call(method, message, attempts.start())
            except grpc.RpcError as error:
                delay_s = self._use_attempt(attempts, read_error(error))
            await self._transport.sleep(delay_s)

    async def _stream(self, method: str, message: Message, attempts: Attempts) -> AsyncGenerator[Any, None]:
        check_size(message)
        step = LastStep()
        while True:
            try:
                async with aclosing(self._transport.stream(method, message, attempts.start())) as events:
                    async for event in events:
                        step.take(event)
                        yield event
                return
            except grpc.RpcError as error:
                delay_s = self._use_attempt(attempts, read_error(error), step)
            await self._transport.sleep(delay_s)

    def _use_attempt(self, attempts: Attempts, error: PlannerError, step: LastStep | None = None) -> float:
        """Return the delay before the next attempt.

        Raises:
            PlannerError: no attempt is left; the text names the user's files and the last step.
        """
        error = (step or LastStep()).explain_deadline(self._upload_names.restore(error), attempts.deadline_s)
        error = explain_unreachable(error, self._connection)
        delay_s = attempts.use(error)
        if self._on_retry is not None:
            self._on_retry(error, delay_s)
        return delay_s
