"""Plan: from a request to its verdict, once, however often it is asked for and whoever dies on the way."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, fields

import grpc
import structlog

from service.proto.planner.v1.planner_pb2 import PlanAccepted, PlanFinished, PlanRequest, PlanResponse
from service.proto.planner.v1.result_pb2 import MotionResult
from service.request.file import request_hash
from service.request.schema import PlanRequest as Request
from service.result.result import Verdict
from service.server.archive import chunks
from service.server.asked import WITHIN, Door, kind_of, named_files
from service.server.disk import Disk
from service.server.failures import refusal_for
from service.server.refusal import invalid, refusal_of_problems
from service.server.running import RunningPlan, RunningPlans
from service.server.settings import SMALL_BYTES
from service.server.spread import first_certified, with_other_starts
from service.server.workshop import Piece, Workshop, outcome
from service.store import PlanRecord, PlanState, Store
from service.telemetry import bind
from service.trust import current_caller
from service.trust.rpc import Context, Refusal, deadline_of
from service.work.plan import PlanAnswer, PlanTask, Refused, run_plan

_LOG = structlog.get_logger("scopt.server")
FIELDS = frozenset(field.name for field in fields(Request))
FIRST_STEP = re.compile(r"([A-Za-z_]\w*)[^\s:]*: ")
REQUEST_ID = re.compile(r"[A-Za-z0-9._:@/+=-]{0,100}")


class Planning:
    """Answers ``Plan``.

    Args:
        door: what requests must pass.
        workshop: where they are worked on.
        store: where they are kept; disk: it is on.
        on_verdict: told kind, verdict and seconds by step of every plan that has one.
    """

    def __init__(
        self,
        door: Door,
        workshop: Workshop,
        store: Store,
        disk: Disk,
        on_verdict: Callable[[str, str, Mapping[str, float]], None],
    ) -> None:
        self._door = door
        self._workshop = workshop
        self._store = store
        self._disk = disk
        self._on_verdict = on_verdict
        self._tasks: set[asyncio.Task[None]] = set()
        self.running = RunningPlans()

    async def plan(self, message: PlanRequest, context: Context) -> AsyncIterator[PlanResponse]:
        """What happens to a request, up to its end and its files.

        Raises:
            Refusal: it was not let in, or came to nothing.
        """
        deadline = deadline_of(context)
        client = current_caller().name
        bind(request_id=message.request_id)
        request = await self._checked(message)
        record, plan = await self._begin(message, request, client, deadline)
        accepted = PlanAccepted(plan_id=record.plan_id, request_id=record.request_id)
        if plan is None:
            accepted.is_known = True
            yield PlanResponse(accepted=accepted)
            yield PlanResponse(finished=PlanFinished(plan_id=record.plan_id, result=stored_result(record)))
        else:
            with plan.watched(deadline) as is_first:
                accepted.is_known = not is_first
                yield PlanResponse(accepted=accepted)
                async for response in plan.events():
                    yield response
        if message.with_files:
            async for chunk in chunks(self._store, record.plan_id):
                yield PlanResponse(file=chunk)

    async def _checked(self, message: PlanRequest) -> Request:
        if not REQUEST_ID.fullmatch(message.request_id):
            raise invalid(["request_id: at most 100 letters, digits and ._:@/+=- would do"])
        if not message.HasField("request"):
            raise invalid(["request: is missing"])
        if message.request.ByteSize() <= SMALL_BYTES:
            return self._door.request(message.request)
        return await asyncio.to_thread(self._door.request, message.request)

    async def _begin(
        self, message: PlanRequest, request: Request, client: str, deadline: float | None
    ) -> tuple[PlanRecord, RunningPlan | None]:
        """The record of a request, and the plan under way; None for one that has been finished before."""
        kind, sha = kind_of(request), request_hash(request)
        while True:
            record = self._store.plans.find(client, message.request_id)
            running = None if record is None else self.running.get(record.plan_id)
            if running is None or not running.is_stopping:
                break
            await running.ended()
        if record is not None:
            bind(plan_id=record.plan_id)
            if record.request_sha256 != sha:
                raise Refusal(
                    grpc.StatusCode.ALREADY_EXISTS,
                    f"request_id {message.request_id!r} stands for another request of this client; choose another id",
                )
            if record.state is PlanState.FINISHED or running is not None:
                return record, running
        self._disk.check()
        self._workshop.admission.check(kind, _left(deadline))
        return self._started(client, request, sha, message, deadline)

    def _started(
        self, client: str, request: Request, sha: str, message: PlanRequest, deadline: float | None
    ) -> tuple[PlanRecord, RunningPlan]:
        """The plan under way: a worker has it before it is written down, and the client is told after that."""
        plan = RunningPlan(self._workshop)
        with ExitStack() as held:
            begun = held.enter_context(ExitStack())
            begun.callback(plan.forget)
            placed = held.enter_context(self._door.placed(request))
            asked = _Asked(kind_of(request), message, request, placed, sha)
            piece = self._submit(plan, asked, deadline)
            begun.callback(piece.cancel)
            record = self._store.plans.begin(client, message.request_id, sha, asked.kind).plan
            begun.pop_all()
            bind(plan_id=record.plan_id)
            plan.plan_id = record.plan_id
            self.running.add(plan)
            work = asyncio.create_task(self._see_through(plan, asked, piece, deadline, held.pop_all()))
        self._tasks.add(work)
        work.add_done_callback(self._tasks.discard)
        return record, plan

    def _submit(self, plan: RunningPlan, asked: _Asked, deadline: float | None) -> Piece[PlanAnswer | Refused]:
        """Hand a plan to a worker.

        The deadline shortens the plan, and no more: a plan is stopped when nobody waits for it any longer.
        """
        piece = self._workshop.start(
            asked.kind,
            run_plan,
            asked.task(deadline),
            deadline=None,
            budget_s=asked.request.options.time_limit_s,
            on_event=plan.progress,
            is_typical=_is_typical,
        )
        plan.worked_on_by(piece)
        return piece

    async def _see_through(
        self,
        plan: RunningPlan,
        asked: _Asked,
        piece: Piece[PlanAnswer | Refused],
        deadline: float | None,
        held: ExitStack,
    ) -> None:
        """See a plan to its end; whatever happens, its watchers hear of it and the store knows."""
        try:
            with held:
                answer = await self._answered(piece, asked, deadline)
                while _is_cut_short(answer) and plan.is_awaited_beyond(deadline):
                    deadline = plan.awaited_until
                    piece = self._submit(plan, asked, deadline)
                    answer = await self._answered(piece, asked, deadline)
            if isinstance(answer, Refused):
                problems = self._door.robots.as_named(_as_named(answer.problems, asked.request, asked.placed))
                raise refusal_of_problems(problems, answer.is_unplanned, WITHIN)
            if answer.verdict == Verdict.CANCELLED.value:
                raise Refusal(grpc.StatusCode.CANCELLED, "stopped before there was a plan")
            await self._keep(plan.plan_id, answer)
            finished = PlanFinished(plan_id=plan.plan_id)
            finished.result.MergeFromString(answer.reply)
            plan.finish(finished)
        except Exception as error:
            self._give_up(plan, error)
            return
        await asyncio.sleep(0)  # whoever waits has the plan before it is counted and logged
        self._tell(asked.kind, answer, piece.waited_s)

    async def _answered(
        self, piece: Piece[PlanAnswer | Refused], asked: _Asked, deadline: float | None
    ) -> PlanAnswer | Refused:
        """The answer of the plan's own worker, or of one that helped."""
        numbers = range(1, self._door.settings.spread)
        if not numbers:
            return await outcome(piece)
        spares = (self._workshop.spare(run_plan, with_other_starts(asked.task(deadline), n)) for n in numbers)
        return await first_certified(piece, [spare for spare in spares if spare is not None])

    def _give_up(self, plan: RunningPlan, error: Exception) -> None:
        """End a plan that comes to nothing."""
        refusal = refusal_for(error)
        try:
            self._store.plans.give_up(plan.plan_id, refusal.text)
        except Exception as unwritten:  # a full disk, say: whoever waits is told all the same
            refusal_for(unwritten)
        plan.fail(refusal)

    def _tell(self, kind: str, answer: PlanAnswer, waited_s: float) -> None:
        self._on_verdict(kind, answer.verdict, {**answer.timings, "queue": waited_s})
        _LOG.info("planned", kind=kind, verdict=answer.verdict, seconds=round(answer.timings["total"], 3))

    async def _keep(self, plan_id: str, answer: PlanAnswer) -> None:
        """Have the store know before the client does: what was told is there after a restart."""
        finish = self._store.plans.finish
        hashes = answer.trajectory_sha256, answer.certificate_sha256
        if answer.archive:
            await asyncio.to_thread(finish, plan_id, answer.verdict, answer.reply, *hashes, answer.archive)
        else:
            finish(plan_id, answer.verdict, answer.reply, *hashes)

    async def ended(self) -> None:
        """Wait until nothing is under way."""
        while self._tasks:
            await asyncio.wait(self._tasks)


