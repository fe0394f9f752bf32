"""Plan: one run per request, however many calls wait for it and whichever of them are cancelled."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, fields
from functools import cached_property

import grpc
import structlog

from scopt.settings import WALL_SHARE
from service.executor import Lane, Place
from service.proto.planner.v1.planner_pb2 import (
    PRIORITY_BATCH,
    PlanAccepted,
    PlanRequest,
    PlanResponse,
    Priority,
)
from service.proto.planner.v1.result_pb2 import MotionResult
from service.request.file import has_hash, request_hash
from service.request.schema import PlanRequest as Request
from service.result.result import Verdict
from service.server.disk import DiskWatch
from service.server.jobs import JobHandle, JobRunner, await_result
from service.server.plan_files import stream_files
from service.server.refusals import GOING_DOWN, STOPPING, discard_uploads, refuse_error, refuse_invalid
from service.server.requests import WITHIN, RequestReader, current_warnings, kind_of, list_files
from service.server.running_plans import RunningPlan, RunningPlans
from service.server.settings import SMALL_BYTES
from service.server.spread import Answer, await_certified, with_other_seed
from service.store import DIRECT, PlanRecord, PlanState, Store
from service.telemetry import Later, bind
from service.trust import current_caller
from service.trust.rpc import Context, Refusal, deadline_of
from service.wire.results import add_request_hash, encode_finished
from service.work.plan import PlanAnswer, PlanTask, Refused, run_plan

_LOG = structlog.get_logger("scopt.server")
FIELDS = frozenset(field.name for field in fields(Request))
FIRST_STEP = re.compile(r"([A-Za-z_]\w*)[^\s:]*: ")
COUNT_WITHIN_S = 1.0  # of the end of a plan, however slowly its clients read
REQUEST_ID = re.compile(r"[A-Za-z0-9._:@/+=-]{0,100}")


class PlanHandler:
    """Handler of ``Plan``.

    Args:
        reader: reader of requests.
        jobs: runner of the plans.
        store: store of the plans.
        disk: watch on the store's disk.
        on_verdict: called with kind, verdict and seconds by step of every plan that has a verdict.
        later: makes the calls that log.
    """

    def __init__(
        self,
        reader: RequestReader,
        jobs: JobRunner,
        store: Store,
        disk: DiskWatch,
        on_verdict: Callable[[str, str, Mapping[str, float]], None],
        later: Later,
    ) -> None:
        self._reader = reader
        self._jobs = jobs
        self._store = store
        self._disk = disk
        self._on_verdict = on_verdict
        self._later = later
        self._tasks: set[asyncio.Task[None]] = set()
        self.running = RunningPlans()

    async def plan(self, message: PlanRequest, context: Context) -> AsyncIterator[PlanResponse | bytes]:
        """Yield the progress of a plan, its result and its files; some responses are serialized already.

        Raises:
            Refusal: the request was not accepted, or has no result.
        """
        deadline = deadline_of(context)
        client = current_caller().name
        bind(request_id=message.request_id)
        request = await self._read(message)
        record, plan = await self._find_or_start(message, request, client, deadline)
        accepted = PlanAccepted(plan_id=record.plan_id, request_id=record.request_id, warnings=current_warnings())
        if plan is None:
            accepted.is_known = True
            yield PlanResponse(accepted=accepted)
            yield encode_finished(record.plan_id, record.reply)
        else:
            with plan.watch(deadline) as is_first:
                accepted.is_known = not is_first
                yield PlanResponse(accepted=accepted)
                async for response in plan.events():
                    yield response
        if message.with_files:
            async for chunk in stream_files(self._store, record.plan_id, message.known_format):
                yield PlanResponse(file=chunk)

    async def resume(self) -> None:
        """Begin the plans again that were accepted before a restart; a client may join them by their request id."""
        for record in self._store.plans.resumable:
            bind(plan_id=record.plan_id)
            try:
                self._resume(record)
            except Exception as error:
                refusal = refuse_error(error)
                self._store.plans.give_up(record.plan_id, f"the server was restarted, and then: {refusal.text}")
            else:
                _LOG.info("resumed", kind=record.kind)
            await asyncio.sleep(0)

    def _resume(self, record: PlanRecord) -> None:
        """Begin a stored plan again."""
        message = PlanRequest.FromString(record.request)
        request = self._reader.read(message.request)
        left_s = None if record.deadline is None else record.deadline - time.time()
        deadline = None if left_s is None else time.monotonic() + left_s
        plan = RunningPlan(self._jobs)
        plan.plan_id = record.plan_id
        with ExitStack() as files:
            undo = files.enter_context(ExitStack())
            undo.callback(plan.discard)
            local = files.enter_context(self._reader.open_files(request))
            lane = Lane.BATCH if message.priority == PRIORITY_BATCH else Lane.INTERACTIVE
            place = Place(record.client, lane)
            accepted = _AcceptedRequest(kind_of(request), message, request, local, place, ())
            handle = self._submit(plan, accepted, deadline, is_accepted=True)
            undo.pop_all()
            self._watch_end(plan, accepted, handle, deadline, files.pop_all())

    async def wait_for_all(self) -> None:
        """Wait until all plans have ended."""
        while self._tasks:
            await asyncio.wait(self._tasks)

    async def _read(self, message: PlanRequest) -> Request:
        if not REQUEST_ID.fullmatch(message.request_id):
            raise refuse_invalid(["request_id: expected at most 100 letters, digits and ._:@/+=-"])
        if message.priority not in Priority.values():
            raise refuse_invalid([f"priority: expected PRIORITY_INTERACTIVE or PRIORITY_BATCH, got {message.priority}"])
        if not message.HasField("request"):
            raise refuse_invalid(["request: is missing"])
        if message.request.ByteSize() <= SMALL_BYTES:
            return self._reader.read(message.request)
        return await asyncio.to_thread(self._reader.read, message.request)

    async def _find_or_start(
        self, message: PlanRequest, request: Request, client: str, deadline: float | None
    ) -> tuple[PlanRecord, RunningPlan | None]:
        """Return a request's record and running plan; None for a plan that has finished before."""
        while True:
            record = self._store.plans.find(client, message.request_id)
            running = None if record is None else self.running.get(record.plan_id)
            if running is None or not running.is_stopping:
                break
            await running.wait_for_end()
        if record is not None:
            bind(plan_id=record.plan_id)
            if not has_hash(request, record.request_sha256):
                raise Refusal(
                    grpc.StatusCode.ALREADY_EXISTS,
                    f"request_id: {message.request_id!r} belongs to another request of this client; choose another id",
                )
            if record.state is PlanState.FINISHED or running is not None:
                return record, running
        self._disk.require_space()
        place = _place_of(message)
        self._jobs.admission.check(kind_of(request), None if deadline is None else deadline - time.monotonic(), place)
        return self._start(client, request, message, deadline, None if record is None else record.request_sha256)

    def _start(
        self, client: str, request: Request, message: PlanRequest, deadline: float | None, lost_sha256: str | None
    ) -> tuple[PlanRecord, RunningPlan]:
        """Start a plan: a worker gets it before it is hashed and stored, and the client learns of it after that.

        ``lost_sha256`` is the hash that an earlier version may have given the lost plan of this request.
        """
        plan = RunningPlan(self._jobs)
        with ExitStack() as files:
            undo = files.enter_context(ExitStack())
            undo.callback(plan.discard)
            local = files.enter_context(self._reader.open_files(request))
            accepted = _AcceptedRequest(
                kind_of(request), message, request, local, _place_of(message), current_warnings()
            )
            handle = self._submit(plan, accepted, deadline)
            undo.callback(handle.cancel)
            stored = message.SerializeToString()
            until = None if deadline is None else time.time() + deadline - time.monotonic()
            kind = DIRECT if message.is_direct else accepted.kind
            record = self._store.plans.begin(
                client, message.request_id, accepted.sha256, kind, stored, until, lost_sha256
            )
            undo.pop_all()
            bind(plan_id=record.plan_id)
            plan.plan_id = record.plan_id
            self._watch_end(plan, accepted, handle, deadline, files.pop_all())
        return record, plan

    def _watch_end(
        self,
        plan: RunningPlan,
        accepted: _AcceptedRequest,
        handle: JobHandle[Answer],
        deadline: float | None,
        files: ExitStack,
    ) -> None:
        """Have a task wait for a plan's end."""
        self.running.add(plan)
        task = asyncio.create_task(self._finish(plan, accepted, handle, deadline, files))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _submit(
        self, plan: RunningPlan, accepted: _AcceptedRequest, deadline: float | None, is_accepted: bool = False
    ) -> JobHandle[Answer]:
        """Hand a plan to a worker.

        The deadline only shortens the plan's time limit: the plan is stopped when its last watcher leaves.
        """
        handle = self._jobs.start(
            accepted.kind,
            run_plan,
            accepted.make_task(deadline),
            deadline=None,
            budget_s=_find_longest(accepted.request),
            on_event=plan.report,
            is_typical=_is_typical,
            place=accepted.place,
            is_accepted=is_accepted,
        )
        plan.set_job(handle)
        return handle

    async def _finish(
        self,
        plan: RunningPlan,
        accepted: _AcceptedRequest,
        handle: JobHandle[Answer],
        deadline: float | None,
        files: ExitStack,
    ) -> None:
        """Wait for a plan's answer, store it, and report its end to the watchers, whatever happens."""
        try:
            with files:
                answer = await self._await_answer(handle, accepted, deadline)
                while _is_cut_short(answer) and plan.is_awaited_beyond(deadline):
                    deadline = plan.latest_deadline
                    handle = self._submit(plan, accepted, deadline, is_accepted=True)
                    answer = await self._await_answer(handle, accepted, deadline)
            if isinstance(answer, Refused) and answer.damaged:
                raise discard_uploads(self._reader.clouds, answer.damaged)
            if isinstance(answer, Refused):
                problems = _restore_names(answer.problems, accepted.request, accepted.local)
                raise refuse_invalid(self._reader.robots.hide_paths(problems), WITHIN)
            if answer.verdict == Verdict.CANCELLED.value:
                raise Refusal(grpc.StatusCode.CANCELLED, "stopped before there was a plan")
            reply = add_request_hash(answer.reply, accepted.sha256)
            await self._store_answer(plan.plan_id, answer, reply)
            plan.end(encode_finished(plan.plan_id, reply))
        except Exception as error:
            self._give_up(plan, error)
            return
        await plan.wait_until_left(COUNT_WITHIN_S)  # so that its clients have it before it is counted and logged
        self._on_verdict(accepted.kind, answer.verdict, {**answer.timings, "queue": handle.waited_s})
        self._later.call(_log_end, accepted.kind, answer)

    async def _await_answer(
        self, handle: JobHandle[Answer], accepted: _AcceptedRequest, deadline: float | None
    ) -> Answer:
        """Wait for the answer of the plan's own worker, or of an idle one that helps."""
        numbers = range(1, self._reader.settings.spread)
        if not numbers:
            return await await_result(handle)
        task = accepted.make_task(deadline)
        spares = (self._jobs.start_spare(run_plan, with_other_seed(task, number)) for number in numbers)
        return await await_certified(handle, [spare for spare in spares if spare is not None])

    def _give_up(self, plan: RunningPlan, error: Exception) -> None:
        """End a plan without a result."""
        refusal = refuse_error(error)
        try:
            if refusal not in (STOPPING, GOING_DOWN):  # else it is begun again after the restart
                self._store.plans.give_up(plan.plan_id, refusal.text)
        except Exception as unwritten:  # such as a full disk; the watchers are answered all the same
            refuse_error(unwritten)
        plan.end(refusal)

    async def _store_answer(self, plan_id: str, answer: PlanAnswer, reply: bytes) -> None:
        """Store a reply before the client gets it, so that it is there after a restart."""
        finish = self._store.plans.finish
        hashes = answer.trajectory_sha256, answer.certificate_sha256
        if answer.archive:
            files = answer.archive, answer.page_sha256
            await asyncio.to_thread(finish, plan_id, answer.verdict, reply, *hashes, *files)
        else:
            finish(plan_id, answer.verdict, reply, *hashes)


