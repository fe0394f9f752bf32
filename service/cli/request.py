"""``scopt request``: a request file to a server and its answer to a folder, with what happens in between."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from service.cli.connect import connected
from service.cli.report import print_figures, print_findings, print_verdict
from service.cli.run import consoles, print_json, progress
from service.client.clouds import local_files
from service.client.summary import summary_of
from service.proto.planner.v1.planner_pb2 import Iteration, PlanResponse
from service.request.file import load_request
from service.request.schema import check_planned
from service.result.folder import ResultFiles, check_folder

SELDOM_S = 1.0  # between two iterations in a log file


def request_plan(
    where: Mapping[str, Any],
    request_file: Path,
    folder: Path,
    deadline_s: float | None,
    request_id: str | None,
    as_json: bool,
) -> str:
    """Have it planned and print what came of it; returns the verdict."""
    out, err = consoles()
    with progress(err, "read request") as report:
        report("read request", 0.0)
        request = load_request(request_file)
        check_planned(request)
        check_folder(folder)
        with connected(where, err) as client:
            names = ", ".join(local_files(request))
            report(f"upload {names}, send request" if names else "send request", 0.0)
            tell = _Teller(report, 0.0 if err.is_terminal else SELDOM_S)
            plan = client.plan(request, request_id=request_id, out=folder, on_progress=tell, deadline_s=deadline_s)
    summary = summary_of(plan.result)
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


class _Teller:
    """Says the events of a plan in a line each; of iterations at most one in ``seldom_s``."""

    def __init__(self, report: Callable[[str, float], None], seldom_s: float) -> None:
        self._report = report
        self._seldom_s = seldom_s
        self._told = time.monotonic()

    def __call__(self, event: PlanResponse) -> None:
        match event.WhichOneof("event"):
            case "accepted":
                known = " (known)" if event.accepted.is_known else ""
                self._report(f"accepted as {event.accepted.plan_id}{known}", 0.0)
            case "queued":
                wait = f", about {event.queued.expected_wait_s:.1f} s" if event.queued.place else ""
                self._report(f"queued behind {event.queued.place}{wait}", 0.0)
            case "progress":
                self._progress(event)
            case _:
                pass

    def _progress(self, event: PlanResponse) -> None:
        told = event.progress
        if not told.HasField("iteration"):
            self._report(told.step, told.fraction)
        elif (now := time.monotonic()) - self._told >= self._seldom_s:
            self._told = now
            self._report(f"{told.step}: {_said(told.iteration)}", told.fraction)


def _said(iteration: Iteration) -> str:
    text = f"iteration {iteration.index}, merit {iteration.merit:.4g}, mu {iteration.mu:g}"
    if not iteration.violations:
        return text
    worst, value = max(iteration.violations.items(), key=lambda one: one[1])
    return f"{text}, {worst} off by {value:.2g}" if value > 0.0 else f"{text}, all constraints hold"
