"""GetPlan, ReviewPlan, Verify, ListRobots and GetStatus."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Iterable
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from typing import cast

import grpc

from service.executor import Lane, Place, WorkerState
from service.executor.linux import rss_bytes
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.result_pb2 import FileChunk
from service.proto.planner.v1.result_pb2 import Verdict as VerdictMessage
from service.result.approval import Approval, Revocation, Signer
from service.server.jobs import JobRunner
from service.server.operation.lists import END_NOT_STORED
from service.server.plan_files import hash_files, read_files, stream_files
from service.server.plan_handler import parse_result
from service.server.refusals import refuse_invalid
from service.server.robots import RobotFolder
from service.server.running_plans import RunningPlans
from service.server.settings import ServerSettings
from service.store import Decision, PlanRecord, PlanState, Review, Store
from service.store.reviews import CERTIFIED, MAX_COMMENT_CHARACTERS, VALID_S
from service.telemetry import PlanCounts, bind
from service.trust import Role, current_caller
from service.trust.rpc import Context, Refusal, deadline_of
from service.wire.results import checks_to_messages, encode_verdict, standing_to_message
from service.wire.times import encode_time
from service.work.look import describe_robots, verify
from service.work.plan import Refused
from service.work.simulate import SIMULATION_FIELDS, simulate

_STATES = {
    PlanState.ACCEPTED: wire.PLAN_STATE_QUEUED,
    PlanState.FINISHED: wire.PLAN_STATE_FINISHED,
    PlanState.LOST: wire.PLAN_STATE_LOST,
}
_DECISIONS = {Decision.ACCEPTED: wire.DECISION_ACCEPTED, Decision.REJECTED: wire.DECISION_REJECTED}
_SIMULATION_VERDICTS = {
    "DONE": wire.SIMULATION_VERDICT_DONE,
    "STOOD": wire.SIMULATION_VERDICT_STOOD,
    "FELL": wire.SIMULATION_VERDICT_FELL,
}
MAX_PATH = 1000  # characters; a folder is made for each slash
MAX_FILES = 1000  # to verify; a result and its robot have a few dozen


class QueryHandlers:
    """Handlers of ``GetPlan``, ``ReviewPlan``, ``Verify``, ``ListRobots`` and ``GetStatus``.

    Args:
        settings: settings of the server.
        jobs: runner of verification.
        store: store of the plans.
        running: plans that have not ended.
        robots: own robots of the server.
        counts: finished plans since the start.
        signer: key that signs approvals; None without.
    """

    def __init__(
        self,
        settings: ServerSettings,
        jobs: JobRunner,
        store: Store,
        running: RunningPlans,
        robots: RobotFolder,
        counts: PlanCounts,
        signer: Signer | None = None,
    ) -> None:
        self._settings = settings
        self._jobs = jobs
        self._store = store
        self._counts = counts
        self._started = time.monotonic()
        self._running = running
        self._robots = robots
        self._signer = signer
        self.is_draining = False

    async def get_plan(self, message: wire.GetPlanRequest, context: Context) -> AsyncIterator[wire.GetPlanResponse]:
        """Yield a plan with its reviews, and its files on request.

        Raises:
            NotStoredError: there is no such plan, or it has no files.
        """
        record = self._find_record(message.plan_id)
        yield wire.GetPlanResponse(record=self._record_to_message(record))
        if message.with_files:
            async for chunk in stream_files(self._store, record.plan_id, message.known_format):
                yield wire.GetPlanResponse(file=chunk)

    async def review_plan(self, message: wire.ReviewPlanRequest, context: Context) -> wire.ReviewPlanResponse:
        """Store a person's review of a plan.

        Raises:
            Refusal: a field is wrong.
            StoreError: there is no such plan, or its hashes are not those of the review.
        """
        decisions = {number: decision for decision, number in _DECISIONS.items()}
        if message.decision not in decisions:
            raise refuse_invalid(["decision: expected DECISION_ACCEPTED or DECISION_REJECTED"])
        if not message.plan_id:
            raise refuse_invalid(["plan_id: is missing"])
        bind(plan_id=message.plan_id)
        length = len(message.comment)
        if length > MAX_COMMENT_CHARACTERS:
            raise refuse_invalid([f"comment: expected at most {MAX_COMMENT_CHARACTERS} characters, got {length}"])
        review = await asyncio.to_thread(
            self._store.reviews.add,
            message.plan_id,
            decisions[message.decision],
            current_caller().name,
            message.trajectory_sha256,
            message.certificate_sha256,
            message.comment,
            message.page_sha256,
            None if self._signer is None else partial(self._sign, self._signer),
            verdict=_decode_verdict(message.verdict, "verdict") or CERTIFIED,
            despite=_decode_verdict(message.despite, "despite"),
            valid_s=message.valid_s if message.HasField("valid_s") else VALID_S,
        )
        return wire.ReviewPlanResponse(review=_review_to_message(review))

    def _sign(self, signer: Signer, plan: PlanRecord, review: Review) -> bytes:
        """Return the signed statement about an accepted plan, or that its acceptance is withdrawn."""
        if review.decision is Decision.REJECTED:
            return signer.sign_revocation(Revocation(plan.plan_id, review.reviewer, review.comment, review.time))
        statement = Approval(
            plan_id=plan.plan_id,
            verdict=plan.verdict,
            reviewer=review.reviewer,
            comment=review.comment,
            approved_at=review.time,
            request_sha256=plan.request_sha256,
            trajectory_sha256=review.plan_sha256,
            certificate_sha256=review.certificate_sha256,
            page_sha256=review.page_sha256,
            files=hash_files(self._store, plan.plan_id) if plan.archive_bytes else {},
            despite="" if review.verdict == CERTIFIED else review.verdict,
            expires_at=review.expires,
        )
        return signer.sign(statement)

    async def verify(self, message: wire.VerifyRequest, context: Context) -> wire.VerifyResponse:
        """Verify the recorded motion of a plan or of the message's files.

        Raises:
            Refusal: there is no motion, or it cannot be read.
        """
        files = await self._read_plan(message)
        answer = await self._jobs.run(
            "verify",
            verify,
            files,
            deadline=deadline_of(context),
            budget_s=self._settings.budget_s("verify"),
            place=Place(current_caller().owner),
        )
        if isinstance(answer, Refused):
            raise refuse_invalid(answer.problems)
        return wire.VerifyResponse(
            verdict=encode_verdict(answer["verdict"]),
            explanation=answer["explanation"],
            notes=answer["notes"],
            checks=checks_to_messages(answer["checks"]),
            min_clearance_m=answer["min_clearance_m"],
            min_balance_margin_m=answer["min_balance_margin_m"],
            held_to=answer["held_to"] or "",
            standing=standing_to_message(answer["standing"]),
        )

    async def _read_plan(self, message: wire.VerifyRequest | wire.SimulatePlanRequest) -> dict[str, bytes]:
        """Return the files of the plan that a message names or holds, by path (Refusal where there is none)."""
        if bool(message.plan_id) == bool(message.files):
            raise refuse_invalid(["plan_id: expected either a plan_id or files"])
        if not message.plan_id:
            return _join_chunks(message.files)
        record = self._find_record(message.plan_id)
        return await asyncio.to_thread(read_files, self._store, record.plan_id)

    async def simulate(self, message: wire.SimulatePlanRequest, context: Context) -> wire.SimulatePlanResponse:
        """Carry out the recorded motion of a plan or of the message's files in physics.

        Raises:
            Refusal: there is no motion, or it cannot be carried out, or an option is out of range.
        """
        files = await self._read_plan(message)
        given = {name: getattr(message, name) for name in SIMULATION_FIELDS if message.HasField(name)}
        answer = await self._jobs.run(
            "simulate",
            simulate,
            files,
            given,
            deadline=deadline_of(context),
            budget_s=self._settings.budget_s("simulate"),
            place=Place(current_caller().owner),
        )
        if isinstance(answer, Refused):
            raise refuse_invalid(answer.problems)
        response = wire.SimulatePlanResponse(
            has_stood=answer["verdict"] != "FELL",
            explanation=answer["explanation"],
            notes=answer["notes"],
            verdict=_SIMULATION_VERDICTS[answer["verdict"]],
        )
        response.figures.update(answer)
        return response

    async def list_robots(self, message: wire.ListRobotsRequest, context: Context) -> wire.ListRobotsResponse:
        """List the robots that requests may name; the folder of own robots is read at every call."""
        rows = await self._jobs.run(
            "robots",
            describe_robots,
            self._robots.requests(),
            deadline=deadline_of(context),
            budget_s=self._settings.budget_s("robots"),
            place=Place(current_caller().owner, Lane.LIGHT),
        )
        texts = self._robots.hide_paths(row["description"] for row in rows)
        robots = [wire.RobotInfo(**{**row, "description": text}) for row, text in zip(rows, texts, strict=True)]
        return wire.ListRobotsResponse(robots=robots)

    async def get_status(self, message: wire.GetStatusRequest, context: Context) -> wire.GetStatusResponse:
        """Return the state of workers and queue."""
        pool, admission = self._jobs.executor.stats(), self._jobs.admission
        workers = [
            wire.WorkerStatus(
                pid=worker.pid or 0,
                state=worker.state.value,
                work=self._jobs.kind_of_worker(worker.pid) if worker.state is WorkerState.BUSY else "",
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
            verdicts=self._counts.verdicts,
            solve_p50_s=self._counts.solve_percentile(50.0),
            solve_p99_s=self._counts.solve_percentile(99.0),
            is_draining=self.is_draining,
            resident_bytes=rss_bytes(os.getpid()),
        )

    def _find_record(self, plan_id: str) -> PlanRecord:
        """Return the record of the caller's own plan, or of any plan for the roles review and admin."""
        if not plan_id:
            raise refuse_invalid(["plan_id: is missing"])
        record = self._store.plans.get(plan_id)
        bind(plan_id=record.plan_id)
        caller = current_caller()
        roles = frozenset() if caller.identity is None else caller.identity.roles
        if record.client != caller.name and not roles & {Role.REVIEW, Role.ADMIN}:
            raise Refusal(
                grpc.StatusCode.PERMISSION_DENIED, "plan_id: another client's plan needs the role review or admin"
            )
        return record

    def _record_to_message(self, record: PlanRecord) -> wire.PlanRecord:
        running = self._running.get(record.plan_id)
        if running is None and record.state is PlanState.ACCEPTED:
            record = replace(record, state=PlanState.LOST, why_lost=END_NOT_STORED)
        reviews = self._store.reviews.find(record.plan_id)
        message = wire.PlanRecord(
            plan_id=record.plan_id,
            request_id=record.request_id,
            state=wire.PLAN_STATE_RUNNING if running is not None and running.has_begun else _STATES[record.state],
            reviews=[_review_to_message(review) for review in reviews],
            is_approved=self._store.reviews.is_valid(reviews),
            created=encode_time(record.created),
            reason=record.why_lost,
            page_sha256=record.page_sha256,
            needs_review=self._store.lists.needs_review(record.plan_id),
        )
        if record.state is PlanState.FINISHED:
            message.result.CopyFrom(parse_result(record))
        if record.finished is not None:
            message.finished.CopyFrom(encode_time(record.finished))
        return message


