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
    from service.proto.planner.v1.planner_pb2 import Review

_COLUMNS = ("decision", "reviewer", "time", "comment")


@command()
def review_command(
    plan_id: Annotated[str, typer.Argument(help="Id that scopt request printed.", metavar="PLAN_ID")],
    server: ServerOptions,
    is_accepted: Annotated[
        bool | None, typer.Option("--accept/--reject", help="Your decision.", show_default=False)
    ] = None,
    comment: Annotated[str, typer.Option(help="Reason of the decision.")] = "",
    out: Annotated[Path | None, typer.Option(help="Folder for the plan's files, viewer.html among them.")] = None,
    as_json: Json = False,
) -> None:
    """Accept or reject a plan of a server.

    The review is bound to the hashes of the trajectory, the certificate and the viewer's page that are shown. Without
    --accept or --reject, the plan and its reviews are shown. With --out, its files are fetched, with approval.json if
    the server signs approvals.
    """
    from service.cli.connect import connect
    from service.client.answers import summarize
    from service.proto.planner.v1.planner_pb2 import PlanState
    from service.result.folder import ResultFiles

    stdout, stderr = consoles()
    with connect(server, stderr) as client:
        stored = client.get_plan(plan_id, out=out)
        record, files = stored.record, None if stored.folder is None else ResultFiles(stored.folder)
        if not record.HasField("result"):
            state = PlanState.Name(record.state).removeprefix("PLAN_STATE_").lower()
            raise RequestError(f"plan {plan_id} is {state}; expected a finished plan")
        if not as_json:
            lines = {
                "trajectory": record.result.trajectory.sha256 or "none",
                "certificate": record.result.certificate.sha256 or "none",
                "page": record.page_sha256 or "none",
                **({} if files is None else {"viewer": files.viewer}),
            }
            print_result(stdout, summarize(record.result), lines)
        if is_accepted is not None:
            client.review(record, accept=is_accepted, comment=comment)
            record = client.get_plan(plan_id, out=out).record  # with its approval, if the server signs
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
                "reviews": [dict(zip(_COLUMNS, _make_row(review), strict=True)) for review in record.reviews],
            }
        )
        return
    if record.reviews:
        print_table(stdout, _COLUMNS, [_make_row(review) for review in record.reviews])
    state = "approved" if record.is_approved else "not approved"
    stdout.print(f"plan {record.plan_id} is {state}", markup=False, soft_wrap=True)


def _make_row(review: Review) -> tuple[str, str, str, str]:
    from service.proto.planner.v1.planner_pb2 import Decision

    decision = Decision.Name(review.decision).removeprefix("DECISION_")
    when = review.time.ToDatetime().isoformat(" ", "seconds")
    return decision, review.reviewer, f"{when} UTC", review.comment
