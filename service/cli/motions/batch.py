"""``scopt batch``: many requests at once."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from service.cli.command import command
from service.cli.options import Json, PlanningOptions
from service.cli.run import cancellable, consoles, print_json, progress


@command()
def batch_command(
    requests: Annotated[list[Path], typer.Argument(help="Request files (YAML or JSON).", metavar="REQUEST")],
    planning: PlanningOptions,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder; each result is OUT/NAME of its request.")] = Path(
        "out"
    ),
    jobs: Annotated[int | None, typer.Option(help="Plans at once; by default one for each core.", min=1)] = None,
    as_json: Json = False,
) -> str:
    """Plan many requests at once, on all cores, and print a line for each as it ends.

    The exit code is 0 if all are CERTIFIED, else that of the first request which is not.
    """
    stdout, stderr = consoles()
    names = [path.stem for path in requests]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise typer.BadParameter(f"two requests are named {twice!r}, and so would be their folders; rename one")
    with progress(stderr, "plan requests", is_quiet=planning.quiet) as report, cancellable(stderr) as should_stop:
        from service.bench.batch import BatchRow, find_batch_verdict, plan_many

        done: list[BatchRow] = []
        width = max(map(len, names))

        def show(row: BatchRow) -> None:
            done.append(row)
            report(f"{len(done)} of {len(names)} planned", len(done) / len(names))
            if as_json or planning.quiet:
                return
            clearance = "" if row.clearance_m is None else f"clearance {1e3 * row.clearance_m:.1f} mm"
            text = "  ".join(part for part in (clearance, f"{row.planning_time_s:.1f} s", row.reason) if part)
            stdout.print(f"{row.verdict:<19}  {row.name:<{width}}  {text}", markup=False, soft_wrap=True)

        rows = plan_many(
            dict(zip(names, requests, strict=True)),
            out,
            jobs=jobs,
            options=planning.overrides,
            on_row=show,
            should_stop=should_stop,
        )
    n_certified = sum(row.verdict == "CERTIFIED" for row in rows)
    if as_json:
        listed = [
            {**dataclasses.asdict(row), "folder": None if row.folder is None else str(row.folder)} for row in rows
        ]
        print_json({"certified": n_certified, "results": listed})
    else:
        stdout.print(f"{n_certified} of {len(rows)} CERTIFIED, results in {out}", markup=False, soft_wrap=True)
    return find_batch_verdict(rows)
