"""``scopt track``: a plan carried out by online pose control, on the computer or in physics."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from costs.stopping import poll, stops_when
from service.cli.command import command
from service.cli.options import Json
from service.cli.plan import read_approval
from service.cli.report import print_findings, print_line, print_table, print_verdict
from service.cli.run import cancellable, consoles, print_json, progress
from service.cli.simulate import print_moves

if TYPE_CHECKING:
    from service.execution.driver import RobotDriver
    from service.execution.execution import Cycle, Execution
    from service.execution.reference import PlannedReference
    from service.execution.settings import ExecutionSettings
    from service.execution.tracking import Action
    from service.simulation.follow import WorkWatch
    from service.simulation.options import SimulationOptions

SETTLE_S = 3.0  # that a robot in physics stands after the plan [s]
SHIFT = re.compile(r"([^:@\s]+):([^@]+)@(.+)")
SHIFT_HELP = "LINK:X,Y,Z@TIME"


@command(has_verdict=True)
def track_command(
    result: Annotated[Path, typer.Argument(help="Result folder or its result.json.", metavar="RESULT")],
    physics: Annotated[
        bool, typer.Option("--physics", help="In MuJoCo, with guards, pelvis estimator and soft touchdown.")
    ] = False,
    dry: Annotated[
        bool, typer.Option("--dry", help="With --robot: compare the robot with the plan's start; nothing is commanded.")
    ] = False,
    robot: Annotated[
        str | None, typer.Option(help="For --dry: the robot, as scopt serve has it.", metavar="NAME,KEY=VALUE,...")
    ] = None,
    start_tolerance: Annotated[
        float, typer.Option(help="For --dry: how far a joint may be from the plan's start [rad, m].")
    ] = 0.05,
    gains: Annotated[
        str, typer.Option(help="Of the pose control: follow, or table-1 for those of Liu et al. 2015.")
    ] = "follow",
    speed: Annotated[float, typer.Option(help="Of the plan's clock, share of real time.")] = 1.0,
    shift: Annotated[
        list[str] | None,
        typer.Option(help="Displace the target of a foot or hand at a time [m, s]; repeat.", metavar=SHIFT_HELP),
    ] = None,
    pause: Annotated[list[float] | None, typer.Option(help="Pause at this time [s]; repeat.")] = None,
    resume: Annotated[list[float] | None, typer.Option(help="Resume at this time [s]; repeat.")] = None,
    abort: Annotated[float | None, typer.Option(help="Abort at this time [s].")] = None,
    adjust: Annotated[
        str | None,
        typer.Option(
            help="Pause at a time and plan again from that phase on with a displaced goal's link, valve or door.",
            metavar="TARGET:X,Y,Z@TIME",
        ),
    ] = None,
    rest: Annotated[Path | None, typer.Option(help="Result folder of that plan; by default NAME-rest.")] = None,
    abort_share: Annotated[
        float, typer.Option(help="Where between its expected force and its cap a hand's force aborts, 0 to 1.")
    ] = 0.5,
    stiff: Annotated[bool, typer.Option("--stiff", help="Without soft touchdown.")] = False,
    noise: Annotated[float, typer.Option(help="Of the sensors in physics; 1 is usual, 0 is none.")] = 0.0,
    perturb: Annotated[
        float, typer.Option(help="Size of random errors of the physics against the plan; 1: surfaces 1 cm, masses 5 %.")
    ] = 0.0,
    hand_friction: Annotated[
        float | None,
        typer.Option(help="In physics, between hands and what they move; by default the least of the request."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of noise and errors.")] = 0,
    trust: Annotated[
        Path | None, typer.Option(help="Public key (PEM): carry out only what a valid approval.json covers.")
    ] = None,
    revocations: Annotated[
        list[Path] | None, typer.Option(help="With --trust: file or folder of revocations that are known; repeat.")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File for the report (JSON).")] = None,
    as_json: Json = False,
) -> str:
    """Carry out a plan with online pose control at 1 kHz: does it end, and how far off is it?

    Every cycle solves a quadratic program for the joint speeds. The plan is verified first. The verdict is TRACKED,
    ABORTED or FELL; with --physics a plan that is tracked to its end is DONE or STOOD, as in scopt simulate.
    """
    stdout, stderr = consoles()
    if trust is not None and (shift or adjust is not None):
        raise typer.BadParameter("--trust goes without --shift and --adjust: the motion that they make is not approved")
    if dry or robot is not None:
        return _run_dry(result, robot if dry else None, start_tolerance, as_json=as_json)
    read_approval(result, trust, revocations or [])
    with progress(stderr, "verify plan") as report, cancellable(stderr) as should_stop, stops_when(should_stop):
        report("verify plan", 0.0)
        from service.execution.execution import Execution
        from service.execution.replan import read_certified
        from service.execution.tracking import KinematicRobot, track

        actions = _list_actions(shift or [], pause or [], resume or [], abort, adjust)
        folder = result.parent if result.is_file() else result
        reference = read_certified(folder)
        settings = _make_settings(gains, speed, abort_share, _read_servos(reference, folder), stiff=stiff)
        look: Callable[[Cycle], Mapping[str, float]] | None = None
        work: WorkWatch | None = None
        driver: RobotDriver
        if physics:
            from service.simulation.options import SimulationOptions

            options = SimulationOptions(noise=noise, perturb=perturb, seed=seed, hand_friction=hand_friction)
            driver, look, work = _make_physics(folder, reference, options)
        else:
            driver = KinematicRobot(reference.joint_names, reference.at(0.0).q)
        execution = Execution(reference, driver, settings)
        truth: dict[str, float] = {}

        def watch(cycle: Cycle) -> None:
            poll()
            if work is not None:
                work.look(execution)
            if look is not None:
                for key, value in look(cycle).items():
                    truth[key] = max(truth.get(key, 0.0), value)
            report("track", min(cycle.state.time_s / max(execution.reference.duration_s, 1e-9), 1.0))

        def plan_again(execution: Execution, action: Action) -> PlannedReference:
            report(f"plan again from {execution.reference.phases[execution.state.phase].name}", None)
            new = folder.parent / f"{folder.name}-rest" if rest is None else rest
            return _plan_again(execution, action, folder, new, should_stop)

        made = track(execution, actions, on_cycle=watch, replan=plan_again, settle_s=SETTLE_S if physics else 0.0)
        summary = {"result": str(folder), "physics": physics, "gains": gains, **made.to_dict(), "truth": truth}
        if work is not None:
            summary |= _report_work(work, made.verdict)
        if output is not None:
            _write_report(output, summary)
    if as_json:
        print_json(summary)
    else:
        _print_track(stdout, summary)
    return str(summary["verdict"])


def _run_dry(result: Path, robot: str | None, tolerance: float, *, as_json: bool) -> str:
    """Compare a robot with a plan's start and print every difference; nothing is commanded.

    Raises:
        RequestError, ExecutionError: one sentence: the robot cannot be opened.
    """
    if robot is None:
        raise typer.BadParameter("--dry and --robot belong together; plans are carried out by scopt execute")
    if not 0.0 < tolerance <= 0.5:
        raise typer.BadParameter(f"--start-tolerance: expected above 0 and at most 0.5, got {tolerance:g}")
    from dataclasses import asdict

    from service.errors import ExecutionError
    from service.execution.replan import read_certified
    from service.work.robot.dry import compare_robot
    from service.work.robot.robot import open_robot

    folder = result.parent if result.is_file() else result
    reference = read_certified(folder)
    opened = open_robot(robot)
    try:
        differences = compare_robot(opened.drive(reference, folder, False, tolerance), reference, tolerance)
    except OSError as error:
        raise ExecutionError(f"--robot {robot}: {error}") from None
    finally:
        opened.close()
    verdict = "DIFFERS" if differences else "MATCHES"
    lines = [f"{one.what}: {one.sentence}" for one in differences]
    summary = {"verdict": verdict, "explanation": lines or ["the robot says what the plan's start expects"]}
    if as_json:
        print_json({**summary, "differences": [asdict(one) for one in differences]})
    else:
        print_verdict(consoles()[0], summary)
    return verdict


def _report_work(work: WorkWatch, tracked: str) -> dict[str, Any]:
    """Return the verdict of a run in physics, and what became of the plan's work."""
    judged = work.judge()
    verdict = judged.verdict if tracked == "TRACKED" or judged.verdict == "FELL" else tracked
    moves = [move.to_json() for move in judged.moves]
    return {"verdict": verdict, "explanation": list(judged.reasons), "mechanism": moves}


