"""``scopt scene`` and ``scopt detect``: what a scan shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli_report import HIT_COLUMNS, hit_row, print_table
from service.cli_run import consoles, print_json, progress, run
from service.scan_choices import Method, Unknown

Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]
Clouds = Annotated[list[Path], typer.Argument(help="Point cloud files; several are merged.", metavar="CLOUD...")]
Unit = Annotated[
    list[str] | None,
    typer.Option("--unit", help="Of the files' lengths: m (as by default), cm, mm, km, in, ft.", metavar="UNIT"),
]
Transforms = Annotated[
    list[str] | None,
    typer.Option(
        "--transform",
        help="Pose of the points in the world: 'X Y Z YAW PITCH ROLL' (radians), 'X Y Z QW QX QY QZ' or 16 numbers; "
        "once, or for each file.",
        metavar="NUMBERS",
    ),
]
Sensor = Annotated[
    list[str] | None, typer.Option("--sensor", help="Where rays started, if the files do not say.", metavar="'X Y Z'")
]
Viewpoint = Annotated[bool, typer.Option("--apply-viewpoint", help="The points are in the sensor's frame.")]
Topic = Annotated[str | None, typer.Option("--topic", help="Of a bag with clouds on several topics.")]
Message = Annotated[
    str, typer.Option("--message", help="Of a bag: number of the message, -1 for the last, or all.", metavar="NUMBER")
]
Radius = Annotated[float, typer.Option("--reach", help="Horizontal radius kept, in metres.", min=0.1, max=50.0)]
Top = Annotated[float, typer.Option("--top", help="Height up to which points are kept, in metres.")]
Bottom = Annotated[float, typer.Option("--bottom", help="Height from which on points are kept, in metres.")]
RobotThere = Annotated[str | None, typer.Option("--robot", help="Bundled robot whose own points are left out.")]
Posture = Annotated[Path | None, typer.Option("--posture", help="File with that robot's start (as in a request).")]
Hint = Annotated[
    tuple[float, float, float] | None,
    typer.Option("--hint", help="A point near the object.", metavar="X Y Z", show_default=False),
]
Seed = Annotated[int, typer.Option(help="Of all random choices.", min=0)]


def scene_command(
    clouds: Clouds,
    out: Annotated[Path, typer.Option(help="File for the pieces (JSON); the page that shows them is put beside it.")],
    unit: Unit = None,
    transform: Transforms = None,
    sensor: Sensor = None,
    apply_viewpoint: Viewpoint = False,
    topic: Topic = None,
    message: Message = "0",
    reach: Radius = 4.0,
    top: Top = 3.0,
    bottom: Bottom = -0.5,
    robot: RobotThere = None,
    posture: Posture = None,
    unknown: Annotated[Unknown, typer.Option(help="What space no ray has seen is taken for.")] = "free",
    method: Annotated[
        Method, typer.Option(help="How pieces are made: planes (slabs and hulls) or coacd (slower).")
    ] = "planes",
    detect: Annotated[
        list[str] | None, typer.Option(help="Kind of object to look for, or all; may be given again.", metavar="KIND")
    ] = None,
    hint: Hint = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Turn point clouds into convex pieces, floor and objects, and show them."""
    if hint is not None and not detect:
        raise typer.BadParameter("--hint needs --detect")
    options = _cloud_options(
        files=tuple(clouds), unit=unit, transforms=transform, sensor=sensor, apply_viewpoint=apply_viewpoint,
        topic=topic, message=message, reach_m=reach, top_m=top, bottom_m=bottom, robot=robot, posture=posture,
        seed=seed,
    )  # fmt: skip
    wanted = {"kinds": tuple(detect or ()), "hint": hint, "unknown": unknown, "method": method}
    raise typer.Exit(run(lambda: _scene(options, out, wanted, as_json), as_json))


