"""Plan a request on this machine and write its result: what ``plan``, ``task run`` and ``move`` have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from costs.threads import use_all_cores
from service.cli.options import PlanningOptions
from service.cli.report import TRIED_COLUMNS, list_files, list_tried, print_result, print_table, print_verdict
from service.cli.run import cancellable, consoles, print_json, progress

if TYPE_CHECKING:
    from service.request.schema import PlanRequest
    from service.setup.world import Surroundings


def plan_and_write(
    read: Callable[[], tuple[PlanRequest, Surroundings | None]],
    folder: Path,
    planning: PlanningOptions,
    *,
    as_json: bool,
) -> str:
    """Plan a request, write the result, print its summary; return the verdict.

    Args:
        read: returns the request, and what its scan shows if that is known already.
        folder: of the result.
        planning: what replaces options of the request, and how much is printed.
        as_json: whether the summary is printed as JSON.
    """
    stdout, stderr = consoles()
    with progress(stderr, "read request", is_quiet=planning.quiet) as report, cancellable(stderr) as should_stop:
        report("read request", 0.0)
        plan_request, around = read()
        from costs.native import describe_missing
        from service.planner import plan
        from service.request.file import replace_options
        from service.result.folder import RESULT_NAME, check_folder
        from service.result.output import write_result
        from service.result.result import Verdict
        from service.result.result_json import summary_json

        check_folder(folder)
        use_all_cores()
        plan_request = replace_options(plan_request, planning.overrides)
        result = plan(plan_request, on_progress=report, should_stop=should_stop, around=around)
        # Ctrl-C may come when the plan is about to end by itself: it is cancelled all the same.
        is_kept = (result.verdict is Verdict.CANCELLED or should_stop()) and (folder / RESULT_NAME).is_file()
        if is_kept:
            result = dataclasses.replace(result, verdict=Verdict.CANCELLED)
        written = None
        if not is_kept:
            report("write result", 1.0)
            written = write_result(result, folder)
    summary = summary_json(result)
    if written is None:
        stderr.print(f"{folder} keeps its earlier result", markup=False, soft_wrap=True)
    if as_json:
        print_json({**summary, **({} if written is None else written.to_json())})
    elif planning.quiet:
        print_verdict(stdout, summary)
    else:
        if planning.verbose:
            print_table(stdout, TRIED_COLUMNS, list_tried(result))
        print_result(stdout, summary, list_files(written, summary), is_verbose=planning.verbose)
        if describe_missing():
            stderr.print(describe_missing(), markup=False, soft_wrap=True)
    return str(result.verdict.value)
