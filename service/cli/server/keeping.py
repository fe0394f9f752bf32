"""``scopt backup`` and ``scopt prune``: the data folder of a server, copied and cleared of old plans."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_line
from service.cli.run import consoles, print_json

DAY_S = 86400.0
Data = Annotated[Path, typer.Argument(help="Folder of scopt serve --data.", metavar="DATA")]


@command()
def backup_command(
    data: Data,
    target: Annotated[Path, typer.Argument(help="New folder of the copy.", metavar="TO")],
    as_json: Json = False,
) -> None:
    """Copy the data of a server, which may run meanwhile; the copy is a folder for scopt serve --data."""
    from dataclasses import asdict

    from service.store.backup import back_up

    made = back_up(data, target)
    if as_json:
        print_json({"target": str(target), **asdict(made)})
        return
    out = consoles()[0]
    size = f"{made.n_files} files, {made.n_bytes / 2**20:.1f} MiB"
    print_line(out, "copied", f"{made.n_plans} plans, {made.n_reviews} reviews, {made.n_scenes} scenes; {size}")
    for plan_id in made.damaged:
        print_line(out, "damaged", f"the files of plan {plan_id} are missing or not what was stored")


@command()
def prune_command(
    data: Data,
    older_days: Annotated[float, typer.Option("--older-than", help="Age of plans in days.", metavar="DAYS")],
    reviewed: Annotated[bool, typer.Option("--reviewed", help="Plans with reviews as well.")] = False,
    as_json: Json = False,
) -> None:
    """Delete old plans of a server that is stopped, with their files; those with reviews stay unless --reviewed."""
    from service.store import Store
    from service.store.backup import require_store

    if not older_days > 0.0:
        raise typer.BadParameter(f"--older-than: expected days above 0, got {older_days:g}")
    with Store(require_store(data)) as store:
        n = store.plans.delete_older(time.time() - older_days * DAY_S, with_reviewed=reviewed)
        left = store.stats()
    if as_json:
        print_json({"deleted": n, "left": left.n_plans})
        return
    print_line(consoles()[0], "deleted", f"{n} plans; {left.n_plans} are left")
