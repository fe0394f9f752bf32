"""Plans that need a decision: their list, one of them as it is shown, and the decision."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path
from typing import Any

from service.cli.console.judging import judge_plan
from service.cli.console.sessions import OpenedPlan, OperatorSession
from service.client import AsyncPlannerClient, PlannerError
from service.client.answers import read_verdict
from service.errors import RequestError, ServiceError
from service.proto.planner.v1.planner_pb2 import Decision, PlanRecord, PlanState
from service.result.folder import VIEWER_NAME

MOST_LISTED = 30


class SeenPlans:
    """Ids of the plans that were asked for or opened at this console, newest first."""

    def __init__(self) -> None:
        self._ids: dict[str, None] = {}

    def add(self, plan_id: str) -> None:
        """Note a plan."""
        self._ids.pop(plan_id, None)
        self._ids[plan_id] = None

    async def list_plans(self, client: AsyncPlannerClient) -> list[dict[str, Any]]:
        """Return the plans that a client may see, newest first, as rows of the list.

        Raises:
            PlannerError: the server does not answer, or refuses the client.
        """
        rows = []
        for plan_id in list(reversed(self._ids))[:MOST_LISTED]:
            try:
                rows.append(_make_row((await client.get_plan(plan_id)).record))
            except PlannerError as error:
                # Of another operator, or no longer kept.
                if error.code.name not in ("NOT_FOUND", "PERMISSION_DENIED"):
                    raise
        return rows


async def open_plan(session: OperatorSession, plan_id: str) -> dict[str, Any]:
    """Fetch a plan with its page, keep both as what the operator sees, and return what the page shows.

    Raises:
        RequestError: the plan has not finished.
        PlannerError: the server does not know it, or does not answer.
    """
    with tempfile.TemporaryDirectory(prefix="scopt-console-") as scratch:
        folder = Path(scratch) / "plan"
        stored = await session.client.get_plan(plan_id, out=folder)
        viewer = folder / VIEWER_NAME
        page = await asyncio.to_thread(viewer.read_bytes) if viewer.is_file() else None
    record = stored.record
    if not record.HasField("result"):
        state = PlanState.Name(record.state).removeprefix("PLAN_STATE_").lower()
        reason = f": {record.reason}" if record.reason else ""
        raise RequestError(f"plan {plan_id} is {state}{reason}; expected a finished plan")
    session.keep_opened(plan_id, OpenedPlan(record, page))
    return {**_make_row(record), **judge_plan(record), "has_page": page is not None}


async def review_plan(
    session: OperatorSession, plan_id: str, is_accepted: bool, shown: tuple[str, str, str], comment: str, despite: str
) -> dict[str, Any]:
    """Store a decision about exactly what the page showed, and return the plan's row.

    Args:
        shown: hashes of trajectory, certificate and page that the operator's page had.

    Raises:
        RequestError: the plan is not open.
        ServiceError: the page showed another plan than the one that was fetched last.
        PlannerError: the server refuses the decision.
    """
    opened = session.opened.get(plan_id)
    if opened is None:
        raise RequestError(f"plan {plan_id} is not open; open it and look at it first")
    record = opened.record
    if shown != (record.result.trajectory.sha256, record.result.certificate.sha256, record.page_sha256):
        raise ServiceError(f"plan {plan_id} was opened again since, and is not what this page shows; open it again")
    await session.client.review(record, accept=is_accepted, comment=comment, despite=despite)
    stored = await session.client.get_plan(plan_id)
    session.keep_opened(plan_id, OpenedPlan(stored.record, opened.page))
    return _make_row(stored.record)


def _make_row(record: PlanRecord) -> dict[str, Any]:
    reviews = [
        {
            "is_accepted": review.decision == Decision.DECISION_ACCEPTED,
            "reviewer": review.reviewer,
            "comment": review.comment,
            "time": review.time.ToJsonString() if review.HasField("time") else "",
        }
        for review in record.reviews
    ]
    is_finished = record.state == PlanState.PLAN_STATE_FINISHED and record.HasField("result")
    return {
        "plan_id": record.plan_id,
        "state": PlanState.Name(record.state).removeprefix("PLAN_STATE_").lower(),
        "verdict": read_verdict(record.result) if is_finished else "",
        "created": record.created.ToJsonString() if record.HasField("created") else "",
        "is_approved": record.is_approved,
        "needs_decision": is_finished and not record.reviews,
        "reason": record.reason,
        "reviews": reviews,
        "trajectory_sha256": record.result.trajectory.sha256,
        "certificate_sha256": record.result.certificate.sha256,
        "page_sha256": record.page_sha256,
    }
