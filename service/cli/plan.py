"""``scopt plan``, ``verify`` and ``view``: plans and results on this machine."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from costs.stopping import stops_when
from service.cli.command import command
from service.cli.motions.planning import plan_and_write
from service.cli.options import Json, PlanningOptions
from service.cli.report import print_result
from service.cli.run import cancellable, consoles, print_json, progress

if TYPE_CHECKING:
    from service.request.schema import PlanRequest
    from service.result.approval import Approval
    from service.setup.world import Surroundings

ResultPath = Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")]


@command(has_verdict=True)
def plan_command(
    request: Annotated[
        Path,
        typer.Argument(help="Request file (YAML or JSON); with --from-phase an earlier result.", metavar="REQUEST"),
    ],
    planning: PlanningOptions,
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
    adjust: Annotated[
        list[str] | None,
        typer.Option(
            help="With --from-phase: a target is elsewhere [m]; a goal's link, valve, a contact patch or an obstacle.",
            metavar="TARGET:X,Y,Z",
        ),
    ] = None,
    compliant: Annotated[
        bool,
        typer.Option("--compliant", help="With --from-phase: keep the plan's motion if the arm that holds can yield."),
    ] = False,
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
    untimed: Annotated[
        bool,
        typer.Option("--untimed", help="Plan and certify the path of a TrajOpt problem alone: no speeds, no forces."),
    ] = False,
    no_torque: Annotated[
        bool, typer.Option("--no-torque", help="Do not check the joint torques of a TrajOpt problem.")
    ] = False,
) -> str:
    """Plan a request, certify the motion, write the result.

    With --trajopt, REQUEST is a TrajOpt problem (JSON). Its robot comes with --robot or basic_info.robot, its scene
    with --scene or --cloud. It starts at --start, else at the first row of a given_traj, else at the robot's posture.

    With --from-phase, REQUEST is the result of an earlier plan. The new motion starts at --state and keeps the earlier
    plan's choices; --cloud gives a new scan, and --adjust displaces what is not where it was. With --compliant the
    earlier motion itself is certified for the displaced mechanism, with the arm displaced that holds it; --state may
    then be left out, for a robot that is where the plan begins the phase. Where that fails, the rest is planned again.
    """
    _check_rest_options(from_phase, state, adjust or [], is_compliant=compliant)
    name = request.stem if from_phase is None else f"{(request.parent if request.is_file() else request).name}-rest"
    folder = out if out is not None else Path("out") / name
    paths = (robot, srdf, package_root, floating, scene, start)
    if not trajopt and (untimed or no_torque or set(paths) != {None}):
        raise typer.BadParameter(
            "--robot, --srdf, --package-root, --floating-base, --scene, --start, --untimed and --no-torque "
            "go with --trajopt; a request holds all of them"
        )

    def read() -> tuple[PlanRequest, Surroundings | None]:
        if trajopt:
            from service.trajopt.request import TrajoptFiles, load_trajopt_request

            files = TrajoptFiles(*paths, planning.time_limit, is_timed=not untimed, checks_torque=not no_torque)
            return _see(load_trajopt_request(request, files), cloud), None
        if from_phase is not None:
            return _read_rest(request, from_phase, state, cloud, adjust or [], is_compliant=compliant)
        from service.request.file import load_request

        return _see(load_request(request), cloud), None

    return plan_and_write(read, folder, planning, as_json=as_json)


def _check_rest_options(phase: str | None, state: Path | None, adjust: Sequence[str], *, is_compliant: bool) -> None:
    """Raise BadParameter for options of the rest of a plan that do not go together."""
    is_rest = phase is not None
    if is_rest != (state is not None) and not (is_compliant and is_rest):
        raise typer.BadParameter("--from-phase and --state come together")
    if (adjust or is_compliant) and not is_rest:
        raise typer.BadParameter("--adjust and --compliant go with --from-phase")


def _see(request: PlanRequest, cloud: Path | None) -> PlanRequest:
    """Return a request with its cloud replaced, if another is given."""
    from service.request.file import replace_cloud

    return request if cloud is None else replace_cloud(request, cloud)


def _read_rest(
    result: Path, phase: str, state: Path | None, cloud: Path | None, adjustments: Sequence[str], *, is_compliant: bool
) -> tuple[PlanRequest, Surroundings | None]:
    """Return the request for the rest of an earlier plan, and what its scan showed unless there is a new one."""
    from service.replay.adjust import adjust_request, read_adjustment
    from service.replay.rest import make_rest_request, read_recorded_scan

    request = make_rest_request(result, phase, state, cloud, is_compliant=is_compliant)
    around = read_recorded_scan(result, request) if cloud is None else None
    for target, offset in map(read_adjustment, adjustments):
        request, around = adjust_request(request, around, target, offset)
    return request, around


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
    trust: Annotated[
        Path | None,
        typer.Option(help="Public key (PEM): require a valid approval.json in the folder, signed for these files."),
    ] = None,
    revocations: Annotated[
        list[Path] | None,
        typer.Option(help="With --trust: file or folder of revocations that are known besides; repeat."),
    ] = None,
    as_json: Json = False,
) -> str:
    """Check a result anew, without the planner; files that are not checked are named."""
    from service.result.folder import APPROVAL_NAME, REVOCATION_NAME

    stdout, stderr = consoles()
    approval = read_approval(result, trust, revocations or [])
    with progress(stderr, "read result") as report, cancellable(stderr) as should_stop:
        report("read result", 0.0)
        from service.replay.replay import verify_result

        report("verify", 0.1)
        with stops_when(should_stop):
            signed = () if approval is None else (APPROVAL_NAME, REVOCATION_NAME)
            summary = verify_result(result, request, cloud or [], signed)
    if as_json:
        print_json(summary if approval is None else {**summary, "approval": dataclasses.asdict(approval)})
    else:
        lines = {} if approval is None else {"approved by": approval.describe()}
        if summary["standing"] is not None:
            lines["standing"] = summary["standing"]["sentence"]
        print_result(stdout, summary, lines)
    return str(summary["verdict"])


def read_approval(result: Path, trust: Path | None, revocations: Sequence[Path]) -> Approval | None:
    """Return the valid approval of a result's folder; None where no key is trusted.

    Raises:
        BadParameter: there are revocations and no key.
        ResultError: the approval is missing, expired, revoked, forged or of other files.
        TrustError: the key cannot be used.
    """
    if trust is None:
        if revocations:
            raise typer.BadParameter("--revocations goes with --trust")
        return None
    from service.result.approval import check_approval, read_public_key
    from service.result.folder import result_path

    return check_approval(result_path(result).parent, read_public_key(trust), revocations=revocations)


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
