"""``scopt execute``: a stored plan carried out on the robot of a server, watched to its end."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from service.cli.command import command
from service.cli.operation.watch import describe_state, read_mode, state_to_json
from service.cli.options import Json, ServerOptions
from service.cli.report import print_line, print_verdict
from service.cli.run import consoles, print_json

if TYPE_CHECKING:
    from service.proto.planner.v1.execution_pb2 import WatchResponse

ENDS = {"done": "DONE", "aborted": "ABORTED", "fallen": "FELL", "lost": "ABORTED"}


@command(has_verdict=True)
def execute_command(
    plan_id: Annotated[str, typer.Argument(help="Id of a certified plan with files.", metavar="PLAN_ID")],
    server: ServerOptions,
    trajectory: Annotated[
        str,
        typer.Option(
            help="Hash of the trajectory that you looked at; by default that of the plan as it is now.",
            metavar="SHA256",
            show_default=False,
        ),
    ] = "",
    start_tolerance: Annotated[
        float, typer.Option(help="How far each joint may be from the plan's start, in radians or metres.")
    ] = 0.05,
    place: Annotated[bool, typer.Option("--place", help="Put a simulated robot at the plan's start first.")] = False,
    accept_scan_age: Annotated[
        float | None,
        typer.Option(help="Seconds up to which you have found the plan's scan to be right still.", show_default=False),
    ] = None,
    lets_go: Annotated[
        list[str] | None,
        typer.Option(help="Object that the plan's hands may let go; repeatable, needed for each.", show_default=False),
    ] = None,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="Take the control of the robot from whoever has it.")
    ] = False,
    as_json: Json = False,
) -> str:
    """Carry out a stored plan on the robot of a server, and watch it to its end.

    The verdict is DONE, ABORTED or FELL. This command has the control of the robot meanwhile; when it ends early, the
    robot does as scopt serve --when-alone says.
    """
    from service.cli.connect import connect
    from service.client import PlannerError

    stdout, stderr = consoles()
    with connect(server, stderr, attempts=1) as client:
        sha256 = trajectory or client.get_plan(plan_id).record.result.trajectory.sha256
        taken = client.take_control(f"scopt execute on {socket.gethostname()}"[:60], takes_over=take_over)
        states = client.watch(lease=taken.lease)
        try:
            first = next(states)
            begun = client.execute(
                plan_id,
                sha256,
                lease=taken.lease,
                revision=first.revision,
                start_tolerance=start_tolerance,
                is_placed=place,
                accepted_scan_age_s=accept_scan_age,
                lets_go=lets_go or (),
            )
            last = _watch(states, begun.revision, stderr)
        finally:
            states.close()
            with suppress(PlannerError):  # somebody else has taken it
                client.command("release_control", lease=taken.lease)
    verdict = ENDS[read_mode(last)]
    if as_json:
        print_json({"verdict": verdict, **state_to_json(last)})
    else:
        print_line(stdout, "trajectory", last.plan.trajectory_sha256)
        print_verdict(stdout, {"verdict": verdict, "explanation": [last.status.reason or "the plan was carried out"]})
    return verdict


def _watch(states: Iterator[WatchResponse], begun: int, stderr: Console) -> WatchResponse:
    """Print the changes of mode and phase from a revision on, until the plan is over; return the last state."""
    told: Any = None
    for state in states:
        if state.revision < begun:  # of the plan before
            continue
        key = (state.status.mode, state.status.phase, state.status.reason)
        if key != told:
            told = key
            stderr.print(describe_state(state), markup=False, soft_wrap=True)
        if read_mode(state) in ENDS:
            return state
    raise RuntimeError("the server ended the call")
