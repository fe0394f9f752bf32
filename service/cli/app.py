"""The command line ``scopt``: arguments in, exit codes out; what happens between lives in the modules it calls.

Libraries are imported inside the commands, so that ``scopt --help`` answers at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from costs.stopping import stops_when
from costs.threads import use_all_cores
from service.cli.remote import REMOTE_EXIT_CODES, request_command, review_command, top_command
from service.cli.report import print_figures, print_findings, print_table, print_verdict
from service.cli.run import cancellable, consoles, print_json, progress, run
from service.cli.scene import Json, detect_command, scene_command
from service.cli.serve import serve_command, token_command

EXIT_CODE_HELP = (
    "Exit codes: 0 CERTIFIED, 2 usage, 3 INVALID_REQUEST, 4 no certificate, 5 TIME_LIMIT, 70 internal error, "
    "130 CANCELLED."
)
app = typer.Typer(
    name="scopt",
    help="Whole-body trajectories for humanoids, with a certificate that a stranger can replay.",
    epilog=EXIT_CODE_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # its help page loads a Markdown parser and a syntax highlighter: 0.16 s
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Entry point of the ``scopt`` program."""
    app()


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        from importlib.metadata import version

        typer.echo(f"scopt {version('scopt')}")
        raise typer.Exit


@app.callback()
def set_options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options of the program itself."""


@app.command("plan", epilog=EXIT_CODE_HELP)
def plan_command(
    request: Annotated[Path, typer.Argument(help="Request file (YAML or JSON).", metavar="REQUEST")],
    cloud: Annotated[Path | None, typer.Option(help="Point cloud instead of the request's scene.cloud.")] = None,
    out: Annotated[Path | None, typer.Option(help="Result folder; by default out/NAME of the request.")] = None,
    as_json: Json = False,
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
) -> None:
    """Plan a request, certify the motion, write the result.

    With --trajopt, REQUEST is a TrajOpt problem (JSON). Its robot comes with --robot or basic_info.robot, its scene
    with --scene or --cloud. It starts at --start, else at the first row of a given_traj, else at the robot's posture.
    """
    folder = out if out is not None else Path("out") / request.stem
    options = {
        "robot": robot,
        "srdf": srdf,
        "package_root": package_root,
        "is_floating": floating,
        "scene": scene,
        "start": start,
        "time_limit_s": time_limit,
    }
    given = {name: value for name, value in options.items() if value is not None}
    if given and not trajopt:
        raise typer.BadParameter(
            "--robot, --srdf, --package-root, --floating-base, --scene, --start and --time-limit "
            "go with --trajopt; a request holds all of them"
        )
    files = given if trajopt else None
    raise typer.Exit(run(lambda: _plan(request, files, cloud, folder, as_json), as_json, has_verdict=True))


@app.command("verify", epilog=EXIT_CODE_HELP)
def verify_command(
    result: Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")],
    request: Annotated[
        Path | None, typer.Option(help="Request file the result is to answer; by default the one in the folder.")
    ] = None,
    cloud: Annotated[
        list[Path] | None,
        typer.Option(help="Cloud (or scene) file of that request, read again; repeat for several."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check a result anew, without the planner."""
    raise typer.Exit(run(lambda: _verify(result, request, cloud or [], as_json), as_json, has_verdict=True))


@app.command("view")
def view_command(
    result: Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")],
) -> None:
    """Open a result's viewer, or print its path."""
    raise typer.Exit(run(lambda: _view(result)))


@app.command("bench")
def bench_command(
    problems: Annotated[Path, typer.Argument(help="Problem file or folder of problem files.", metavar="PROBLEMS")],
    urdf: Annotated[Path, typer.Option(help="The robot that the problems are judged with.")],
    out: Annotated[Path, typer.Option(help="Result file; an earlier one is continued.")],
    srdf: Annotated[Path | None, typer.Option(help="Its SRDF.")] = None,
    package_root: Annotated[Path | None, typer.Option(help="Folder that package:// paths start at.")] = None,
    limit: Annotated[int | None, typer.Option(help="Most problems of a scene.", min=1)] = None,
    time_limit: Annotated[float, typer.Option(help="Seconds a problem may take.", min=0.01, max=3600.0)] = 2.0,
    as_json: Json = False,
) -> None:
    """Plan every problem of a set and print a table per scene."""
    raise typer.Exit(run(lambda: _bench(problems, urdf, srdf, package_root, limit, time_limit, out, as_json), as_json))


