"""``scopt certify``: a certificate for a trajectory of another planner, or the place where it fails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_result
from service.cli.run import cancellable, consoles, print_json, progress


@command(has_verdict=True)
def certify_command(
    trajectory: Annotated[
        Path,
        typer.Argument(
            help="JointTrajectory as YAML, JSON, CSV or NPZ, an MCAP file, or a bag of ROS 1 or ROS 2.",
            metavar="TRAJECTORY",
        ),
    ],
    request: Annotated[
        Path, typer.Option("--request", "-r", help="Request file with robot, start, scene and goal.", metavar="REQUEST")
    ],
    interpolation: Annotated[
        Literal["auto", "linear", "cubic", "quintic", "spline"],
        typer.Option(
            help="How the controller moves between points; auto: quintic where accelerations are given, else cubic "
            "where velocities are, else linear."
        ),
    ] = "auto",
    untimed: Annotated[bool, typer.Option("--untimed", help="Certify the path alone: no speeds, no forces.")] = False,
    topic: Annotated[str | None, typer.Option(help="Of a bag with trajectories on several topics.")] = None,
    message: Annotated[
        int | None, typer.Option(help="Of a bag with several trajectories: number of the message, -1 for the last.")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="File for the certificate (JSON).")] = None,
    as_json: Json = False,
) -> str:
    """Certify a motion of another planner (MoveIt, cuRobo, Tesseract, Drake), or say where it fails.

    The certificate proves clearance, limits, speeds, accelerations, balance and the goal on the whole curve, also
    between the points, and names the interpolation that it holds for.
    """
    stdout, stderr = consoles()
    with progress(stderr, "read request") as report, cancellable(stderr) as should_stop:
        report("read request", 0.0)
        from service.replay.exchange.certify import certify, to_json
        from service.replay.exchange.read import read_trajectory
        from service.request.file import load_request

        plan_request = load_request(request)
        points = read_trajectory(trajectory, topic, message)
        outcome = certify(
            points,
            plan_request,
            interpolation,
            timed=not untimed,
            should_stop=should_stop,
            on_step=lambda step: report(step, 0.1),
        )
    summary = to_json(outcome)
    if certificate is not None:
        from service.result.folder import write_whole

        noted = replace(outcome.certificate, notes=(*outcome.certificate.notes, *outcome.notes))
        write_whole(certificate, noted.to_json())
    if as_json:
        print_json(summary)
    else:
        lines = {"trajectory": f"{trajectory.name}, {len(points.positions)} points"}
        print_result(stdout, summary, lines)
    return str(summary["verdict"])