def _read_servos(reference: PlannedReference, folder: Path) -> Mapping[str, float]:
    """Return the stiffness of the servos by joint as the request of a result folder has it [N m/rad, N/m]."""
    from service.simulation.stand import read_recorded_request
    from service.start.robot import resolve_stiffness

    return resolve_stiffness(reference.robot, read_recorded_request(folder))


def _make_settings(
    gains: str, speed: float, abort_share: float, stiffness: Mapping[str, float], *, stiff: bool
) -> ExecutionSettings:
    """Return the settings that the options describe, with the stiffness of the servos by joint.

    Raises:
        ExecutionError: the preset of gains is unknown, or a number is out of range.
    """
    from dataclasses import replace

    from service.errors import ExecutionError, would_do
    from service.execution.gains import PRESETS
    from service.execution.guards import GuardSettings
    from service.execution.machine import MachineSettings
    from service.execution.settings import ExecutionSettings
    from service.execution.watch.servos import ServoModel
    from service.execution.watch.watch import WatchSettings

    if gains not in PRESETS:
        raise ExecutionError(f"--gains: unknown preset {gains!r}; expected {would_do(gains, PRESETS)}")
    machine, guards = MachineSettings(speed=speed), GuardSettings(load_share=abort_share)
    watch = WatchSettings(servos=ServoModel(stiffness=stiffness))
    settings = ExecutionSettings(gains=PRESETS[gains], machine=machine, guards=guards, watch=watch)
    return replace(settings, touchdown=None) if stiff else settings


