"""``scopt command``: an order to the robot of a server."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli.command import command
from service.cli.options import Json, ServerOptions
from service.cli.run import consoles, print_json
from service.errors import RequestError

NEEDS_STATE = ("start", "pause", "resume", "abort", "retreat", "speed", "shift")
TAKES = {"take": False, "take-over": True}


@command()
def command_command(
    order: Annotated[
        str,
        typer.Argument(
            help="take, take-over, release, start, pause, resume, stop, abort, retreat, speed, shift.", metavar="ORDER"
        ),
    ],
    server: ServerOptions,
    lease: Annotated[
        str, typer.Option(help="What take or take-over printed; stop needs none.", envvar="SCOPT_LEASE")
    ] = "",
    revision: Annotated[
        int | None,
        typer.Option(help="Of the state that you have seen; by default the present one.", show_default=False),
    ] = None,
    speed: Annotated[float, typer.Option(help="With speed: share of real time, 0.01 to 1.")] = 0.0,
    link: Annotated[str, typer.Option(help="With shift: the foot or hand whose target is displaced.")] = "",
    offset: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="With shift: from where the plan has it, in world axes, at most 0.3 m.", metavar="X Y Z"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Give the robot of a server an order, or take, take over or release its control.

    pause comes to rest and can be resumed; stop ends the execution where it is; abort goes back on the plan's own path
    to the last pose in balance; retreat to the plan's start, or the first rest since hands or feet changed what they
    touch. What a shift makes of a plan is outside of its certificate.
    """
    from service.cli.connect import connect

    known = (*TAKES, "release", "stop", *NEEDS_STATE)
    if order not in known:
        raise RequestError(f"order: unknown order {order!r}; expected {', '.join(known)}")
    stdout, stderr = consoles()
    with connect(server, stderr, attempts=1) as client:
        if order in TAKES:
            made = client.take_control("scopt command", takes_over=TAKES[order])
        else:
            seen = revision or 0
            if revision is None and order in NEEDS_STATE:
                states = client.watch()
                seen = next(states).revision
                states.close()
            name = "release_control" if order == "release" else order
            made = client.command(name, lease=lease, revision=seen, speed=speed, link=link, offset_m=offset or ())
    if as_json:
        print_json({"revision": made.revision, "lease": made.lease})
    elif made.lease:
        stdout.print(made.lease, markup=False, soft_wrap=True)
    else:
        stdout.print(f"revision {made.revision}", markup=False, soft_wrap=True)