@dataclass(frozen=True)
class _AcceptedRequest:
    """One request as it is planned.

    Attributes:
        kind: kind of request.
        message: the client's message.
        request: the request it holds.
        local: the same with paths on the server.
        place: whose plan it is and how it waits.
        warnings: sentences about ignored fields, which become notes of the result.
    """

    kind: str
    message: PlanRequest
    request: Request
    local: Request
    place: Place
    warnings: tuple[str, ...]

    @cached_property
    def sha256(self) -> str:
        """Hash of ``request``, computed while a worker plans."""
        return request_hash(self.request)

    def make_task(self, deadline: float | None) -> PlanTask:
        """Make the worker's task; the deadline is on the clock of ``time.monotonic`` [s]."""
        message = self.message
        return PlanTask(
            self.local,
            deadline,
            message.with_files,
            message.with_waypoints,
            self.request,
            list_files(self.local),
            self.warnings,
        )


def _log_end(kind: str, answer: PlanAnswer) -> None:
    _LOG.info("planned", kind=kind, verdict=answer.verdict, seconds=round(answer.timings["total"], 3))


def parse_result(record: PlanRecord) -> MotionResult:
    """Parse the stored result of a finished plan."""
    return MotionResult.FromString(record.reply)


def _find_longest(request: Request) -> float:
    """Return the wall time after which a plan should have ended by itself [s]."""
    return request.limit_s if request.options.time_limit_s is not None else request.limit_s / WALL_SHARE


def _place_of(message: PlanRequest) -> Place:
    return Place(current_caller().owner, Lane.BATCH if message.priority == PRIORITY_BATCH else Lane.INTERACTIVE)


def _is_cut_short(answer: Answer) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict == Verdict.TIME_LIMIT.value


def _is_typical(answer: Answer) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict != Verdict.CANCELLED.value


def _restore_names(problems: tuple[str, ...], request: Request, local: Request) -> tuple[str, ...]:
    """Replace paths on the server by the client's names, and prefix fields of a problem file."""
    for path, name in zip(list_files(local), list_files(request), strict=True):
        problems = tuple(problem.replace(path, name) for problem in problems)
    if request.task is None or request.task.trajopt is None:
        return problems
    steps = [FIRST_STEP.match(problem) for problem in problems]
    return tuple(
        f"task.trajopt.{problem}" if step is not None and step[1] not in FIELDS else problem
        for problem, step in zip(problems, steps, strict=True)
    )
