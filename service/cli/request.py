"""``scopt request``: plan a request file on a server, with progress on stderr and the result in a folder."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command import command
from service.cli.options import Json, ServerOptions
from service.cli.report import list_files, print_result
from service.cli.run import Report, consoles, ended_by_sigterm, print_json, progress

if TYPE_CHECKING:
    from service.proto.planner.v1.planner_pb2 import Iteration, PlanProgress, PlanResponse

LOG_PERIOD_S = 1.0  # between two iterations if stderr is no terminal


@command(has_verdict=True)
def request_command(
    request: Annotated[Path, typer.Argument(help="Request file (YAML or JSON).", metavar="REQUEST")],
    server: ServerOptions,
    out: Annotated[Path | None, typer.Option(help="Result folder; by default out/NAME of the request.")] = None,
    deadline: Annotated[float | None, typer.Option(help="Time limit in seconds, queue included.", min=0.01)] = None,
    request_id: Annotated[
        str | None, typer.Option(help="Id of the request; the same id gives the same plan again.", metavar="ID")
    ] = None,
    batch: Annotated[bool, typer.Option("--batch", help="Let interactive requests go first.")] = False,
    attempts: Annotated[int, typer.Option(help="Attempts if the server is unreachable or overloaded.", min=1)] = 3,
    as_json: Json = False,
) -> str:
    """Plan a request on a server, write the result.

    The result folder is the one that plan writes. Local cloud, mesh and scene files of the request are uploaded. Ctrl-C
    stops the plan.
    """
    from service.cli.connect import connect
    from service.client.answers import summarize
    from service.client.local_files import find_local_files
    from service.request.file import load_request
    from service.result.folder import ResultFiles, check_folder

    folder = out if out is not None else Path("out") / request.stem
    stdout, stderr = consoles()
    with ended_by_sigterm(), progress(stderr, "read request") as report:
        report("read request", 0.0)
        plan_request = load_request(request)
        check_folder(folder)
        with connect(server, stderr, attempts) as client:
            names = ", ".join(find_local_files(plan_request))
            report(f"upload {names}, send request" if names else "send request", 0.0)
            show_event = _EventReport(report, 0.0 if stderr.is_terminal else LOG_PERIOD_S)
            plan = client.plan(
                plan_request,
                request_id=request_id,
                out=folder,
                on_progress=show_event,
                deadline_s=deadline,
                is_batch=batch,
            )
    summary = summarize(plan.result)
    files = None if plan.folder is None else ResultFiles(plan.folder)
    if as_json:
        paths = {} if files is None else files.to_json()
        print_json({**summary, "plan_id": plan.plan_id, "request_id": plan.request_id, **paths})
    else:
        print_result(stdout, summary, {"plan": plan.plan_id, **list_files(files, summary)})
    return plan.verdict


class _EventReport:
    """Report of a plan's events, one line each; at most one iteration per ``period_s``."""

    def __init__(self, report: Report, period_s: float) -> None:
        self._report = report
        self._period_s = period_s
        self._last_iteration_s = time.monotonic()

    def __call__(self, event: PlanResponse) -> None:
        match event.WhichOneof("event"):
            case "accepted":
                known = " (known)" if event.accepted.is_known else ""
                self._report(f"accepted as {event.accepted.plan_id}{known}", 0.0)
                for warning in event.accepted.warnings:
                    self._report(f"warning: {warning}", 0.0)
            case "queued":
                wait = f", about {event.queued.expected_wait_s:.1f} s" if event.queued.place else ""
                self._report(f"queued behind {event.queued.place}{wait}", 0.0)
            case "progress":
                self._report_progress(event.progress)
            case _:
                pass

    def _report_progress(self, progress: PlanProgress) -> None:
        if not progress.HasField("iteration"):
            self._report(progress.step, progress.fraction)
        elif (now := time.monotonic()) - self._last_iteration_s >= self._period_s:
            self._last_iteration_s = now
            self._report(f"{progress.step}: {_describe(progress.iteration)}", progress.fraction)


def _describe(iteration: Iteration) -> str:
    text = f"iteration {iteration.index}, merit {iteration.merit:.4g}, mu {iteration.mu:g}"
    if not iteration.violations:
        return text
    worst, value = max(iteration.violations.items(), key=lambda violation: violation[1])
    return f"{text}, {worst} off by {value:.2g}" if value > 0.0 else f"{text}, all constraints hold"
