"""``scopt stance``: where to stand for a task."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from costs.threads import use_all_cores
from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_line, print_table
from service.cli.run import cancellable, consoles, print_json, progress

MOST_ROWS = 8


@command()
def stance_command(
    request: Annotated[
        Path, typer.Argument(help="Request file with task.door, task.valve or task.mechanism.", metavar="REQUEST")
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for stance.json and stance.svg; by default out/NAME-stance.", show_default=False),
    ] = None,
    write: Annotated[
        Path | None, typer.Option(help="File for the request with the best start.base.", metavar="REQUEST_OUT")
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit", help="Seconds the search may take; 20 s of processor time by default.", min=0.1, max=3600.0
        ),
    ] = None,
    radius: Annotated[
        float, typer.Option("--radius", help="Of the places searched about the start, in metres.", min=0.05, max=5.0)
    ] = 1.0,
    as_json: Json = False,
) -> str | None:
    """Search for places to stand near the start, scored by reach, opening angle, balance and clearance.

    The robot stands in the start's posture. Nothing is planned: poses exist from the best place, motions may not.
    """
    stdout, stderr = consoles()
    use_all_cores()
    with progress(stderr, "read request") as report, cancellable(stderr) as should_stop:
        from service.request.file import load_request
        from service.result.stance_output import describe_search, write_request, write_search
        from service.tasks.stances.search import find_stance

        search = find_stance(load_request(request), time_limit, radius, report, should_stop)
        folder = out if out is not None else Path("out") / f"{request.stem}-stance"
        data, picture = write_search(search, folder)
        best = search.best
        if write is not None and best is not None:
            write_request(request, best, write)
    summary = describe_search(search)
    if as_json:
        print_json({**summary, "picture": str(picture)})
    else:
        rows = [
            (
                f"{candidate['score']:.2f}",
                ", ".join(f"{value:.2f}" for value in candidate["base"]["position"][:2]),
                f"{candidate['yaw_deg']:.0f}",
                _describe_reached(candidate["parts"]),
                f"{1e3 * candidate['parts']['balance_m']:.0f}",
                f"{1e3 * candidate['parts']['clearance_m']:.0f}",
                candidate["hold"] + (f" ({candidate['missing']})" if candidate["missing"] else ""),
            )
            for candidate in summary["candidates"]
            if not candidate["refused"]
        ]
        header = ("score", "base x, y", "yaw", "reached", "balance mm", "clear mm", "hold")
        print_table(stdout, header, rows[:MOST_ROWS])
        for note in summary["notes"]:
            stdout.print(f"note: {note}", markup=False, soft_wrap=True)
        if best is None and (summary["candidates"] or not search.is_complete):  # else a note says why
            stdout.print(_describe_failure(summary, time_limit), markup=False, soft_wrap=True)
        print_line(stdout, "picture", picture)
        print_line(stdout, "scores", data)
        if write is not None and best is not None:
            print_line(stdout, "request", write)
    if best is not None:
        return None
    return "NOT_FOUND" if search.is_complete else "TIME_LIMIT"


def _describe_failure(summary: Mapping[str, Any], time_limit: float | None) -> str:
    """Return why no place was found."""
    if not summary["candidates"]:
        within = "20 s of processor time" if time_limit is None else f"{time_limit:g} s"
        return f"no place to stand was found: none could be examined within {within}; raise --time-limit"
    first = summary["candidates"][0]
    return f"no place to stand was found; for example: {first['refused'][0] if first['refused'] else first['missing']}"


def _describe_reached(parts: Mapping[str, Any]) -> str:
    """Return how far the mechanism gets, as an angle or as a share of its way."""
    if parts["angle_deg"] is None:
        return f"{100.0 * parts['share']:.0f} %"
    return f"{parts['angle_deg']:.0f} of {parts['asked_deg']:.0f} deg"
