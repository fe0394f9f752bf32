"""``scopt top``: what a server is doing, once or as it goes on."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from service.cli.connect import connected
from service.cli.run import consoles, print_json
from service.client import PlannerError
from service.proto.planner.v1.planner_pb2 import GetStatusResponse

MIB = 2**20


def watch(where: Mapping[str, Any], every_s: float, once: bool, as_json: bool) -> None:
    """Look at a server until Ctrl-C; once with ``as_json`` or where stdout is no terminal.

    Raises:
        EndedError: it could not be reached at the first look.
    """
    out, err = consoles()
    with connected(where, err) as client:
        status = client.status()
        if as_json:
            print_json(status_json(status))
        elif once or not out.is_terminal:
            out.print(drawn(status, where["target"]))
        else:
            try:
                with Live(drawn(status, where["target"]), console=out, auto_refresh=False) as live:
                    while True:
                        time.sleep(every_s)
                        try:
                            status, away = client.status(), ""
                        except PlannerError as error:
                            away = str(error)
                        live.update(drawn(status, where["target"], away), refresh=True)
            except KeyboardInterrupt:
                return


def status_json(status: GetStatusResponse) -> dict[str, Any]:
    """A status as JSON data."""
    fields = (
        "version", "uptime_s", "queued", "queue_limit", "worker_restarts", "solve_p50_s", "solve_p99_s", "is_draining",
        "resident_bytes",
    )  # fmt: skip
    columns = ("pid", "state", "work", "jobs_done", "resident_bytes")
    return {
        **{field: getattr(status, field) for field in fields},
        "workers": [{column: getattr(worker, column) for column in columns} for worker in status.workers],
        "verdicts": dict(sorted(status.verdicts.items())),
    }


def drawn(status: GetStatusResponse, target: str, away: str = "") -> Group:
    """A status for the terminal; ``away`` is why it is an old one."""
    head = Text(f"scopt {status.version} at {target}, up {_span(status.uptime_s)}")
    if away:
        head.append(f"   {' '.join(away.split())}", style="bold red")
    elif status.is_draining:
        head.append("   draining: no new requests", style="bold yellow")
    lines = [
        f"queue       {status.queued} of {status.queue_limit}",
        f"solve       {_latency(status)}",
        f"memory      {status.resident_bytes / MIB:.0f} MB, {status.worker_restarts} workers restarted",
        f"verdicts    {', '.join(f'{name} {count}' for name, count in _by_count(status)) or 'none yet'}",
    ]
    table = Table(box=None, pad_edge=False)
    for column in ("worker", "state", "work", "done", "MB"):
        table.add_column(column, justify="right" if column in ("done", "MB") else "left")
    for worker in status.workers:
        memory = f"{worker.resident_bytes / MIB:.0f}"
        table.add_row(*map(Text, (str(worker.pid), worker.state, worker.work, str(worker.jobs_done), memory)))
    return Group(head, *(Text(line) for line in lines), Text(), table)


def _latency(status: GetStatusResponse) -> str:
    if not status.verdicts:
        return "none yet"
    return f"median {status.solve_p50_s:.2f} s, 99 % within {status.solve_p99_s:.2f} s"


def _by_count(status: GetStatusResponse) -> list[tuple[str, int]]:
    return sorted(status.verdicts.items(), key=lambda one: (-one[1], one[0]))


def _span(seconds: float) -> str:
    """``1 d 2 h``, ``3 min 4 s``: the two largest units."""
    whole = int(seconds)
    counts = (("d", whole // 86400), ("h", whole // 3600 % 24), ("min", whole // 60 % 60), ("s", whole % 60))
    first = next((index for index, (_, count) in enumerate(counts) if count), len(counts) - 1)
    return " ".join(f"{count} {unit}" for unit, count in counts[first : first + 2])
