"""``scopt scene`` and ``scopt detect``: what a scan shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from costs.stopping import stops_when
from costs.threads import use_all_cores
from service.cli.clouds import CloudOptions, with_cloud_options
from service.cli.report import HIT_COLUMNS, MESH_COLUMNS, hit_row, mesh_row, print_table
from service.cli.run import EXIT_CODES, EndedError, cancellable, consoles, print_json, progress, run
from service.request.choices import EVERY_KIND, KINDS, Method, Unknown

KIND_HELP = f"{', '.join(KINDS)}, or {EVERY_KIND}"
Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]
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
# What an update takes from the scene before, and the options that say it otherwise.
_OF_BEFORE = {
    "reach_m": "--reach",
    "top_m": "--top",
    "bottom_m": "--bottom",
    "seed": "--seed",
    "unknown": "--unknown",
    "method": "--method",
}


@with_cloud_options
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
            help="Known object (STL, OBJ, PLY or URDF): FILE is looked for in the scan, 'FILE near X Y Z' about a "
            "point, 'FILE near POSE' within 15 cm and 20 degrees of a pose (numbers as of --transform), "
            "'FILE at POSE' stands there; may be given again.",
            metavar="MESH",
        ),
    ] = None,
    mesh_scale: Annotated[
        float, typer.Option(help="Metres per unit of the mesh files: 0.001 for millimetres.", min=1e-6, max=1e6)
    ] = 1.0,
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
) -> None:
    """Turn point clouds into convex pieces, floor and objects, and show them."""
    if hint is not None and not detect:
        raise typer.BadParameter(
            "--hint needs --detect; a mesh is looked for about a point with --mesh 'FILE near X Y Z'"
        )
    if mesh_scale != 1.0 and not mesh:
        raise typer.BadParameter("--mesh-scale needs --mesh")
    chosen = {"kinds": tuple(detect or ()), "hint": hint, "method": method, "unknown": unknown}
    meshes = [(text, mesh_scale) for text in mesh or ()]
    given = {name for name in _OF_BEFORE if _is_given(context, name)}
    raise typer.Exit(run(lambda: _scene(clouds, out, chosen, meshes, (update, given), time_limit, as_json), as_json))


@with_cloud_options
def detect_command(
    kind: Annotated[str, typer.Argument(help=f"What to look for: {KIND_HELP}.", metavar="KIND")],
    clouds: CloudOptions,
    hint: Hint = None,
    time_limit: TimeLimit = None,
    as_json: Json = False,
) -> None:
    """Find objects in point clouds, best first.

    A confidence of 0.5 and more is one to act on.
    """
    raise typer.Exit(run(lambda: _detect(kind, clouds, hint, time_limit, as_json), as_json))


def _scene(
    clouds: CloudOptions,
    out: Path,
    chosen: Mapping[str, Any],
    meshes: list[tuple[str, float]],
    before: tuple[Path | None, set[str]],
    time_limit: float | None,
    as_json: bool,
) -> str | None:
    screen, err = consoles()
    update, given = before
    use_all_cores()
    with progress(err, "read cloud") as report, cancellable(err) as should_stop:
        from service.result.scene_output import check_out, write_scene
        from service.scan.cloud import parse_cloud_options
        from service.scan.detect import OutOfTimeError
        from service.scan.known_meshes import parse_mesh_option
        from service.scan.make_scene import SceneInput, apply_earlier_settings, build_scene, read_earlier_scene

        known = tuple(parse_mesh_option(text, scale) for text, scale in meshes)
        asked = SceneInput(parse_cloud_options(clouds.asked()), **chosen, meshes=known)
        check_out(out, [*clouds.inputs, *(one.file for one in known), *([] if update is None else [update])])
        if update is not None:
            said = {name: option for name, option in _OF_BEFORE.items() if name in given}
            asked = apply_earlier_settings(read_earlier_scene(update), asked, said, "--update")
        try:
            with stops_when(should_stop):
                seen = build_scene(asked, lambda step: report(step, None), time_limit)
        except OutOfTimeError as error:
            raise EndedError("TIME_LIMIT", (str(error),), EXIT_CODES["TIME_LIMIT"]) from None
        report("write pieces", None)
        page = write_scene(seen, out)
    shown = {key: value for key, value in seen.data.items() if key != "pieces"}
    late = ", ".join(shown["unfinished"])
    ended = "TIME_LIMIT" if late else None
    if as_json:
        print_json({**shown, "scene": str(out), "viewer": str(page)})
        return ended
    figures = [(name, "-" if value is None else str(value)) for name, value in shown["figures"].items()]
    print_table(screen, ("figure", "value"), figures)
    if shown["detections"]:
        print_table(screen, HIT_COLUMNS, [hit_row(hit) for hit in shown["detections"]])
    if shown["meshes"]:
        print_table(screen, MESH_COLUMNS, [mesh_row(one) for one in shown["meshes"]])
    for note in shown["notes"]:
        screen.print(f"note: {note}", markup=False, soft_wrap=True)
    screen.print(f"viewer           {page}", markup=False, soft_wrap=True)
    screen.print(f"pieces           {out}", markup=False, soft_wrap=True)
    if late:
        line = f"TIME_LIMIT  {time_limit:g} s were over before these were looked for to the end: {late}"
        screen.print(line, markup=False, soft_wrap=True)
    return ended


def _is_given(context: typer.Context, name: str) -> bool:
    """Whether an option stands on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _detect(
    kind: str,
    clouds: CloudOptions,
    hint: tuple[float, float, float] | None,
    time_limit: float | None,
    as_json: bool,
) -> str | None:
    screen, err = consoles()
    use_all_cores()
    with progress(err, "read cloud") as report, cancellable(err) as should_stop:
        from service.scan.cloud import parse_cloud_options
        from service.scan.detect import OutOfTimeError, detect_file

        try:
            wanted = parse_cloud_options(clouds.asked())
            with stops_when(should_stop):
                found = detect_file(wanted, kind, hint, lambda step: report(step, None), time_limit)
        except OutOfTimeError as error:
            raise EndedError("TIME_LIMIT", (str(error),), EXIT_CODES["TIME_LIMIT"]) from None
    late = ", ".join(found["unfinished"])
    ended = "TIME_LIMIT" if late else None
    if as_json:
        print_json(found)
        return ended
    if found["hits"]:
        print_table(screen, HIT_COLUMNS, [hit_row(hit) for hit in found["hits"]])
    elif found["searched"]:
        what = f"no {kind}" if kind != EVERY_KIND else f"nothing ({', '.join(found['searched'])})"
        where = "" if hint is None else f" near ({', '.join(f'{value:g}' for value in hint)})"
        screen.print(f"{what} was found{where}", markup=False)
    for note in found["notes"]:
        screen.print(f"note: {note}", markup=False, soft_wrap=True)
    if late:
        line = f"TIME_LIMIT  {time_limit:g} s were over before these were looked for to the end: {late}"
        screen.print(line, markup=False, soft_wrap=True)
    return ended
