"""``scopt export``: a result for ROS 2, MCAP, NumPy and position servos; ``scopt state``: one moment of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from service.cli.command import command
from service.cli.options import Json
from service.cli.run import cancellable, consoles, print_json


@command()
def export_command(
    result: Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")],
    target: Annotated[
        Literal["ros2", "mcap", "numpy", "servo"],
        typer.Option(
            "--to",
            help="A folder with a bag of ROS 2, an MCAP file, an archive of NumPy, or a table (CSV) of the commands of "
            "position servos without feed-forward.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File or folder; by default beside the result folder.")
    ] = None,
    any_verdict: Annotated[
        bool, typer.Option("--any-verdict", help="Export a motion without a certificate, too.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write a result for other programs: trajectory, scene and robot, without ROS installed."""
    stdout, stderr = consoles()
    with cancellable(stderr):
        from service.replay.exchange.export import SUFFIXES, export
        from service.result.folder import result_path

        folder = result_path(result).parent.resolve()
        suffix = "-servo.csv" if target == "servo" else SUFFIXES[target]
        path = folder.with_name(f"{folder.name}{suffix}") if out is None else out
        if target == "servo":
            from service.execution.servo_reference import write_servo_reference

            written = write_servo_reference(folder, path, any_verdict=any_verdict)
        else:
            written = export(result, target, path, any_verdict=any_verdict)
    if as_json:
        print_json({"export": str(written), "to": target})
    else:
        stdout.print(str(written), markup=False, soft_wrap=True)


@command()
def state_command(
    result: Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")],
    at: Annotated[
        float | None,
        typer.Option("--at", help="Seconds from the beginning of the motion; by default its end.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File; by default NAME-state.json beside the result folder.")
    ] = None,
) -> None:
    """Write the robot's state at a time of a result, for --state of other commands or a request's start."""
    stdout, stderr = consoles()
    with cancellable(stderr):
        from service.replay.state import write_state
        from service.result.folder import result_path

        folder = result_path(result).parent.resolve()
        path = folder.with_name(f"{folder.name}-state.json") if out is None else out
        write_state(result, at, path)
    stdout.print(str(path), markup=False, soft_wrap=True)