@dataclass(frozen=True)
class _Asked:
    """One request as workers get it.

    Attributes:
        kind: of request.
        message: as it came; request: what it says; placed: with files where they are kept here.
        sha256: of the request.
    """

    kind: str
    message: PlanRequest
    request: Request
    placed: Request
    sha256: str

    def task(self, deadline: float | None) -> PlanTask:
        """To be done by a deadline on the clock of ``time.monotonic``."""
        message = self.message
        return PlanTask(self.placed, deadline, message.with_files, message.with_waypoints, self.request, self.sha256)


def _is_cut_short(answer: PlanAnswer | Refused) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict == Verdict.TIME_LIMIT.value


def _is_typical(answer: PlanAnswer | Refused) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict != Verdict.CANCELLED.value


def stored_result(record: PlanRecord) -> MotionResult:
    """The result of a finished plan."""
    return MotionResult.FromString(record.reply)


def _left(deadline: float | None) -> float | None:
    return None if deadline is None else deadline - time.monotonic()


def _as_named(problems: tuple[str, ...], request: Request, placed: Request) -> tuple[str, ...]:
    """Problems that speak of the fields and clouds that the client named, not of where they are kept."""
    for path, name in zip(named_files(placed.scene), named_files(request.scene), strict=True):
        problems = tuple(problem.replace(path, name) for problem in problems)
    if request.task is None or request.task.trajopt is None:
        return problems
    steps = [FIRST_STEP.match(problem) for problem in problems]
    is_within = [step is not None and step[1] not in FIELDS for step in steps]
    return tuple(
        f"task.trajopt.{problem}" if inside else problem for problem, inside in zip(problems, is_within, strict=True)
    )
