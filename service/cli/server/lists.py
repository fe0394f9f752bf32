"""``scopt plans`` and ``scopt scenes``: what a server has stored, newest first."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command import command
from service.cli.options import Json, ServerOptions
from service.cli.report import print_table
from service.cli.run import consoles, print_json

if TYPE_CHECKING:
    from google.protobuf.timestamp_pb2 import Timestamp

    from service.proto.planner.v1.planner_pb2 import PlanSummary, SceneSummary

SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d)")
UNITS_S = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
MAX_SPAN_S = 1e9
Since = Annotated[
    str,
    typer.Option(
        help="Only those since then: a span such as 30min, 2h or 7d, or a time such as 2027-01-31T12:00 (UTC).",
        metavar="SPAN|TIME",
        show_default=False,
    ),
]
Limit = Annotated[int, typer.Option(help="At most so many.", min=1)]


@command()
def plans_command(
    server: ServerOptions,
    state: Annotated[
        str, typer.Option(help="Only plans that are queued, running, finished or lost.", show_default=False)
    ] = "",
    since: Since = "",
    task: Annotated[str, typer.Option(help="Only plans of a kind of task, such as valve.", show_default=False)] = "",
    needs_review: Annotated[bool, typer.Option("--needs-review", help="Only plans that wait for a decision.")] = False,
    limit: Limit = 50,
    as_json: Json = False,
) -> None:
    """List the plans of a server, newest first: your own, or all with the role review or admin."""
    from service.cli.connect import connect

    stdout, stderr = consoles()
    begin = _read_since(since)
    with connect(server, stderr) as client:
        plans = list(client.list_plans(state=state, since=begin, task=task, needs_review=needs_review, limit=limit))
    rows = [_plan_to_json(plan) for plan in plans]
    if as_json:
        print_json({"plans": rows})
        return
    columns = ("plan", "client", "task", "state", "verdict", "created", "review")
    print_table(stdout, columns, [_plan_row(row) for row in rows])


@command()
def scenes_command(server: ServerOptions, since: Since = "", limit: Limit = 50, as_json: Json = False) -> None:
    """List the scenes of a server, newest first: your own, or all with the role review or admin."""
    from service.cli.connect import connect

    stdout, stderr = consoles()
    begin = _read_since(since)
    with connect(server, stderr) as client:
        scenes = list(client.list_scenes(since=begin, limit=limit))
    if as_json:
        print_json({"scenes": [_scene_to_json(scene) for scene in scenes]})
        return
    rows = [
        (scene.scene_id, scene.client, _format_time(scene.created), f"{scene.stored_bytes / 1024:.0f} KiB")
        for scene in scenes
    ]
    print_table(stdout, ("scene", "client", "created", "stored"), rows)


def _plan_row(row: dict[str, Any]) -> Sequence[str]:
    review = "approved" if row["is_approved"] else "needed" if row["needs_review"] else row["reason"]
    created = row["created"].replace("T", " ").replace("+00:00", " UTC")
    return (row["plan_id"], row["client"], row["task"], row["state"], row["verdict"], created, review)


def _plan_to_json(plan: PlanSummary) -> dict[str, Any]:
    from service.proto.planner.v1.planner_pb2 import PlanState
    from service.proto.planner.v1.result_pb2 import Verdict

    names = (
        "plan_id", "request_id", "client", "task", "is_approved", "needs_review", "trajectory_sha256",
        "certificate_sha256", "page_sha256", "reason",
    )  # fmt: skip
    return {
        **{name: getattr(plan, name) for name in names},
        "state": PlanState.Name(plan.state).removeprefix("PLAN_STATE_").lower(),
        "verdict": Verdict.Name(plan.verdict).removeprefix("VERDICT_") if plan.verdict else "",
        "created": _to_iso(plan.created),
        "finished": _to_iso(plan.finished) if plan.HasField("finished") else None,
    }


def _scene_to_json(scene: SceneSummary) -> dict[str, Any]:
    return {
        "scene_id": scene.scene_id,
        "client": scene.client,
        "created": _to_iso(scene.created),
        "stored_bytes": scene.stored_bytes,
    }


def _to_iso(stamp: Timestamp) -> str:
    return stamp.ToDatetime(UTC).isoformat(timespec="seconds")


def _format_time(stamp: Timestamp) -> str:
    return f"{stamp.ToDatetime().isoformat(' ', 'seconds')} UTC"


def _read_since(text: str) -> datetime | None:
    """Return the time that an option names; None for an empty one (``typer.BadParameter`` for another text)."""
    if not text:
        return None
    span = SPAN.fullmatch(text.strip())
    if span is not None and float(span[1]) * UNITS_S[span[2]] <= MAX_SPAN_S:
        return datetime.now(UTC) - timedelta(seconds=float(span[1]) * UNITS_S[span[2]])
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(
            f"--since {text!r}: expected a span such as 30min, 2h or 7d, or a time such as 2027-01-31T12:00"
        ) from None
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time
