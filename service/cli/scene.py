"""``scopt scene`` and ``scopt detect``: pieces and objects of a scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from costs.stopping import stops_when
from costs.threads import use_all_cores
from service.cli.command import command
from service.cli.options import CloudOptions, Json
from service.cli.report import HIT_COLUMNS, MESH_COLUMNS, make_hit_row, make_mesh_row, print_line, print_table
from service.cli.run import EXIT_CODES, EndedError, cancellable, consoles, print_json, progress
from service.request.choices import EVERY_KIND, GIVEN, KINDS, Method, Unknown

KIND_HELP = f"{', '.join(KINDS)}, or {EVERY_KIND}"
Hint = Annotated[
    tuple[float, float, float] | None,
    typer.Option("--hint", help="A point near the object.", metavar="X Y Z", show_default=False),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        "--time-limit",
        help="Seconds the command may take; kinds not looked for by then are named.",
        min=0.1,
        max=3600.0,
    ),
]
MeshScale = Annotated[
    float, typer.Option(help="Metres per unit of the mesh files: 0.001 for millimetres.", min=1e-6, max=1e6)
]
# Settings that an update takes from the earlier scene unless these options give others.
_KEPT_BY_UPDATE = {
    "reach_m": "--reach",
    "top_m": "--top",
    "bottom_m": "--bottom",
    "seed": "--seed",
    "unknown": "--unknown",
    "method": "--method",
}


@command()
def scene_command(
    context: typer.Context,
    clouds: CloudOptions,
    out: Annotated[Path, typer.Option(help="File for the pieces (JSON); the page that shows them is put beside it.")],
    detect: Annotated[
        list[str] | None,
        typer.Option(help=f"Kind of object to look for: {KIND_HELP}; may be given again.", metavar="KIND"),
    ] = None,
    hint: Hint = None,
    mesh: Annotated[
        list[str] | None,
        typer.Option(
            help="Known object (STL, OBJ, PLY, URDF or object file): FILE is looked for in the scan, "
            "'FILE near X Y Z' about a point, 'FILE near POSE' within 15 cm and 20 degrees of a pose (numbers as of "
            "--transform), "
            "'FILE at POSE' stands there; may be given again.",
            metavar="MESH",
        ),
    ] = None,
    mesh_scale: MeshScale = 1.0,
    method: Annotated[
        Method, typer.Option(help="How pieces are made: planes (slabs and hulls) or coacd (slower).")
    ] = "planes",
    unknown: Annotated[Unknown, typer.Option(help="What space no ray has seen is taken for.")] = "free",
    update: Annotated[
        Path | None,
        typer.Option(
            help="Scene file of an earlier scan: its pieces stay but for those that rays now go through, and new ones "
            "are made only of what none explains. Reach, heights, seed, method and unknown are that scene's.",
            metavar="SCENE",
        ),
    ] = None,
    time_limit: TimeLimit = None,
    as_json: Json = False,
) -> str | None:
    """Turn point clouds into convex pieces, floor and objects, and show them."""
    if hint is not None and not detect:
        raise typer.BadParameter(
            "--hint needs --detect; a mesh is looked for about a point with --mesh 'FILE near X Y Z'"
        )
    if mesh_scale != 1.0 and not mesh:
        raise typer.BadParameter("--mesh-scale needs --mesh")
    stdout, stderr = consoles()
    use_all_cores()
    with progress(stderr, "read cloud") as report, cancellable(stderr) as should_stop:
        from service.result.scene_output import check_out, write_scene
        from service.scan.cloud import parse_cloud_options
        from service.scan.known_meshes import parse_mesh_option
        from service.scan.make_scene import SceneInput, apply_earlier_settings, build_scene, read_earlier_scene

        cloud_input = parse_cloud_options(clouds.to_settings())
        meshes = tuple(parse_mesh_option(text, mesh_scale) for text in mesh or ())
        scene_input = SceneInput(cloud_input, tuple(detect or ()), hint, unknown, method, meshes)
        check_out(out, [*clouds.inputs, *(mesh.file for mesh in meshes), *([] if update is None else [update])])
        if update is not None:
            explicit = {name: option for name, option in _KEPT_BY_UPDATE.items() if _is_explicit(context, name)}
            scene_input = apply_earlier_settings(read_earlier_scene(update), scene_input, explicit, "--update")
        with _stop_in_time(should_stop):
            scene = build_scene(scene_input, lambda step: report(step, None), time_limit)
        report("write pieces", None)
        page = write_scene(scene, out)
    summary = {key: value for key, value in scene.data.items() if key != "pieces"}
    if as_json:
        print_json({**summary, "scene": str(out), "viewer": str(page)})
    else:
        figures = [(name, "-" if value is None else str(value)) for name, value in summary["figures"].items()]
        print_table(stdout, ("figure", "value"), figures)
        if summary["detections"]:
            print_table(stdout, HIT_COLUMNS, [make_hit_row(hit) for hit in summary["detections"]])
        if summary["meshes"]:
            print_table(stdout, MESH_COLUMNS, [make_mesh_row(row) for row in summary["meshes"]])
        _print_notes(stdout, summary["notes"])
        print_line(stdout, "viewer", page)
        print_line(stdout, "pieces", out)
        _print_unfinished(stdout, summary["unfinished"], time_limit)
    return "TIME_LIMIT" if summary["unfinished"] else None


@command()
def detect_command(
    kind: Annotated[str, typer.Argument(help=f"What to look for: {KIND_HELP}.", metavar="KIND")],
    clouds: CloudOptions,
    hint: Hint = None,
    objects: Annotated[
        list[str] | None,
        typer.Option(
            "--object",
            help=f"With KIND {GIVEN}: what to look for, a file as for scene --mesh or parameters such as "
            "'wheel radius=0.3 rim_radius=0.02 spokes=5', with 'near X Y Z' or 'near POSE' if that is known; may be "
            "given again.",
            metavar="OBJECT",
        ),
    ] = None,
    mesh_scale: MeshScale = 1.0,
    time_limit: TimeLimit = None,
    as_json: Json = False,
) -> str | None:
    """Find objects in point clouds, best first.

    A confidence of 0.5 and more is one to act on.
    """
    stdout, stderr = consoles()
    use_all_cores()
    with progress(stderr, "read cloud") as report, cancellable(stderr) as should_stop, _stop_in_time(should_stop):
        from service.scan.cloud import parse_cloud_options
        from service.scan.detect import detect_file
        from service.scan.known_meshes import parse_mesh_option

        cloud_input = parse_cloud_options(clouds.to_settings())
        meshes = tuple(parse_mesh_option(text, mesh_scale, "--object") for text in objects or ())
        summary = detect_file(cloud_input, kind, hint, lambda step: report(step, None), time_limit, meshes)
    if as_json:
        print_json(summary)
    else:
        if summary["hits"]:
            print_table(stdout, HIT_COLUMNS, [make_hit_row(hit) for hit in summary["hits"]])
        elif summary["searched"]:
            is_one = kind not in (EVERY_KIND, GIVEN)
            missing = f"no {kind}" if is_one else f"nothing ({', '.join(summary['searched'])})"
            place = "" if hint is None else f" near ({', '.join(f'{value:g}' for value in hint)})"
            stdout.print(f"{missing} was found{place}", markup=False)
        _print_notes(stdout, summary["notes"])
        _print_unfinished(stdout, summary["unfinished"], time_limit)
    return "TIME_LIMIT" if summary["unfinished"] else None


def _is_explicit(context: typer.Context, name: str) -> bool:
    """Return whether an option stands on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


@contextmanager
def _stop_in_time(should_stop: Callable[[], bool]) -> Iterator[None]:
    """Stop the body on Ctrl-C; a time limit that was reached without any result ends the command."""
    from service.scan.detect import OutOfTimeError

    try:
        with stops_when(should_stop):
            yield
    except OutOfTimeError as error:
        raise EndedError("TIME_LIMIT", (str(error),), EXIT_CODES["TIME_LIMIT"]) from None


def _print_notes(stdout: Console, notes: Sequence[str]) -> None:
    for note in notes:
        stdout.print(f"note: {note}", markup=False, soft_wrap=True)


def _print_unfinished(stdout: Console, unfinished: Sequence[str], time_limit_s: float | None) -> None:
    """Print which kinds of objects were not searched to the end."""
    if unfinished:
        line = f"{time_limit_s:g} s were over before these were looked for to the end: {', '.join(unfinished)}"
        stdout.print(f"TIME_LIMIT  {line}", markup=False, soft_wrap=True)
