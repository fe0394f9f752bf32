"""ListPlans and ListScenes."""

from __future__ import annotations

import asyncio

from google.protobuf.timestamp_pb2 import Timestamp

from service.errors import shown, would_do
from service.proto.planner.v1 import planner_pb2 as wire
from service.request.tasks.registry import KINDS
from service.server.refusals import refuse_invalid
from service.server.running_plans import RunningPlans
from service.store import DIRECT, ListedPlan, ListedScene, PlanFilter, PlanState, Store
from service.trust import Role, current_caller
from service.trust.rpc import Context
from service.wire.results import encode_verdict
from service.wire.times import decode_time, encode_time

PAGE_SIZE, MAX_PAGE_SIZE = 50, 500
TASKS = (*(name for kind in KINDS for name in kind.counted_as), DIRECT)
END_NOT_STORED = "its end could not be stored"  # such as on a full disk
# States that the store knows a plan by; which open plan has begun, only the server knows.
_STORED = {
    wire.PLAN_STATE_UNSPECIFIED: (),
    wire.PLAN_STATE_QUEUED: (PlanState.ACCEPTED,),
    wire.PLAN_STATE_RUNNING: (PlanState.ACCEPTED,),
    wire.PLAN_STATE_FINISHED: (PlanState.FINISHED,),
    wire.PLAN_STATE_LOST: (PlanState.LOST, PlanState.ACCEPTED),
}


class ListHandlers:
    """Handlers of ``ListPlans`` and ``ListScenes``.

    Args:
        store: store of plans and scenes.
        running: plans that have not ended.
    """

    def __init__(self, store: Store, running: RunningPlans) -> None:
        self._store = store
        self._running = running

    async def list_plans(self, message: wire.ListPlansRequest, context: Context) -> wire.ListPlansResponse:
        """Return a page of the plans that the caller may see.

        Raises:
            Refusal: a filter makes no sense.
        """
        if message.state not in _STORED:
            raise refuse_invalid([f"state: {message.state} is no state of a plan"])
        if message.task and message.task not in TASKS:
            raise refuse_invalid(
                [f"task: unknown kind {shown(message.task)}; expected {would_do(message.task, TASKS)}"]
            )
        size, below = _read_page(message.page_size, message.page_token)
        wanted = PlanFilter(
            client=_own_name(),
            states=_STORED[message.state],
            since=_read_since(message.since),
            kind=message.task,
            needs_review=message.needs_review,
        )
        found: list[tuple[int, wire.PlanSummary]] = []
        while True:  # what is stored as open may be queued, running, or lost
            batch = await asyncio.to_thread(self._store.lists.find_plans, wanted, size + 1, below)
            rows = ((plan.number, self._summarize(plan)) for plan in batch)
            found += [row for row in rows if message.state in (row[1].state, wire.PLAN_STATE_UNSPECIFIED)]
            if len(batch) <= size or len(found) > size:
                break
            below = batch[-1].number
        token = str(found[size - 1][0]) if len(found) > size else ""
        return wire.ListPlansResponse(plans=[plan for _, plan in found[:size]], next_page_token=token)

    def _summarize(self, listed: ListedPlan) -> wire.PlanSummary:
        plan = listed.plan
        if plan is None:
            return wire.PlanSummary(plan_id=listed.plan_id, state=wire.PLAN_STATE_LOST, reason=listed.damage)
        state, reason = self._find_state(listed.plan_id, plan.state), plan.why_lost
        if state == wire.PLAN_STATE_LOST and plan.state is PlanState.ACCEPTED:
            reason = END_NOT_STORED
        return wire.PlanSummary(
            plan_id=plan.plan_id,
            request_id=plan.request_id,
            client=plan.client,
            task=plan.kind,
            state=state,
            verdict=encode_verdict(plan.verdict) if plan.verdict else None,
            created=encode_time(plan.created),
            finished=None if plan.finished is None else encode_time(plan.finished),
            is_approved=self._store.reviews.is_valid(listed.reviews),
            needs_review=listed.needs_review,
            trajectory_sha256=plan.plan_sha256,
            certificate_sha256=plan.certificate_sha256,
            page_sha256=plan.page_sha256,
            reason=reason,
        )

    def _find_state(self, plan_id: str, stored: PlanState) -> wire.PlanState:
        if stored is PlanState.FINISHED:
            return wire.PLAN_STATE_FINISHED
        running = self._running.get(plan_id)
        if stored is PlanState.LOST or running is None:
            return wire.PLAN_STATE_LOST
        return wire.PLAN_STATE_RUNNING if running.has_begun else wire.PLAN_STATE_QUEUED

    async def list_scenes(self, message: wire.ListScenesRequest, context: Context) -> wire.ListScenesResponse:
        """Return a page of the scenes that the caller may see.

        Raises:
            Refusal: a filter makes no sense.
        """
        size, below = _read_page(message.page_size, message.page_token)
        since = _read_since(message.since)
        found = await asyncio.to_thread(self._store.lists.find_scenes, _own_name(), since, size + 1, below)
        token = str(found[size - 1].number) if len(found) > size else ""
        return wire.ListScenesResponse(scenes=map(_scene_to_message, found[:size]), next_page_token=token)


def _scene_to_message(scene: ListedScene) -> wire.SceneSummary:
    return wire.SceneSummary(
        scene_id=scene.scene_id, client=scene.client, created=encode_time(scene.created), stored_bytes=scene.n_bytes
    )


def _own_name() -> str:
    """Return the name of a caller who sees only what is its own; empty for the roles review and admin."""
    caller = current_caller()
    roles = frozenset() if caller.identity is None else caller.identity.roles
    return "" if roles & {Role.REVIEW, Role.ADMIN} else caller.name


def _read_page(size: int, token: str) -> tuple[int, int | None]:
    """Return the size of a page and the number that it is below (Refusal for a wrong size or token)."""
    problems = []
    if size > MAX_PAGE_SIZE:
        problems.append(f"page_size: expected at most {MAX_PAGE_SIZE}, got {size}")
    if token and not (token.isascii() and token.isdigit() and len(token) <= 18):
        problems.append(f"page_token: {shown(token)} is no next_page_token of an earlier response")
    if problems:
        raise refuse_invalid(problems)
    return size or PAGE_SIZE, int(token) if token else None


def _read_since(stamp: Timestamp) -> float:
    try:
        return decode_time(stamp)
    except ValueError as error:
        raise refuse_invalid([f"since: {error}"]) from None
