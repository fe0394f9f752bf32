"""Plans that need a decision: their list, one of them as it is shown, the decision, and the robot that follows it."""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from service.cli.console.judging import judge_plan
from service.cli.console.sessions import OpenedPlan, OperatorSession
from service.client import AsyncPlannerClient, PlannerError
from service.client.answers import read_verdict
from service.errors import RequestError, ServiceError
from service.proto.planner.v1.planner_pb2 import Decision, PlanRecord, PlanState, PlanSummary
from service.proto.planner.v1.result_pb2 import VERDICT_UNSPECIFIED, Verdict
from service.result.folder import RESULT_NAME, VIEWER_NAME
from service.result.releases import list_held, list_releases

MOST_LISTED = 30
MOST_SCENES = 500  # among which that of a plan is looked for
_KNOWN = [verdict for verdict in Verdict.values() if verdict != VERDICT_UNSPECIFIED]


async def list_inbox(client: AsyncPlannerClient) -> list[dict[str, Any]]:
    """Return the plans that wait for a decision and the newest of all, newest first, as rows of the list.

    Raises:
        PlannerError: the server does not answer, or refuses the client.
    """
    listed: dict[str, PlanSummary] = {}
    for needs_review in (True, False):
        async for plan in client.list_plans(needs_review=needs_review, limit=MOST_LISTED):
            listed.setdefault(plan.plan_id, plan)
    newest_first = sorted(listed.values(), key=lambda plan: plan.created.ToNanoseconds(), reverse=True)
    return [_make_listed_row(plan) for plan in newest_first]


async def open_plan(session: OperatorSession, plan_id: str) -> dict[str, Any]:
    """Fetch a plan with its page, keep both as what the operator sees, and return what the page shows.

    Raises:
        RequestError: the plan has not finished.
        PlannerError: the server does not know it, or does not answer.
    """
    with tempfile.TemporaryDirectory(prefix="scopt-console-") as scratch:
        folder = Path(scratch) / "plan"
        stored = await session.client.get_plan(plan_id, out=folder)
        viewer, files = folder / VIEWER_NAME, folder / RESULT_NAME
        page = await asyncio.to_thread(viewer.read_bytes) if viewer.is_file() else None
        result = json.loads(await asyncio.to_thread(files.read_bytes)) if files.is_file() else {}
    releases = list_releases(result)
    record = stored.record
    if not record.HasField("result"):
        state = PlanState.Name(record.state).removeprefix("PLAN_STATE_").lower()
        reason = f": {record.reason}" if record.reason else ""
        raise RequestError(f"plan {plan_id} is {state}{reason}; expected a finished plan")
    session.keep_opened(plan_id, OpenedPlan(record, page, releases))
    return {
        **_make_row(record),
        **judge_plan(record),
        "has_page": page is not None,
        "releases": releases,
        "holds": list_held(result),
        "scan_age_s": await _find_scan_age_s(session.client, record, result.get("request", {}).get("scene", {})),
    }


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
    opened = _find_opened(session, plan_id)
    record = opened.record
    hashes = record.result.trajectory.sha256, record.result.certificate.sha256, record.page_sha256
    _require_shown(record, shown == hashes)
    await session.client.review(record, accept=is_accepted, comment=comment, despite=despite)
    stored = await session.client.get_plan(plan_id)
    session.keep_opened(plan_id, OpenedPlan(stored.record, opened.page, opened.releases))
    return _make_row(stored.record)


