"""GetPlan, ReviewPlan, Verify, ListRobots and GetStatus."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import replace
from functools import cache
from importlib.metadata import version

import grpc
from google.protobuf.timestamp_pb2 import Timestamp

from service.executor import WorkerState
from service.executor.linux import rss_bytes
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.result_pb2 import FileChunk
from service.server.archive import chunks, files_of
from service.server.perceiving import accepted
from service.server.planning import stored_result
from service.server.refusal import invalid
from service.server.robots import RobotFolder
from service.server.running import RunningPlans
from service.server.settings import ServerSettings
from service.server.workshop import Workshop
from service.store import Decision, PlanRecord, PlanState, Review, Store
from service.store.reviews import MAX_COMMENT_CHARACTERS
from service.telemetry import bind
from service.trust import Role, current_caller
from service.trust.rpc import Context, Refusal, deadline_of
from service.wire.results import checks_to_messages, verdict_number
from service.work.look import describe_robots, verify

_STATES = {
    PlanState.ACCEPTED: wire.PLAN_STATE_QUEUED,
    PlanState.RUNNING: wire.PLAN_STATE_RUNNING,
    PlanState.FINISHED: wire.PLAN_STATE_FINISHED,
    PlanState.LOST: wire.PLAN_STATE_LOST,
}
_DECISIONS = {Decision.ACCEPTED: wire.DECISION_ACCEPTED, Decision.REJECTED: wire.DECISION_REJECTED}
UNWRITTEN = "how it ended could not be written down"  # on a full disk, say
MAX_PATH = 1000  # characters; each slash is a folder that is looked for
MAX_FILES = 1000  # to verify: a result's own and its robot's, a few dozen


class Keeping:
    """Answers the methods about what is kept here.

    Args:
        settings: of the server.
        workshop: where plans are verified.
        store: where they are kept.
        running: plans that are under way.
        robots: that this server knows besides those of the package.
        verdicts: plans by verdict since the start.
    """

    def __init__(
        self,
        settings: ServerSettings,
        workshop: Workshop,
        store: Store,
        running: RunningPlans,
        robots: RobotFolder,
        verdicts: Mapping[str, int],
    ) -> None:
        self._settings = settings
        self._workshop = workshop
        self._store = store
        self._verdicts = verdicts
        self._started = time.monotonic()
        self._running = running
        self._robots = robots
        self.is_draining = False

    async def get_plan(self, message: wire.GetPlanRequest, context: Context) -> AsyncIterator[wire.GetPlanResponse]:
        """A plan, its reviews, and its files if they are asked for.

        Raises:
            NotStoredError: it is not there, or has no files.
        """
        record = self._record(message.plan_id)
        yield wire.GetPlanResponse(record=self._plan(record))
        if message.with_files:
            async for chunk in chunks(self._store, record.plan_id):
                yield wire.GetPlanResponse(file=chunk)

    async def review(self, message: wire.ReviewPlanRequest, context: Context) -> wire.ReviewPlanResponse:
        """Keep what a person says of a plan that was looked at.

        Raises:
            Refusal: no decision; StoreError: no such plan, or another one than was looked at.
        """
        known = {number: decision for decision, number in _DECISIONS.items()}
        if message.decision not in known:
            raise invalid(["decision: DECISION_ACCEPTED or DECISION_REJECTED would do"])
        if not message.plan_id:
            raise invalid(["plan_id: is missing"])
        bind(plan_id=message.plan_id)
        if len(message.comment) > MAX_COMMENT_CHARACTERS:
            length = len(message.comment)
            raise invalid([f"comment: at most {MAX_COMMENT_CHARACTERS} characters would do, got {length}"])
        review = await asyncio.to_thread(
            self._store.reviews.add,
            message.plan_id,
            known[message.decision],
            current_caller().name,
            message.trajectory_sha256,
            message.certificate_sha256,
            message.comment,
        )
        return wire.ReviewPlanResponse(review=_review(review))

    async def verify(self, message: wire.VerifyRequest, context: Context) -> wire.VerifyResponse:
        """Check a motion anew.

        Raises:
            Refusal: there is nothing to check, or it cannot be read.
        """
        if bool(message.plan_id) == bool(message.files):
            raise invalid(["plan_id: either a plan_id or files are needed"])
        if message.plan_id:
            record = self._record(message.plan_id)
            files = await asyncio.to_thread(files_of, self._store, record.plan_id)
        else:
            files = _joined(message.files)
        found = accepted(
            await self._workshop.run(
                "verify", verify, files, deadline=deadline_of(context), budget_s=self._settings.budget_s("verify")
            )
        )
        return wire.VerifyResponse(
            verdict=verdict_number(found["verdict"]),
            explanation=found["explanation"],
            notes=found["notes"],
            checks=checks_to_messages(found["checks"]),
            min_clearance_m=found["min_clearance_m"],
            min_balance_margin_m=found["min_balance_margin_m"],
            held_to=found["held_to"] or "",
        )

    async def robots(self, message: wire.ListRobotsRequest, context: Context) -> wire.ListRobotsResponse:
        """The robots that can be named; looked for anew every time."""
        found = await self._workshop.run(
            "robots",
            describe_robots,
            self._robots.requests(),
            deadline=deadline_of(context),
            budget_s=self._settings.budget_s("robots"),
        )
        texts = self._robots.as_named(robot["description"] for robot in found)
        robots = [wire.RobotInfo(**{**robot, "description": text}) for robot, text in zip(found, texts, strict=True)]
        return wire.ListRobotsResponse(robots=robots)

    async def status(self, message: wire.GetStatusRequest, context: Context) -> wire.GetStatusResponse:
        """What the server is doing."""
        pool, admission = self._workshop.executor.stats(), self._workshop.admission
        workers = [
            wire.WorkerStatus(
                pid=worker.pid or 0,
                state=worker.state.value,
                work=self._workshop.kind_at(worker.pid) if worker.state is WorkerState.BUSY else "",
                jobs_done=worker.jobs_done,
                resident_bytes=worker.rss_bytes,
            )
            for worker in pool.workers
        ]
        return wire.GetStatusResponse(
            version=_version(),
            uptime_s=time.monotonic() - self._started,
            queued=admission.queued,
            queue_limit=admission.queue_limit,
            workers=workers,
            worker_restarts=pool.restarts,
            verdicts=self._verdicts,
            solve_p50_s=admission.durations.percentile(50.0),
            solve_p99_s=admission.durations.percentile(99.0),
            is_draining=self.is_draining,
            resident_bytes=rss_bytes(os.getpid()),
        )

    def _record(self, plan_id: str) -> PlanRecord:
        """A plan of the caller's own, or any to those who review."""
        if not plan_id:
            raise invalid(["plan_id: is missing"])
        record = self._store.plans.get(plan_id)
        bind(plan_id=record.plan_id)
        caller = current_caller()
        roles = frozenset() if caller.identity is None else caller.identity.roles
        if record.client != caller.name and not roles & {Role.REVIEW, Role.ADMIN}:
            raise Refusal(
                grpc.StatusCode.PERMISSION_DENIED, "the plan is another client's; the role review or admin is needed"
            )
        return record

    def _plan(self, record: PlanRecord) -> wire.PlanRecord:
        running = self._running.get(record.plan_id)
        if running is None and record.state in (PlanState.ACCEPTED, PlanState.RUNNING):
            record = replace(record, state=PlanState.LOST, why_lost=UNWRITTEN)
        message = wire.PlanRecord(
            plan_id=record.plan_id,
            request_id=record.request_id,
            state=wire.PLAN_STATE_RUNNING if running is not None and running.has_begun else _STATES[record.state],
            reviews=[_review(review) for review in self._store.reviews.of(record.plan_id)],
            is_approved=self._store.reviews.is_accepted(record.plan_id),
            created=_time(record.created),
            reason=record.why_lost,
        )
        if record.state is PlanState.FINISHED:
            message.result.CopyFrom(stored_result(record))
        if record.finished is not None:
            message.finished.CopyFrom(_time(record.finished))
        return message


def _joined(parts: Iterable[FileChunk]) -> dict[str, bytes]:
    """Files by path.

    Raises:
        Refusal: they are more than any result folder has.
    """
    pieces: dict[str, list[bytes]] = {}
    for part in parts:
        if len(part.path) > MAX_PATH:
            raise invalid([f"files: a path of at most {MAX_PATH} characters would do, got one of {len(part.path)}"])
        pieces.setdefault(part.path, []).append(part.data)
        if len(pieces) > MAX_FILES:
            raise invalid(
                [f"files: at most {MAX_FILES} would do; those of a result folder's motion and robot are fewer"]
            )
    return {path: b"".join(data) for path, data in pieces.items()}


def _review(review: Review) -> wire.Review:
    return wire.Review(
        decision=_DECISIONS[review.decision],
        reviewer=review.reviewer,
        comment=review.comment,
        trajectory_sha256=review.plan_sha256,
        certificate_sha256=review.certificate_sha256,
        time=_time(review.time),
    )


def _time(seconds: float) -> Timestamp:
    stamp = Timestamp()
    stamp.FromNanoseconds(int(seconds * 1e9))
    return stamp


@cache
def _version() -> str:
    return version("scopt")
