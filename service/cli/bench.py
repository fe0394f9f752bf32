"""``scopt bench``: a problem set through the planner."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_line, print_table
from service.cli.run import consoles, print_json, progress


@command()
def bench_command(
    problems: Annotated[Path, typer.Argument(help="Problem file or folder of problem files.", metavar="PROBLEMS")],
    urdf: Annotated[Path, typer.Option(help="The robot that the problems are judged with.")],
    out: Annotated[Path, typer.Option(help="Result file; an earlier one is continued.")],
    srdf: Annotated[Path | None, typer.Option(help="Its SRDF.")] = None,
    package_root: Annotated[Path | None, typer.Option(help="Folder that package:// paths start at.")] = None,
    limit: Annotated[int | None, typer.Option(help="Most problems of a scene.", min=1)] = None,
    time_limit: Annotated[float, typer.Option(help="Seconds a problem may take.", min=0.01, max=3600.0)] = 2.0,
    as_json: Json = False,
) -> None:
    """Plan every problem of a set and print a table per scene."""
    stdout, stderr = consoles()
    with progress(stderr, "read problems") as report:
        report("read problems", 0.0)
        from service.bench.bench import COLUMNS, FAILURE_COLUMNS, list_failures, run_bench, summarize_scenes
        from service.bench.problem_set import BenchRobot, read_problems
        from service.errors import RequestError
        from service.start.robot import load_requested_robot

        options = {"time_limit_s": time_limit, "timed": False}
        problem_set = read_problems(problems, BenchRobot(urdf, srdf, package_root), options, limit)
        if not problem_set:
            raise RequestError(f"{problems} holds no problems")
        rows = run_bench(problem_set, load_requested_robot(problem_set[0].request, finds_package=True), out, report)
    summary = summarize_scenes(rows)
    if as_json:
        print_json({"results": str(out), "table": [dict(zip(COLUMNS, line, strict=True)) for line in summary]})
        return
    print_table(stdout, COLUMNS, summary)
    if failures := list_failures(rows):
        print_table(stdout, FAILURE_COLUMNS, failures)
    print_line(stdout, "results", out)