def detect_command(
    kind: Annotated[str, typer.Argument(help="What to look for: valve, door, ...", metavar="KIND")],
    clouds: Clouds,
    hint: Hint = None,
    unit: Unit = None,
    transform: Transforms = None,
    sensor: Sensor = None,
    apply_viewpoint: Viewpoint = False,
    topic: Topic = None,
    message: Message = "0",
    reach: Radius = 4.0,
    top: Top = 3.0,
    bottom: Bottom = -0.5,
    robot: RobotThere = None,
    posture: Posture = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Find objects of a kind in point clouds, best first."""
    options = _cloud_options(
        files=tuple(clouds), unit=unit, transforms=transform, sensor=sensor, apply_viewpoint=apply_viewpoint,
        topic=topic, message=message, reach_m=reach, top_m=top, bottom_m=bottom, robot=robot, posture=posture,
        seed=seed,
    )  # fmt: skip
    raise typer.Exit(run(lambda: _detect(kind, options, hint, as_json), as_json))


def _cloud_options(
    *,
    unit: list[str] | None,
    transforms: list[str] | None,
    sensor: list[str] | None,
    robot: str | None,
    posture: Path | None,
    **others: Any,
) -> dict[str, Any]:
    """What ``cloud_asked`` takes.

    Raises:
        typer.BadParameter: options that do not go together, or one twice that holds for all files.
    """
    if posture is not None and robot is None:
        raise typer.BadParameter("--posture needs --robot")
    for option, given in (("--unit", unit), ("--sensor", sensor)):
        if len(given or ()) > 1:
            raise typer.BadParameter(
                f"{option} is given {len(given or ())} times; it holds for all clouds, give it once"
            )
    return {
        "unit": (unit or ["m"])[0],
        "transforms": tuple(transforms or ()),
        "sensor": sensor[0] if sensor else None,
        "robot": robot,
        "posture": posture,
        **others,
    }


def _scene(
    options: Mapping[str, Any],
    out: Path,
    wanted: Mapping[str, Any],
    as_json: bool,
) -> None:
    screen, err = consoles()
    with progress(err, "read cloud") as report:
        from service.cloud_asked import cloud_asked
        from service.scene_file import SceneAsked, check_out, see_files, write_scene

        posture = options["posture"]
        check_out(out, [*options["files"], *([] if posture is None else [posture])])
        seen = see_files(SceneAsked(cloud_asked(options), **wanted), lambda step: report(step, 0.3))
        report("write pieces", 0.9)
        page = write_scene(seen, out)
    shown = {key: value for key, value in seen.data.items() if key != "pieces"}
    if as_json:
        print_json({**shown, "scene": str(out), "viewer": str(page)})
        return
    figures = [(name, "-" if value is None else str(value)) for name, value in shown["figures"].items()]
    print_table(screen, ("figure", "value"), figures)
    if shown["detections"]:
        print_table(screen, HIT_COLUMNS, [hit_row(hit) for hit in shown["detections"]])
    for note in shown["notes"]:
        screen.print(f"note: {note}", markup=False, soft_wrap=True)
    screen.print(f"viewer           {page}", markup=False, soft_wrap=True)
    screen.print(f"pieces           {out}", markup=False, soft_wrap=True)


def _detect(kind: str, options: Mapping[str, Any], hint: tuple[float, float, float] | None, as_json: bool) -> None:
    screen, err = consoles()
    with progress(err, "read cloud") as report:
        from service.cloud_asked import cloud_asked
        from service.detect_file import detect_file

        found = detect_file(cloud_asked(options), kind, hint, lambda step: report(step, 0.3))
    if as_json:
        print_json(found)
        return
    if found["hits"]:
        print_table(screen, HIT_COLUMNS, [hit_row(hit) for hit in found["hits"]])
    else:
        screen.print(f"no {kind} was found", markup=False)
    for note in found["notes"]:
        screen.print(f"note: {note}", markup=False, soft_wrap=True)
