"""``scopt review``: show a plan, its hashes and its reviews, and add a review."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command import command
from service.cli.options import Json, ServerOptions
from service.cli.report import print_result, print_table
from service.cli.run import consoles, print_json
from service.errors import RequestError

if TYPE_CHECKING:
    from google.protobuf.timestamp_pb2 import Timestamp

    from service.proto.planner.v1.planner_pb2 import PlanRecord

_COLUMNS = ("decision", "reviewer", "time", "verdict", "expires", "comment")


@command()
def review_command(
    plan_id: Annotated[str, typer.Argument(help="Id that scopt request printed.", metavar="PLAN_ID")],
    server: ServerOptions,
    is_accepted: Annotated[
        bool | None, typer.Option("--accept/--reject", help="Your decision.", show_default=False)
    ] = None,
    comment: Annotated[str, typer.Option(help="Reason of the decision.")] = "",
    despite: Annotated[
        str,
        typer.Option(help="Accept a plan that is not CERTIFIED: its verdict.", metavar="VERDICT", show_default=False),
    ] = "",
    valid_days: Annotated[
        float | None, typer.Option(help="Validity of --accept in days (30).", min=0.001, max=366.0)
    ] = None,
    is_revoked: Annotated[bool, typer.Option("--revoke", help="Withdraw the approval.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the plan's files, viewer.html among them.")] = None,
    as_json: Json = False,
) -> None:
    """Accept or reject a plan of a server, or withdraw its approval.

    The review is bound to the verdict and to the hashes of the trajectory, the certificate and the viewer's page that
    are shown. An acceptance is valid for --valid-days; that of a plan without CERTIFIED needs --despite. The decision
    and its reviews are shown first, then the plan. With --out, its files are fetched, with approval.json and
    revocation.json if the server signs them.
    """
    from service.cli.connect import connect
    from service.client.answers import summarize
    from service.proto.planner.v1.planner_pb2 import PlanState
    from service.result.folder import ResultFiles

    if is_revoked and is_accepted is not None:
        raise typer.BadParameter("--revoke goes without --accept and --reject")
    if is_accepted is not True and (despite or valid_days is not None):
        raise typer.BadParameter("--despite and --valid-days go with --accept")
    stdout, stderr = consoles()
    with connect(server, stderr) as client:
        stored = client.get_plan(plan_id, out=out)
        record, files = stored.record, None if stored.folder is None else ResultFiles(stored.folder)
        if not record.HasField("result"):
            state = PlanState.Name(record.state).removeprefix("PLAN_STATE_").lower()
            raise RequestError(f"plan {plan_id} is {state}; expected a finished plan")
        if is_revoked:
            client.revoke(record, comment=comment)
        elif is_accepted is not None:
            client.review(record, accept=is_accepted, comment=comment, despite=despite, valid_days=valid_days)
        if is_revoked or is_accepted is not None:
            record = client.get_plan(plan_id, out=out).record  # with what the server has signed
    rows = list_reviews(record)
    if as_json:
        print_json(
            {
                **summarize(record.result),
                "plan_id": record.plan_id,
                **({} if files is None else files.to_json()),
                "trajectory_sha256": record.result.trajectory.sha256,
                "certificate_sha256": record.result.certificate.sha256,
                "page_sha256": record.page_sha256,
                "is_approved": record.is_approved,
                "reviews": [dict(zip(_COLUMNS, row, strict=True)) for row in rows],
            }
        )
        return
    state = "approved" if record.is_approved else "not approved"
    stdout.print(f"plan {record.plan_id} is {state}", markup=False, soft_wrap=True)
    if rows:
        print_table(stdout, _COLUMNS, rows)
    lines = {
        "trajectory": record.result.trajectory.sha256 or "none",
        "certificate": record.result.certificate.sha256 or "none",
        "page": record.page_sha256 or "none",
        **({} if files is None else {"viewer": files.viewer}),
    }
    print_result(stdout, summarize(record.result), lines)


def list_reviews(record: PlanRecord) -> list[tuple[str, ...]]:
    """Return a row of ``_COLUMNS`` for each review: a rejection after an acceptance is called REVOKED."""
    from service.proto.planner.v1.planner_pb2 import Decision
    from service.proto.planner.v1.result_pb2 import Verdict

    rows: list[tuple[str, ...]] = []
    was_accepted = False
    for number, review in enumerate(record.reviews, start=1):
        decision, expires = Decision.Name(review.decision).removeprefix("DECISION_"), ""
        if review.decision == Decision.DECISION_ACCEPTED:
            is_expired = number == len(record.reviews) and not record.is_approved
            expires = _format_time(review.expires) if review.HasField("expires") else "without validity"
            expires = f"expired ({expires})" if is_expired else expires
        elif was_accepted:
            decision = "REVOKED"
        was_accepted = review.decision == Decision.DECISION_ACCEPTED
        verdict = Verdict.Name(review.verdict).removeprefix("VERDICT_") if review.verdict else ""
        rows.append((decision, review.reviewer, _format_time(review.time), verdict, expires, review.comment))
    return rows


def _format_time(stamp: Timestamp) -> str:
    return f"{stamp.ToDatetime().isoformat(' ', 'seconds')} UTC"
