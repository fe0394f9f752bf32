"""``scopt review``: show a plan, its hashes and its reviews, and add a review."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from service.cli.connect import connect
from service.cli.remote import ServerOptions
from service.cli.report import print_figures, print_findings, print_table, print_verdict
from service.cli.run import consoles, print_json
from service.client.answers import summarize
from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import Decision, PlanRecord, PlanState, Review
from service.result.folder import ResultFiles

_COLUMNS = ("decision", "reviewer", "time", "comment")


def review_plan(
    server: ServerOptions,
    plan_id: str,
    is_accepted: bool | None,
    comment: str,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Show a plan and, unless ``is_accepted`` is None, review it.

    Args:
        folder: folder for the plan's files; None to leave them on the server.

    Raises:
        RequestError: the plan has not finished.
        ResultError: the folder holds something other than an earlier result, or cannot be written.
    """
    out, err = consoles()
    with connect(server, err) as client:
        stored = client.get_plan(plan_id, out=folder)
        record, files = stored.record, None if stored.folder is None else ResultFiles(stored.folder)
        if not record.HasField("result"):
            state = PlanState.Name(record.state).removeprefix("PLAN_STATE_").lower()
            raise RequestError(f"plan {plan_id} is {state}; expected a finished plan")
        if not as_json:
            _show(out, record, files)
        if is_accepted is not None:
            client.review(record, accept=is_accepted, comment=comment)
            record = client.get_plan(plan_id).record
    if as_json:
        print_json(
            {
                **summarize(record.result),
                "plan_id": record.plan_id,
                **({} if files is None else {"result": str(files.result), "viewer": str(files.viewer)}),
                "trajectory_sha256": record.result.trajectory.sha256,
                "certificate_sha256": record.result.certificate.sha256,
                "is_approved": record.is_approved,
                "reviews": [dict(zip(_COLUMNS, _make_row(review), strict=True)) for review in record.reviews],
            }
        )
        return
    if record.reviews:
        print_table(out, _COLUMNS, [_make_row(review) for review in record.reviews])
    state = "approved" if record.is_approved else "not approved"
    out.print(f"plan {record.plan_id} is {state}", markup=False, soft_wrap=True)


def _show(out: Console, record: PlanRecord, files: ResultFiles | None) -> None:
    summary = summarize(record.result)
    print_findings(out, summary)
    print_figures(out, summary)
    out.print(f"trajectory       {record.result.trajectory.sha256 or 'none'}", markup=False, soft_wrap=True)
    out.print(f"certificate      {record.result.certificate.sha256 or 'none'}", markup=False, soft_wrap=True)
    if files is not None:
        out.print(f"viewer           {files.viewer}", markup=False, soft_wrap=True)
    print_verdict(out, summary)


def _make_row(review: Review) -> tuple[str, str, str, str]:
    decision = Decision.Name(review.decision).removeprefix("DECISION_")
    when = review.time.ToDatetime().isoformat(" ", "seconds")
    return decision, review.reviewer, f"{when} UTC", review.comment
