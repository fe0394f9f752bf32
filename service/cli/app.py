"""The program ``scopt``: its commands and global options.

Commands import what they need when they run, so that ``scopt --help`` answers at once.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import Annotated, NoReturn

import typer
from typer.core import TyperGroup

from service.cli.bench import bench_command
from service.cli.certify import certify_command
from service.cli.command import CommandLine
from service.cli.export import export_command, state_command
from service.cli.motions.batch import batch_command
from service.cli.motions.move import move_app
from service.cli.motions.task import task_app
from service.cli.operation.execute import execute_command
from service.cli.operation.orders import command_command
from service.cli.operation.watch import watch_command
from service.cli.options import read_defaults
from service.cli.plan import plan_command, verify_command, view_command
from service.cli.request import request_command
from service.cli.review import review_command
from service.cli.robots import robots_command
from service.cli.scene import detect_command, scene_command
from service.cli.server.console import console_command
from service.cli.server.health import health_command
from service.cli.server.keeping import backup_command, prune_command
from service.cli.server.lists import plans_command, scenes_command
from service.cli.server.serve import serve_command
from service.cli.server.token import token_command
from service.cli.simulate import simulate_command
from service.cli.stance import stance_command
from service.cli.top import top_command
from service.cli.track import track_command

EXIT_CODE_HELP = (
    "Exit codes: 0 CERTIFIED, 2 usage, 3 INVALID_REQUEST, 4 no certificate, 5 TIME_LIMIT, {}70 internal error, "
    "{}130 CANCELLED."
)
TRACK_EXIT_CODES = (
    "Exit codes: 0 TRACKED or DONE, 1 STOOD, 2 usage, 3 INVALID_REQUEST, 7 FELL, 8 ABORTED, 70 internal error, "
    "130 CANCELLED."
)
EXECUTION_EXIT_CODES = (
    "Exit codes: 0 DONE, 2 usage, 3 INVALID_REQUEST (refused), 7 FELL, 8 ABORTED, 69 UNAVAILABLE, 70 internal error, "
    "77 NOT_ALLOWED, 130 CANCELLED."
)
VERIFY_EXIT_CODES = (
    "Exit codes: 0 CERTIFIED (holds today), 2 usage, 3 INVALID_REQUEST, 4 no certificate, 5 TIME_LIMIT, 9 HELD_BEFORE "
    "(held under the version that wrote it, lacks checks of today), 70 internal error, 74 DAMAGED, 130 CANCELLED."
)
LOCAL_EXIT_CODES = EXIT_CODE_HELP.format("", "")
REMOTE_EXIT_CODES = EXIT_CODE_HELP.format("6 OVERLOADED, 69 UNAVAILABLE, ", "77 NOT_ALLOWED, ")
SIMULATION_EXIT_CODES = (
    "Exit codes: 0 DONE, 1 STOOD, 2 usage, 3 INVALID_REQUEST, 7 FELL, 70 internal error, 130 CANCELLED."
)
EXIT_CANCELLED = 130
app = CommandLine(
    name="scopt",
    help="Whole-body trajectories for humanoids, with a certificate that a stranger can replay.",
    epilog=LOCAL_EXIT_CODES,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # its help page loads a Markdown parser and a syntax highlighter: 0.16 s
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("plan", epilog=LOCAL_EXIT_CODES)(plan_command)
app.command("batch", epilog=LOCAL_EXIT_CODES)(batch_command)
app.command("verify", epilog=VERIFY_EXIT_CODES)(verify_command)
app.command("certify", epilog=LOCAL_EXIT_CODES)(certify_command)
app.command("simulate", epilog=SIMULATION_EXIT_CODES)(simulate_command)
app.command("track", epilog=TRACK_EXIT_CODES)(track_command)
app.command("stance")(stance_command)
app.add_typer(task_app, name="task", epilog=LOCAL_EXIT_CODES)
app.add_typer(move_app, name="move", epilog=LOCAL_EXIT_CODES)
app.command("view")(view_command)
app.command("export")(export_command)
app.command("state")(state_command)
app.command("bench")(bench_command)
app.command("robots")(robots_command)
app.command("scene")(scene_command)
app.command("detect")(detect_command)
app.command("request", epilog=REMOTE_EXIT_CODES)(request_command)
app.command("review")(review_command)
app.command("execute", epilog=EXECUTION_EXIT_CODES)(execute_command)
app.command("command")(command_command)
app.command("watch")(watch_command)
app.command("plans")(plans_command)
app.command("scenes")(scenes_command)
app.command("top")(top_command)
app.command("serve")(serve_command)
app.command("console")(console_command)
app.command("backup")(backup_command)
app.command("prune")(prune_command)
app.command("token")(token_command)
app.command("health")(health_command)


def main() -> None:
    """Entry point of the ``scopt`` program.

    A cancelled command ends at once: without the destructors of libraries, which may take half a second.
    """
    try:
        app()
    except KeyboardInterrupt:  # while a command was imported
        print("cancelled", file=sys.stderr)
        _end_now(EXIT_CANCELLED)
    except SystemExit as ended:
        if ended.code == EXIT_CANCELLED:
            _end_now(EXIT_CANCELLED)
        raise


def _end_now(exit_code: int) -> NoReturn:
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(exit_code)


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        from importlib.metadata import version

        typer.echo(f"scopt {version('scopt')}")
        raise typer.Exit


@app.callback()
def set_options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options of the program itself."""
    if isinstance(context.command, TyperGroup):
        context.default_map = read_defaults(context.command)
    # Read by gRPC's C core when it is imported; commands and server report failed connections themselves.
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")