async def execute_plan(
    session: OperatorSession,
    plan_id: str,
    trajectory_sha256: str,
    revision: int,
    is_placed: bool,
    scan_age_s: float | None,
    lets_go: Sequence[str],
) -> dict[str, Any]:
    """Have the robot carry out exactly the accepted trajectory that the page showed.

    Args:
        scan_age_s: age up to which the operator has found the scan to be right still [s]; None for the server's limit.
        lets_go: objects that hands may let go, as the operator confirmed.

    Raises:
        RequestError: the plan is not open, or its newest review does not accept it.
        ServiceError: the page showed another trajectory, or something changed and was not acknowledged.
        PlannerError: the server refuses the plan.
    """
    record = _find_opened(session, plan_id).record
    _require_shown(record, trajectory_sha256 == record.result.trajectory.sha256)
    if not record.reviews or record.reviews[-1].decision != Decision.DECISION_ACCEPTED:
        raise RequestError(f"plan {plan_id} is not accepted; accept it first")
    # A server without a key signs no approvals, and could not tell that this one was withdrawn.
    newest = (await session.client.get_plan(plan_id)).record.reviews[-1]
    if newest != record.reviews[-1]:
        decision = "accepted" if newest.decision == Decision.DECISION_ACCEPTED else "rejected"
        raise ServiceError(f"plan {plan_id} was {decision} by {newest.reviewer} since; open it again and look at it")
    approval = newest.approval
    after, carried_out = await session.robot.execute(
        plan_id, trajectory_sha256, approval, revision, is_placed=is_placed, scan_age_s=scan_age_s, lets_go=lets_go
    )
    return {"revision": after, "trajectory_sha256": carried_out}


async def _find_scan_age_s(client: AsyncPlannerClient, record: PlanRecord, scene: Mapping[str, Any]) -> float | None:
    """Return the age of what a plan knows of its surroundings, as servers count it [s]; None without a scan."""
    name = scene.get("file")
    if not (name or scene.get("cloud")):
        return None
    begin = record.created.ToNanoseconds()
    if name:  # built before the plan was asked for, perhaps by somebody else
        with suppress(PlannerError):  # a caller of a role that sees no scenes
            async for known in client.list_scenes(limit=MOST_SCENES):
                if known.scene_id == name:
                    begin = min(begin, known.created.ToNanoseconds())
    return max(0.0, time.time() - 1e-9 * begin)


def _find_opened(session: OperatorSession, plan_id: str) -> OpenedPlan:
    opened = session.opened.get(plan_id)
    if opened is None:
        raise RequestError(f"plan {plan_id} is not open; open it and look at it first")
    return opened


def _require_shown(record: PlanRecord, is_shown: bool) -> None:
    if not is_shown:
        raise ServiceError(
            f"plan {record.plan_id} was opened again since, and is not what this page shows; open it again"
        )


def _make_listed_row(plan: PlanSummary) -> dict[str, Any]:
    """Return the row of a plan; what its reviews say is shown once it is open."""
    can_be_accepted = bool(plan.trajectory_sha256 and plan.certificate_sha256)
    return {
        "plan_id": plan.plan_id,
        "task": plan.task,
        "state": _name_state(plan.state),
        "verdict": Verdict.Name(plan.verdict).removeprefix("VERDICT_") if plan.verdict in _KNOWN else "",
        "created": plan.created.ToJsonString() if plan.HasField("created") else "",
        "is_approved": plan.is_approved,
        "is_rejected": can_be_accepted and not (plan.is_approved or plan.needs_review),
        "needs_decision": plan.needs_review,
        "reason": plan.reason,
    }


def _make_row(record: PlanRecord) -> dict[str, Any]:
    """Return the row of an open plan, with its reviews and what they are bound to."""
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
    last_accepts = bool(reviews) and reviews[-1]["is_accepted"]
    return {
        "plan_id": record.plan_id,
        "state": _name_state(record.state),
        "verdict": read_verdict(record.result) if is_finished else "",
        "created": record.created.ToJsonString() if record.HasField("created") else "",
        "is_approved": record.is_approved,
        "is_rejected": bool(reviews) and not last_accepts,
        "needs_decision": record.needs_review,
        "reason": record.reason,
        "reviews": reviews,
        "trajectory_sha256": record.result.trajectory.sha256,
        "certificate_sha256": record.result.certificate.sha256,
        "page_sha256": record.page_sha256,
    }


def _name_state(state: PlanState) -> str:
    return PlanState.Name(state).removeprefix("PLAN_STATE_").lower()
