"""``scopt robots``: the bundled robots, what a robot has, and the link pairs that overlap at its rest."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command import command
from service.cli.options import Json
from service.cli.report import print_table
from service.cli.run import consoles, print_json

if TYPE_CHECKING:
    from rich.console import Console

    from costs.robot import RobotModel

CHECK = "check"


@command()
def robots_command(
    robot: Annotated[
        list[str] | None,
        typer.Argument(
            help="A bundled robot, or a URDF or MJCF file to describe; 'check URDF' finds links that overlap at rest.",
            metavar="[check] NAME_OR_URDF",
        ),
    ] = None,
    srdf: Annotated[Path | None, typer.Option(help="SRDF of the URDF.")] = None,
    package_dir: Annotated[
        list[Path] | None, typer.Option(help="Folder that package:// starts in; repeatable.", metavar="FOLDER")
    ] = None,
    root: Annotated[
        str | None,
        typer.Option(help="Base: floating, planar, differential or fixed (a URDF's default).", metavar="ROOT"),
    ] = None,
    write_srdf: Annotated[
        Path | None, typer.Option(help="With check: write an SRDF that leaves out the pairs.", metavar="FILE")
    ] = None,
    decompose: Annotated[
        list[str] | None,
        typer.Option(help="Link whose meshes are split into convex parts; repeatable.", metavar="LINK"),
    ] = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="New folder that gets the robot as it was read: URDF, SRDF, meshes.")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the bundled robots, or what a robot has: joints with limits, links with shapes, groups and postures.

    With 'check', list the link pairs that are not checked against each other and those that overlap at rest. With
    --decompose, links have convex parts in place of concave meshes, whose hulls fill their hollows.
    """
    words = list(robot or ())
    is_check = words[:1] == [CHECK]
    words = words[1:] if is_check else words
    if len(words) > 1 or (is_check and not words):
        raise typer.BadParameter(f"expected {'check and ' if is_check else ''}one robot, got {len(words)}")
    if write_srdf is not None and not is_check:
        raise typer.BadParameter("--write-srdf goes with: scopt robots check NAME_OR_URDF")
    if (decompose or out_folder is not None) and not words:
        raise typer.BadParameter("--decompose LINK and --out FOLDER go with a robot file")
    if is_check and out_folder is not None:
        raise typer.BadParameter("--out FOLDER goes without check")
    out = consoles()[0]
    if not words:
        _list_bundled(out, as_json)
        return
    model = _load(words[0], srdf, package_dir or [], root, decompose or [])
    if out_folder is not None:
        _write(out, model, out_folder, as_json)
        return
    if is_check:
        _check(out, model, write_srdf, as_json)
        return
    from service.start.robot_report import describe_robot

    described = describe_robot(model)
    if as_json:
        print_json(described)
    else:
        _print_robot(out, described)


def _write(out: Console, model: RobotModel, folder: Path, as_json: bool) -> None:
    """Write a robot to a new folder, and print how a request names it."""
    from service.errors import RequestError, ResultError
    from service.result.output import URDF_NAME, write_robot

    try:
        write_robot(model, folder)
    except FileExistsError:
        raise RequestError(f"--out: {folder} is there already; expected a new folder") from None
    except (OSError, ResultError) as error:
        raise RequestError(f"--out: {folder} cannot be written ({getattr(error, 'strerror', None) or error})") from None
    counts = {body.link: sum(other.link == body.link for other in model.bodies) for body in model.bodies}
    if as_json:
        print_json({"urdf": str(folder / URDF_NAME), "parts": counts})
        return
    print_table(out, ("link", "convex parts"), [(link, str(count)) for link, count in counts.items()])
    out.print(f"robot: {{urdf: {folder / URDF_NAME}, package_dirs: [{folder}]}}", markup=False, soft_wrap=True)


def _load(name: str, srdf: Path | None, package_dirs: list[Path], root: str | None, decompose: list[str]) -> RobotModel:
    """Load a robot (RequestError if it cannot be loaded)."""
    from service.request.file import parse_request
    from service.start.robot import load_requested_robot

    is_file = name.endswith((".urdf", ".xml", ".mjcf", ".xacro")) or "/" in name or Path(name).is_file()
    data: dict[str, Any] = {"urdf": str(Path(name).absolute())} if is_file else {"name": name}
    if srdf is not None:
        data["srdf"] = str(srdf.absolute())
    if package_dirs:
        data["package_dirs"] = [str(folder.absolute()) for folder in package_dirs]
    if root is not None:
        data["root"] = root
    if decompose:
        data["decompose"] = decompose
    request = parse_request({"robot": data, "goal": {"joints": {"any": 0.0}}}, folder=Path.cwd())
    return load_requested_robot(request, finds_package=True)