def _plan_again(
    execution: Execution, action: Action, folder: Path, new: Path, should_stop: Callable[[], bool]
) -> PlannedReference:
    """Return the rest of a plan, planned again with a displaced target; it is written into the folder ``new``."""
    from service.execution.replan import plan_rest, write_state

    phase = execution.reference.phases[execution.state.phase].name
    new.parent.mkdir(parents=True, exist_ok=True)
    state = new.parent / f".{new.name}.state.json"
    write_state(execution, state)
    try:
        return plan_rest(folder, phase, state, {action.link: action.offset}, new, should_stop=should_stop)
    finally:
        state.unlink()


def _list_actions(
    shifts: list[str], pauses: list[float], resumes: list[float], abort: float | None, adjust: str | None
) -> list[Action]:
    """Return the actions that the options schedule."""
    from service.execution.machine import Order
    from service.execution.tracking import Action

    times = {Order.PAUSE: pauses, Order.RESUME: resumes, Order.ABORT: [] if abort is None else [abort]}
    actions = [Action(at, order) for order, ats in times.items() for at in ats]
    actions += [_read_shift("--shift", text) for text in shifts]
    if adjust is not None:
        moved = _read_shift("--adjust", adjust)
        actions.append(Action(moved.at_s, link=moved.link, offset=moved.offset, plans=True))
    return actions


def _read_shift(option: str, text: str) -> Action:
    """Return the displacement that an option describes.

    Raises:
        ExecutionError: it does not follow ``LINK:X,Y,Z@TIME``.
    """
    import numpy as np

    from service.errors import ExecutionError, shown
    from service.execution.tracking import Action

    match = SHIFT.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        offset = np.array([float(part) for part in match[2].split(",")])
        at_s = float(match[3])
        if offset.shape != (3,) or not (np.isfinite(offset).all() and 0.0 <= at_s < np.inf):
            raise ValueError
    except ValueError:
        raise ExecutionError(f"{option}: {shown(text)}; expected {SHIFT_HELP}, such as r_hand:0.02,0,0@1.5") from None
    return Action(at_s, link=match[1], offset=offset)


