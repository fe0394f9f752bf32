"""``scopt top``: the state of a server, once or updated on a terminal."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from service.cli.command import command
from service.cli.options import Json, ServerOptions
from service.cli.run import consoles, print_json

if TYPE_CHECKING:
    from service.proto.planner.v1.planner_pb2 import GetStatusResponse

MIB = 2**20


@command()
def top_command(
    server: ServerOptions,
    every: Annotated[float, typer.Option(help="Seconds between updates.", min=0.1)] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Print once; always so if stdout is no terminal.")] = False,
    as_json: Json = False,
) -> None:
    """Show the workers, queue, verdicts and latencies of a server.

    Updated until Ctrl-C.
    """
    from rich.live import Live

    from service.cli.connect import connect
    from service.client import PlannerError

    stdout, stderr = consoles()
    with connect(server, stderr, attempts=1) as client:
        status = client.status()
        if as_json:
            print_json(status_to_json(status))
        elif once or not stdout.is_terminal:
            stdout.print(draw_status(status, server.target))
        else:
            try:
                with Live(draw_status(status, server.target), console=stdout, auto_refresh=False) as live:
                    while True:
                        time.sleep(every)
                        try:
                            status, problem = client.status(), ""
                        except PlannerError as error:
                            problem = str(error)
                        live.update(draw_status(status, server.target, problem), refresh=True)
            except KeyboardInterrupt:
                return


def status_to_json(status: GetStatusResponse) -> dict[str, Any]:
    """Return a status as JSON data."""
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


def draw_status(status: GetStatusResponse, target: str, problem: str = "") -> Group:
    """Lay out a status for the terminal; ``problem`` is the error of the last update."""
    head = Text(f"scopt {status.version} at {target}, up {_describe_span(status.uptime_s)}")
    if problem:
        head.append(f"   {' '.join(problem.split())}", style="bold red")
    elif status.is_draining:
        head.append("   draining: no new requests", style="bold yellow")
    lines = [
        f"queue       {status.queued} of {status.queue_limit}",
        f"solve       {_describe_latency(status)}",
        f"memory      {status.resident_bytes / MIB:.0f} MB, {status.worker_restarts} workers restarted",
        f"verdicts    {', '.join(f'{name} {count}' for name, count in _sort_by_count(status)) or 'none yet'}",
    ]
    table = Table(box=None, pad_edge=False)
    for column in ("worker", "state", "work", "done", "MB"):
        table.add_column(column, justify="right" if column in ("done", "MB") else "left")
    for worker in status.workers:
        memory = f"{worker.resident_bytes / MIB:.0f}"
        table.add_row(*map(Text, (str(worker.pid), worker.state, worker.work, str(worker.jobs_done), memory)))
    return Group(head, *(Text(line) for line in lines), Text(), table)


def _describe_latency(status: GetStatusResponse) -> str:
    if not status.verdicts:
        return "none yet"
    return f"median {status.solve_p50_s:.2f} s, 99 % within {status.solve_p99_s:.2f} s"


def _sort_by_count(status: GetStatusResponse) -> list[tuple[str, int]]:
    return sorted(status.verdicts.items(), key=lambda verdict: (-verdict[1], verdict[0]))


def _describe_span(seconds: float) -> str:
    """``1 d 2 h``, ``3 min 4 s``: the two largest units."""
    whole = int(seconds)
    counts = (("d", whole // 86400), ("h", whole // 3600 % 24), ("min", whole // 60 % 60), ("s", whole % 60))
    first = next((index for index, (_, count) in enumerate(counts) if count), len(counts) - 1)
    return " ".join(f"{count} {unit}" for unit, count in counts[first : first + 2])