@app.command("robots")
def robots_command(as_json: Json = False) -> None:
    """List the robots that ship with scopt."""
    raise typer.Exit(run(lambda: _robots(as_json), as_json))


app.command("scene")(scene_command)
app.command("detect")(detect_command)
app.command("request", epilog=REMOTE_EXIT_CODES)(request_command)
app.command("review")(review_command)
app.command("top")(top_command)
app.command("serve")(serve_command)
app.command("token")(token_command)


def _plan(
    request_file: Path, trajopt: Mapping[str, Any] | None, cloud: Path | None, folder: Path, as_json: bool
) -> str:
    out, err = consoles()
    with progress(err, "read request") as report, cancellable(err) as should_stop:
        report("read request", 0.0)
        from service.request.file import load_request, replace_cloud

        if trajopt is None:
            request = load_request(request_file)
        else:
            from service.trajopt.request import TrajoptFiles, load_trajopt_request

            request = load_trajopt_request(request_file, TrajoptFiles(**trajopt))
        if cloud is not None:
            request = replace_cloud(request, cloud)
        from service.planner import plan
        from service.result.folder import check_folder
        from service.result.output import write_result
        from service.result.result_json import summary_json

        check_folder(folder)
        use_all_cores()
        result = plan(request, on_progress=report, should_stop=should_stop)
        report("write result", 1.0)
        files = write_result(result, folder)
    summary = summary_json(result)
    if as_json:
        print_json({**summary, "result": str(files.result), "viewer": str(files.viewer)})
    else:
        print_findings(out, summary)
        print_figures(out, summary)
        out.print(f"viewer           {files.viewer}", markup=False, soft_wrap=True)
        out.print(f"trajectory       {files.trajectory}", markup=False, soft_wrap=True)
        print_verdict(out, summary)
    return str(result.verdict.value)


def _verify(path: Path, request: Path | None, clouds: list[Path], as_json: bool) -> str:
    out, err = consoles()
    with progress(err, "read result") as report, cancellable(err) as should_stop:
        report("read result", 0.0)
        from service.replay.replay import verify_result

        report("verify", 0.1)
        with stops_when(should_stop):
            summary = verify_result(path, request, clouds)
    if as_json:
        print_json(summary)
    else:
        print_findings(out, summary)
        print_figures(out, summary)
        print_verdict(out, summary)
    return str(summary["verdict"])


def _view(path: Path) -> None:
    import os
    import webbrowser

    from service.errors import ResultError
    from service.result.folder import ResultFiles, read_result, result_path

    read_result(path)
    viewer = ResultFiles(result_path(path).parent).viewer.resolve()
    if not viewer.is_file():
        raise ResultError(f"{viewer} is not there; plan again to write it")
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(viewer.as_uri())
    typer.echo(str(viewer))


def _bench(
    path: Path,
    urdf: Path,
    srdf: Path | None,
    package_root: Path | None,
    limit: int | None,
    time_limit: float,
    out: Path,
    as_json: bool,
) -> None:
    screen, err = consoles()
    with progress(err, "read problems") as report:
        report("read problems", 0.0)
        from service.bench.bench import COLUMNS, FAILURE_COLUMNS, failures, run_bench, table
        from service.bench.problem_set import BenchRobot, read_problems
        from service.errors import RequestError
        from service.start.robot import load_requested_robot

        problems = read_problems(
            path, BenchRobot(urdf, srdf, package_root), {"time_limit_s": time_limit, "timed": False}, limit
        )
        if not problems:
            raise RequestError(f"{path} holds no problems")
        rows = run_bench(problems, load_requested_robot(problems[0].request), out, report)
    summary = table(rows)
    if as_json:
        print_json({"results": str(out), "table": [dict(zip(COLUMNS, line, strict=True)) for line in summary]})
    else:
        print_table(screen, COLUMNS, summary)
        if any(not row["success_claimed"] for row in rows):
            print_table(screen, FAILURE_COLUMNS, failures(rows))
        screen.print(f"results          {out}", markup=False, soft_wrap=True)


def _robots(as_json: bool) -> None:
    out, _ = consoles()
    from costs.robot import bundled_robots

    robots = bundled_robots()
    if as_json:
        print_json({"robots": [{"name": name, "description": text} for name, text in robots.items()]})
    else:
        print_table(out, ("robot", "description"), list(robots.items()))
