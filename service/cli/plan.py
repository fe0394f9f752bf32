"""``scopt plan``, ``verify``, ``view`` and ``robots``: plans and results on this machine."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Annotated

import typer

from costs.stopping import stops_when
from costs.threads import use_all_cores
from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_result, print_table
from service.cli.run import cancellable, consoles, print_json, progress

ResultPath = Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")]


@command(has_verdict=True)
def plan_command(
    request: Annotated[
        Path,
        typer.Argument(help="Request file (YAML or JSON); with --from-phase an earlier result.", metavar="REQUEST"),
    ],
    cloud: Annotated[Path | None, typer.Option(help="Point cloud instead of the request's scene.cloud.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Result folder; by default out/NAME of the request.")
    ] = None,
    as_json: Json = False,
    from_phase: Annotated[
        str | None,
        typer.Option(help="Plan the rest of a task: from this phase on. REQUEST is the result folder of the plan."),
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(help="File with the robot's state, for --from-phase: joints, base, mechanism, contacts."),
    ] = None,
    trajopt: Annotated[bool, typer.Option("--trajopt", help="REQUEST is a TrajOpt problem (docs/trajopt.md).")] = False,
    robot: Annotated[str | None, typer.Option(help="Bundled robot or URDF of a TrajOpt problem.")] = None,
    srdf: Annotated[Path | None, typer.Option(help="SRDF of that URDF; manip may name its groups.")] = None,
    package_root: Annotated[Path | None, typer.Option(help="Folder that its package:// paths start at.")] = None,
    floating: Annotated[
        bool | None,
        typer.Option("--floating-base/--fixed-base", help="By default free for bundled robots.", show_default=False),
    ] = None,
    scene: Annotated[Path | None, typer.Option(help="File that holds what a request's scene holds.")] = None,
    start: Annotated[Path | None, typer.Option(help="File that holds what a request's start holds.")] = None,
    time_limit: Annotated[
        float | None, typer.Option(help="Seconds a TrajOpt problem may take (60).", min=0.01, max=3600.0)
    ] = None,
) -> str:
    """Plan a request, certify the motion, write the result.

    With --trajopt, REQUEST is a TrajOpt problem (JSON). Its robot comes with --robot or basic_info.robot, its scene
    with --scene or --cloud. It starts at --start, else at the first row of a given_traj, else at the robot's posture.

    With --from-phase, REQUEST is the result of an earlier plan. The new motion starts at --state and keeps the earlier
    plan's choices; --cloud gives a new scan.
    """
    if (from_phase is None) != (state is None):
        raise typer.BadParameter("--from-phase and --state come together")
    name = request.stem if from_phase is None else f"{(request.parent if request.is_file() else request).name}-rest"
    folder = out if out is not None else Path("out") / name
    if not trajopt and any(
        value is not None for value in (robot, srdf, package_root, floating, scene, start, time_limit)
    ):
        raise typer.BadParameter(
            "--robot, --srdf, --package-root, --floating-base, --scene, --start and --time-limit "
            "go with --trajopt; a request holds all of them"
        )
    stdout, stderr = consoles()
    with progress(stderr, "read request") as report, cancellable(stderr) as should_stop:
        report("read request", 0.0)
        from service.request.file import load_request, replace_cloud

        around = None

        if trajopt:
            from service.trajopt.request import TrajoptFiles, load_trajopt_request

            limit_s = TrajoptFiles.time_limit_s if time_limit is None else time_limit
            files = TrajoptFiles(robot, srdf, package_root, floating, scene, start, limit_s)
            plan_request = load_trajopt_request(request, files)
        elif from_phase is not None and state is not None:
            from service.replay.resume import make_rest_request, read_recorded_scan

            plan_request = make_rest_request(request, from_phase, state, cloud)
            around = read_recorded_scan(request, plan_request) if cloud is None else None
        else:
            plan_request = load_request(request)
        if cloud is not None and from_phase is None:
            plan_request = replace_cloud(plan_request, cloud)
        from service.planner import plan
        from service.result.folder import check_folder
        from service.result.output import write_result
        from service.result.result_json import summary_json

        check_folder(folder)
        use_all_cores()
        result = plan(plan_request, on_progress=report, should_stop=should_stop, around=around)
        report("write result", 1.0)
        written = write_result(result, folder)
    summary = summary_json(result)
    if as_json:
        print_json({**summary, **written.to_json()})
    else:
        print_result(stdout, summary, {"viewer": written.viewer, "trajectory": written.trajectory})
    return str(result.verdict.value)


@command(has_verdict=True)
def verify_command(
    result: ResultPath,
    request: Annotated[
        Path | None, typer.Option(help="Request file the result is to answer; by default the one in the folder.")
    ] = None,
    cloud: Annotated[
        list[Path] | None,
        typer.Option(help="Cloud (or scene) file of that request, read again; repeat for several."),
    ] = None,
    as_json: Json = False,
) -> str:
    """Check a result anew, without the planner."""
    stdout, stderr = consoles()
    with progress(stderr, "read result") as report, cancellable(stderr) as should_stop:
        report("read result", 0.0)
        from service.replay.replay import verify_result

        report("verify", 0.1)
        with stops_when(should_stop):
            summary = verify_result(result, request, cloud or [])
    if as_json:
        print_json(summary)
    else:
        print_result(stdout, summary)
    return str(summary["verdict"])


@command()
def view_command(result: ResultPath) -> None:
    """Open a result's viewer, or print its path."""
    import webbrowser

    from service.errors import ResultError
    from service.result.folder import ResultFiles, read_result, result_path

    read_result(result)
    viewer = ResultFiles(result_path(result).parent).viewer.resolve()
    if not viewer.is_file():
        raise ResultError(f"{viewer} does not exist; plan again to write it")
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(viewer.as_uri())
    typer.echo(str(viewer))


@command()
def robots_command(as_json: Json = False) -> None:
    """List the robots that ship with scopt, and the patches of theirs that may carry force."""
    from costs.robot import PATCH_DEFAULTS, bundled_contacts, bundled_robots

    robots, out = bundled_robots(), consoles()[0]
    contacts = {name: bundled_contacts(name) for name in robots}
    if as_json:
        listed = [
            {
                "name": name,
                "description": text,
                "contacts": {
                    patch: {
                        "link": contact.link,
                        "points": contact.points.tolist(),
                        "normal": contact.normals[0].tolist(),
                        "friction": contact.friction,
                        "force_cap_n": contact.force_cap_n,
                    }
                    for patch, contact in contacts[name].items()
                },
            }
            for name, text in robots.items()
        ]
        kinds = {kind: dataclasses.asdict(default) for kind, default in PATCH_DEFAULTS.items()}
        print_json({"robots": listed, "contact_defaults": kinds})
        return
    print_table(out, ("robot", "description"), list(robots.items()))
    columns = ("contact patch", "robot", "link", "points", "friction", "force cap per point")
    rows = [
        (patch, name, contact.link, str(len(contact.points)), f"{contact.friction:g}", f"{contact.force_cap_n:g} N")
        for name in robots
        for patch, contact in contacts[name].items()
    ]
    out.print()
    print_table(out, columns, rows)
    out.print()
    kinds_rows = [(kind, f"{d.friction:g}", f"{d.force_cap_n:g} N") for kind, d in PATCH_DEFAULTS.items()]
    print_table(out, ("kind of a patch in a request", "friction", "force cap per point"), kinds_rows)