def _make_physics(
    folder: Path, reference: PlannedReference, options: SimulationOptions
) -> tuple[RobotDriver, Callable[[Cycle], Mapping[str, float]], WorkWatch]:
    """Return a simulated robot at the plan's start, a function that compares it with what is known, and its work."""
    import numpy as np
    import pinocchio as pin

    from service.simulation.follow import WorkWatch
    from service.simulation.stand import read_recorded_request, stand_in_physics

    robot = stand_in_physics(reference, read_recorded_request(folder), options)
    count, numbers = 0, {phase.name: k for k, phase in enumerate(reference.phases)}  # a new plan keeps the names
    data = reference.robot.model.createData()
    groups = reference.robot.link_groups
    links = (*groups.get("feet", ()), *groups.get("hands", ()))

    def place(q: np.ndarray) -> dict[str, np.ndarray]:
        pin.framesForwardKinematics(reference.robot.model, data, q)
        return {link: data.oMf[reference.robot.model.getFrameId(link)].translation.copy() for link in links}

    def look(cycle: Cycle) -> dict[str, float]:
        nonlocal count
        count += 1
        if count % 10:
            return {}
        robot.hold_grips(numbers.get(cycle.phase))
        commanded, true = place(cycle.command.q), place(robot.configuration())
        off = {f"{link} off its command [m]": float(np.linalg.norm(commanded[link] - true[link])) for link in links}
        if cycle.estimate is not None:
            off["pelvis off its estimate [m]"] = float(
                np.linalg.norm(cycle.estimate.position - robot.pose_world_base[:3, 3])
            )
        for foot, wrench in robot.measure_contact_wrenches().items():
            off[f"upright force on {foot} [N]"] = float(wrench[2])
        return off

    return robot, look, WorkWatch(robot)


def _write_report(path: Path, summary: Mapping[str, Any]) -> None:
    import json

    from service.errors import ResultError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(summary, allow_nan=False))
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror}") from None


def _print_track(out: Console, summary: Mapping[str, Any]) -> None:
    """Print phases and modes, distances, computing times and the verdict."""
    rows = [
        (f"{change['at_s']:.2f} s", f"{change['plan_s']:.2f} s", change["mode"], change["phase"], change["reason"])
        for change in summary["changes"]
    ]
    print_table(out, ("time", "plan", "mode", "phase", "why"), rows)
    reason = [summary["reason"]] if summary["reason"] else []
    reason += summary.get("explanation", [])
    print_findings(out, {"explanation": reason})
    print_moves(out, summary.get("mechanism", []))
    for fault in summary["faults"]:
        print_line(out, "fault", f"{fault['at_s']:.2f} s, {fault['name']}, {fault['reaction']}: {fault['sentence']}")
    for sentence in summary["unwatched"]:
        print_line(out, "not watched", sentence)
    for one in summary["assumptions"]:
        if not one["watched_by"]:
            print_line(out, "assumed", f"{one['sentence']}; nothing watches it")
    off = ", ".join(f"{link} {1e3 * value:.1f} mm" for link, value in summary["off_m"].items())
    print_line(out, "off the plan", off or "no feet or hands")
    for label, value in summary["truth"].items():
        name, unit = label.rsplit(" ", 1)
        print_line(out, "physics", f"{name}: {1e3 * value:.1f} mm" if unit == "[m]" else f"{name}: {value:.0f} N")
    shares = f"speed {100.0 * summary['speed_share']:.0f} %, acceleration {100.0 * summary['acceleration_share']:.0f} %"
    print_line(out, "of the limits", shares)
    for label, key in (("pose control", "control_ms"), ("whole cycle", "cycle_ms")):
        p50, p99, most = summary[key]
        print_line(out, label, f"{p50:.3f} ms median, {p99:.3f} ms 99th percentile, {most:.1f} ms at most")
    ended = reason or [f"to the end of the plan in {summary['run_s']:.1f} s"]
    print_verdict(out, {"verdict": summary["verdict"], "explanation": ended})
