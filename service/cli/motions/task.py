"""``scopt task``: task files that ship and those of the user, what each needs, and plans of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command import CommandLine, command
from service.cli.motions.planning import plan_and_write
from service.cli.options import Json, PlanningOptions
from service.cli.report import print_table
from service.cli.run import consoles, print_json

if TYPE_CHECKING:
    from service.request.schema import PlanRequest
    from service.request.task_files import TaskFile

task_app = CommandLine(help="Task files: list them, show one, plan one.", no_args_is_help=True, rich_markup_mode=None)


@command()
def list_command(as_json: Json = False) -> None:
    """List the task files: those in ./tasks, $SCOPT_TASKS and ~/.config/scopt/tasks, and those that ship."""
    from service.request.file import TASKS_FOLDER
    from service.request.task_files import list_task_files

    files = list(list_task_files((Path(TASKS_FOLDER),)))
    if as_json:
        print_json({"tasks": [{"name": file.name, "help": file.data.help, "path": str(file.path)} for file in files]})
        return
    print_table(consoles()[0], ("task", "what it does"), [(file.name, file.data.help) for file in files])


@command()
def show_command(
    name: Annotated[str, typer.Argument(help="Name of a task file.", metavar="NAME")], as_json: Json = False
) -> None:
    """Show what a task does, its parameters and where its file is."""
    from service.request.file import TASKS_FOLDER
    from service.request.task_files import find_task_file

    file = find_task_file(name, (Path(TASKS_FOLDER),))
    if as_json:
        print_json(_describe(file))
        return
    stdout, _ = consoles()
    stdout.print(file.data.help, markup=False, soft_wrap=True)
    rows = [
        (name, own["type"], own["unit"], own["default"], own["expected"], own["help"])
        for name, own in _describe(file)["parameters"].items()
    ]
    print_table(stdout, ("parameter", "type", "unit", "default", "expected", "what it is"), rows)
    stdout.print(f"file  {file.path}", markup=False, soft_wrap=True)


def _describe(file: TaskFile) -> dict[str, Any]:
    parameters = {}
    for name, own in file.data.parameters.items():
        expected = ", ".join(own.choices) if own.choices else ""
        if own.range is not None:
            expected = f"{own.range[0]:g} to {own.range[1]:g}"
        if own.detect is not None:
            expected = f"{expected}{'; ' if expected else ''}or {own.value} of a detected {own.detect}"
        default = "" if own.default is None else str(own.default)
        parameters[name] = {
            "type": own.type, "unit": own.unit or "", "default": default, "expected": expected, "help": own.help,
        }  # fmt: skip
    return {"name": file.name, "help": file.data.help, "path": str(file.path), "parameters": parameters}


@command(has_verdict=True)
def run_command(
    name: Annotated[str, typer.Argument(help="Name of a task file.", metavar="NAME")],
    planning: PlanningOptions,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Value of a parameter; may be given again.", metavar="NAME=VALUE")
    ] = None,
    cloud: Annotated[Path | None, typer.Option(help="Point cloud of the surroundings.")] = None,
    request: Annotated[
        Path | None, typer.Option(help="Request file with robot, start and scene; its task is replaced.")
    ] = None,
    robot: Annotated[str, typer.Option(help="Bundled robot, without --request.")] = "atlas",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Result folder; by default out/NAME.")] = None,
    as_json: Json = False,
) -> str:
    """Plan a task file, certify the motion, write the result.

    Parameters that are not set have their defaults, or are read off the detected object that the file names.
    """
    folder = out if out is not None else Path("out") / name
    return plan_and_write(
        lambda: (read_task_request(name, settings or (), cloud, request, robot), None),
        folder,
        planning,
        as_json=as_json,
    )


def read_task_request(
    name: str, settings: Sequence[str], cloud: Path | None, request: Path | None, robot: str
) -> PlanRequest:
    """Return the request of a task file.

    Raises:
        RequestError: a parameter does not fit, or the scan does not show what gives its value.
    """
    from service.request.file import TASKS_FOLDER, parse_request, read_plain_request
    from service.request.task_files import find_task_file

    data: dict[str, Any] = {"robot": {"name": robot}} if request is None else read_plain_request(request)
    folder = Path.cwd() if request is None else request.parent
    file = find_task_file(name, (folder / TASKS_FOLDER,))
    values = read_settings(settings)
    if cloud is not None:
        from service.scan.bind import bind_parameters

        data["scene"] = {**(data.get("scene") or {}), "cloud": str(cloud.absolute())}
        values = bind_parameters(file, values, cloud)
    data.pop("goal", None)
    data["task"] = {"use": name, "with": values}
    return parse_request(data, folder)


def read_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Return the values of ``NAME=VALUE``: numbers, texts, and lists as ``0.7,0,1.2``.

    Raises:
        BadParameter: one of them has no ``=``.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        name, found, text = setting.partition("=")
        if not found or not name:
            raise typer.BadParameter(f"--set {setting}: expected NAME=VALUE")
        parts = [_read_value(part) for part in text.strip("[] ").split(",")]
        values[name.strip()] = parts if "," in text or text.startswith("[") else parts[0]
    return values


def _read_value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()


task_app.command("list")(list_command)
task_app.command("show")(show_command)
task_app.command("run")(run_command)
