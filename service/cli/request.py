"""``scopt request``: plan a request file on a server, with progress on stderr and the result in a folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from service.cli.connect import connect
from service.cli.remote import ServerOptions
from service.cli.report import print_figures, print_findings, print_verdict
from service.cli.run import consoles, print_json, progress
from service.client.answers import summarize
from service.client.local_files import find_local_files
from service.proto.planner.v1.planner_pb2 import Iteration, PlanProgress, PlanResponse
from service.request.file import load_request
from service.request.schema import check_task_has_planner
from service.result.folder import ResultFiles, check_folder

LOG_PERIOD_S = 1.0  # between two iterations if stderr is no terminal


def request_plan(
    server: ServerOptions,
    request_file: Path,
    folder: Path,
    deadline_s: float | None,
    request_id: str | None,
    as_json: bool,
) -> str:
    """Plan a request, print the result and return the verdict."""
    out, err = consoles()
    with progress(err, "read request") as report:
        report("read request", 0.0)
        request = load_request(request_file)
        check_task_has_planner(request)
        check_folder(folder)
        with connect(server, err) as client:
            names = ", ".join(find_local_files(request))
            report(f"upload {names}, send request" if names else "send request", 0.0)
            show_event = _EventReport(report, 0.0 if err.is_terminal else LOG_PERIOD_S)
            plan = client.plan(
                request, request_id=request_id, out=folder, on_progress=show_event, deadline_s=deadline_s
            )
    summary = summarize(plan.result)
    files = None if plan.folder is None else ResultFiles(plan.folder)
    if as_json:
        paths = {} if files is None else {"result": str(files.result), "viewer": str(files.viewer)}
        print_json({**summary, "plan_id": plan.plan_id, "request_id": plan.request_id, **paths})
        return plan.verdict
    print_findings(out, summary)
    print_figures(out, summary)
    out.print(f"plan             {plan.plan_id}", markup=False, soft_wrap=True)
    if files is not None:
        out.print(f"viewer           {files.viewer}", markup=False, soft_wrap=True)
        out.print(f"trajectory       {files.trajectory}", markup=False, soft_wrap=True)
    print_verdict(out, summary)
    return plan.verdict


class _EventReport:
    """Report of a plan's events, one line each; at most one iteration per ``period_s``."""

    def __init__(self, report: Callable[[str, float], None], period_s: float) -> None:
        self._report = report
        self._period_s = period_s
        self._last_iteration_s = time.monotonic()

    def __call__(self, event: PlanResponse) -> None:
        match event.WhichOneof("event"):
            case "accepted":
                known = " (known)" if event.accepted.is_known else ""
                self._report(f"accepted as {event.accepted.plan_id}{known}", 0.0)
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