def _join_chunks(chunks: Iterable[FileChunk]) -> dict[str, bytes]:
    """Join chunks to files by path.

    Raises:
        Refusal: there are more files than any result folder has.
    """
    parts: dict[str, list[bytes]] = {}
    for chunk in chunks:
        if len(chunk.path) > MAX_PATH:
            raise refuse_invalid([f"files: expected paths of at most {MAX_PATH} characters, got {len(chunk.path)}"])
        parts.setdefault(chunk.path, []).append(chunk.data)
        if len(parts) > MAX_FILES:
            raise refuse_invalid([f"files: expected at most {MAX_FILES}; a result folder has fewer"])
    return {path: b"".join(data) for path, data in parts.items()}


def _decode_verdict(number: int, field: str) -> str:
    """Return the name of a verdict; empty if unspecified (Refusal for a number that is none)."""
    if number not in VerdictMessage.values():
        raise refuse_invalid([f"{field}: {number} is no verdict"])
    name = VerdictMessage.Name(cast(VerdictMessage, number)).removeprefix("VERDICT_")
    return "" if name == "UNSPECIFIED" else name


def _review_to_message(review: Review) -> wire.Review:
    return wire.Review(
        decision=_DECISIONS[review.decision],
        reviewer=review.reviewer,
        comment=review.comment,
        trajectory_sha256=review.plan_sha256,
        certificate_sha256=review.certificate_sha256,
        page_sha256=review.page_sha256,
        approval=review.approval,
        time=encode_time(review.time),
        verdict=encode_verdict(review.verdict) if review.verdict else None,
        expires=encode_time(review.expires) if review.expires else None,
    )


@cache
def _version() -> str:
    return version("scopt")