def _check(out: Console, model: RobotModel, write_srdf: Path | None, as_json: bool) -> None:
    from service.errors import RequestError
    from service.start.robot_report import check_robot

    found = check_robot(model)
    if write_srdf is not None:
        try:
            write_srdf.write_text(found.srdf, encoding="utf-8")
        except OSError as error:
            raise RequestError(f"--write-srdf: {write_srdf} cannot be written ({error.strerror})") from None
    deepest_first = sorted(found.overlapping.items(), key=lambda item: -item[1][1])
    overlapping = [
        {"links": list(pair), "posture": posture, "depth_m": depth} for pair, (posture, depth) in deepest_first
    ]
    if as_json:
        ignored = [{"links": list(pair), "reason": reason} for pair, reason in sorted(found.ignored.items())]
        print_json({"name": model.name, "ignored": ignored, "overlapping": overlapping, "notes": list(model.notes)})
        return
    rows = [(*pair, reason) for pair, reason in sorted(found.ignored.items())]
    print_table(out, ("link", "link", "not checked because"), rows)
    out.print()
    if overlapping:
        shown = [(*pair, posture, f"{1e3 * depth:.1f} mm") for pair, (posture, depth) in deepest_first]
        print_table(out, ("link", "link", "overlap in the posture", "depth"), shown)
        out.print(
            "\nA start in such a posture is refused. An SRDF may leave the pairs out (disable_collisions); the "
            "certificate then says what it does not cover. Where a link's mesh is concave, robot.decompose: [LINK] "
            "in a request takes convex parts in its place, and --decompose LINK shows here what remains."
        )
    else:
        out.print("No links overlap at rest.")
    _print_notes(out, model.notes)
    if write_srdf is not None:
        out.print(f"\nSRDF: {write_srdf} ({len(found.ignored) + len(overlapping)} pairs)", soft_wrap=True)


def _print_robot(out: Console, robot: dict[str, Any]) -> None:
    out.print(f"{robot['name']}: {robot['base']} base, {robot['mass_kg']:.4g} kg")
    rows = [
        (joint["name"], *(_show(joint[key]) for key in ("lower", "upper", "velocity", "effort")), joint["unit"])
        for joint in robot["joints"]
    ]
    out.print()
    print_table(out, ("joint", "from", "to", "speed", "effort", "unit"), rows)
    if robot["followers"]:
        out.print()
        rows = [
            (one["name"], f"{one['multiplier']:g} x {one['follows']} {one['offset']:+g}") for one in robot["followers"]
        ]
        print_table(out, ("follower", "is at"), rows)
    out.print()
    rows = [(link["name"], str(link["shapes"] or "none"), "yes" if link["moves"] else "no") for link in robot["links"]]
    print_table(out, ("link or frame", "shapes", "moves"), rows)
    for title, lists in (("group", robot["groups"]), ("group of links", robot["link_groups"])):
        if lists:
            out.print()
            print_table(out, (title, "members"), [(name, ", ".join(members)) for name, members in lists.items()])
    out.print()
    out.print(f"postures: {', '.join(robot['postures']) or 'none; give start.joints'}", soft_wrap=True)
    ignored = ", ".join(f"{count} {reason}" for reason, count in robot["ignored_pairs"].items())
    out.print(f"link pairs not checked against each other: {ignored or 'none'}", soft_wrap=True)
    _print_notes(out, robot["notes"])


def _print_notes(out: Console, notes: tuple[str, ...] | list[str]) -> None:
    for note in notes:
        out.print(f"note: {note}", soft_wrap=True)


def _show(value: float | None) -> str:
    return "unlimited" if value is None else f"{value:.4g}"


def _list_bundled(out: Console, as_json: bool) -> None:
    """List the robots that ship with scopt, and the patches of theirs that may carry force."""
    from costs.robot import PATCH_DEFAULTS, bundled_contacts, bundled_robots

    robots = bundled_robots()
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
