"""``scopt move``: single motions of hands, joints and body by a word each; every one is a step of ``task.steps``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command import CommandLine, command
from service.cli.motions.planning import plan_and_write
from service.cli.motions.task import read_settings
from service.cli.options import Json, PlanningOptions

if TYPE_CHECKING:
    from service.request.schema import PlanRequest

move_app = CommandLine(
    help="Single motions: each is a step of task.steps.", no_args_is_help=True, rich_markup_mode=None
)
Triple = tuple[float, float, float]
ROTATION_HELP = "Turn about x, then y, then z [deg]."


@dataclass(frozen=True)
class WhereOptions(PlanningOptions):
    """Robot, state and surroundings of a motion, and how it is planned."""

    request: Annotated[Path | None, typer.Option(help="Request file with robot, start and scene.")] = None
    robot: Annotated[str, typer.Option(help="Bundled robot, without --request.")] = "atlas"
    state: Annotated[Path | None, typer.Option(help="File with the robot's state: joints, base.")] = None
    cloud: Annotated[Path | None, typer.Option(help="Point cloud of the surroundings.")] = None
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Result folder; by default out/move-NAME.")] = None


@dataclass(frozen=True)
class HandOptions:
    """Which hand moves, and how."""

    hand: Annotated[str | None, typer.Option(help="left, right or both.")] = None
    frame: Annotated[str | None, typer.Option(help="Frame of the robot, instead of a hand.")] = None
    other_hand: Annotated[str, typer.Option(help="The other hand: keep its pose, lock its joints, or free.")] = "keep"
    free_axis: Annotated[str, typer.Option(help="Axis of the hand about which it may turn: x, y, z, all.")] = "none"
    speed: Annotated[float | None, typer.Option(help="Speed of the hand [m/s].")] = None
    duration: Annotated[float | None, typer.Option(help="Duration [s].")] = None

    def to_step(self) -> dict[str, Any]:
        """Return the fields of a step."""
        given = {"hand": self.hand, "frame": self.frame, "speed_m_s": self.speed, "duration_s": self.duration}
        kept = {"other_hand": self.other_hand, "free_axis": self.free_axis}
        return {**{key: value for key, value in given.items() if value is not None}, **kept}


def _plan(name: str, step: dict[str, Any], where: WhereOptions, *, as_json: bool) -> str:
    """Plan one step, write its result; return the verdict."""
    folder = where.out if where.out is not None else Path("out") / f"move-{name}"
    return plan_and_write(lambda: (read_move_request(step, where), None), folder, where, as_json=as_json)


def read_move_request(step: dict[str, Any], where: WhereOptions) -> PlanRequest:
    """Return the request of one step from the robot's state.

    Raises:
        RequestError: a file or a value cannot be used.
    """
    from service.request.file import parse_request, read_plain_request

    data: dict[str, Any] = (
        {"robot": {"name": where.robot}} if where.request is None else read_plain_request(where.request)
    )
    if where.state is not None:
        data["start"] = read_plain_request(where.state)
    if where.cloud is not None:
        data["scene"] = {**(data.get("scene") or {}), "cloud": str(where.cloud.absolute())}
    data.pop("goal", None)
    data["task"] = {"steps": [step]}
    return parse_request(data, Path.cwd() if where.request is None else where.request.parent)


@command(has_verdict=True)
def line_command(
    where: WhereOptions,
    hand: HandOptions,
    by: Annotated[Triple, typer.Option(help="Translation [m].")] = (0.0, 0.0, 0.0),
    rotate: Annotated[Triple, typer.Option(help=ROTATION_HELP)] = (0.0, 0.0, 0.0),
    axes: Annotated[str, typer.Option(help="Axes of both: world or hand.")] = "world",
    as_json: Json = False,
) -> str:
    """Move a hand, or both, along a line."""
    shift = {"translation": list(by), "rotation_deg": list(rotate), "axes": axes}
    return _plan("line", {"move": {**hand.to_step(), "by": shift, "along": "line"}}, where, as_json=as_json)


@command(has_verdict=True)
def circle_command(
    where: WhereOptions,
    hand: HandOptions,
    centre: Annotated[Triple, typer.Option(help="Point of the axis [m].")],
    axis: Annotated[Triple, typer.Option(help="Direction of the axis.")] = (1.0, 0.0, 0.0),
    angle: Annotated[float, typer.Option(help="Positive by the right hand [deg].")] = 360.0,
    turns: Annotated[bool, typer.Option("--turns/--keeps", help="Whether the hand turns along.")] = True,
    as_json: Json = False,
) -> str:
    """Move a hand, or both, along an arc about an axis in the world."""
    arc = {"centre": list(centre), "axis": list(axis), "angle_deg": angle, "turns": turns}
    return _plan("circle", {"move": {**hand.to_step(), "arc": arc, "along": "arc"}}, where, as_json=as_json)


@command(has_verdict=True)
def plunge_command(
    where: WhereOptions,
    hand: HandOptions,
    by: Annotated[float, typer.Option(help="Along the hand's z axis, negative to retract [m].")],
    as_json: Json = False,
) -> str:
    """Move a hand, or both, along its own axis."""
    screw = {**hand.to_step(), "axis": [0.0, 0.0, 1.0], "axes": "hand", "translation_m": by}
    return _plan("plunge", {"screw": screw}, where, as_json=as_json)


@command(has_verdict=True)
def nudge_command(
    where: WhereOptions,
    key: Annotated[str, typer.Argument(help="Up, Down, Left, Right, i, o; e, d, s, f, w, r or their capitals; q, a.")],
    hand: Annotated[str, typer.Option(help="left, right or both.")] = "right",
    other_hand: Annotated[str, typer.Option(help="The other hand: keep its pose, lock its joints, or free.")] = "keep",
    free_axis: Annotated[str, typer.Option(help="Axis of the hand about which it may turn: x, y, z, all.")] = "none",
    middle: Annotated[Triple | None, typer.Option(help="Point about which both hands turn [m].")] = None,
    neck: Annotated[str | None, typer.Option(help="Joint of the neck and where it is.", metavar="JOINT=VALUE")] = None,
    touch_force: Annotated[float | None, typer.Option(help="The hand may touch, up to this force [N].")] = None,
    touch: Annotated[list[str] | None, typer.Option(help="Piece that the hand may touch; repeatable.")] = None,
    as_json: Json = False,
) -> str:
    """Nudge a hand, both hands or the neck by a key of the console: 1 cm or 0.02 rad."""
    from service.request.tasks.nudges import NudgeSettings, Touch, make_nudge

    (joint,) = read_settings([neck]).items() if neck is not None else (None,)
    touched = None if touch_force is None else Touch(tuple(touch or ()), touch_force)
    settings = NudgeSettings(hand, other_hand, free_axis, middle, joint, touch=touched)  # type: ignore[arg-type]
    return _plan("nudge", make_nudge(key, settings), where, as_json=as_json)


@command(has_verdict=True)
def joints_command(
    where: WhereOptions,
    settings: Annotated[
        list[str], typer.Option("--set", help="Position [rad, m]; may be given again.", metavar="JOINT=VALUE")
    ],
    along: Annotated[str, typer.Option(help="free, joint_linear, joint_cubic or joint_quintic.")] = "joint_cubic",
    duration: Annotated[float | None, typer.Option(help="Duration [s]; the fastest by default.")] = None,
    as_json: Json = False,
) -> str:
    """Move joints to positions."""
    move = {"joints": read_settings(settings), "along": along}
    return _plan("joints", {"move": _with_duration(move, duration)}, where, as_json=as_json)


@command(has_verdict=True)
def body_command(
    where: WhereOptions,
    pelvis: Annotated[Triple, typer.Option(help="Translation of the pelvis [m].")] = (0.0, 0.0, 0.0),
    rotate: Annotated[Triple, typer.Option(help=f"Of the pelvis. {ROTATION_HELP}")] = (0.0, 0.0, 0.0),
    torso: Annotated[Triple, typer.Option(help=f"Of the torso. {ROTATION_HELP}")] = (0.0, 0.0, 0.0),
    hands: Annotated[str, typer.Option(help="Whether the hands stay or move along.")] = "stay",
    duration: Annotated[float | None, typer.Option(help="Duration [s].")] = None,
    as_json: Json = False,
) -> str:
    """Move the body on its feet."""
    body = {
        "pelvis_m": list(pelvis),
        "pelvis_rpy_deg": list(rotate),
        "torso_rpy_deg": list(torso),
        "hands": hands,
    }
    return _plan("body", {"body": _with_duration(body, duration)}, where, as_json=as_json)


@command(has_verdict=True)
def neck_command(
    where: WhereOptions,
    angle: Annotated[float, typer.Option(help="Position of the neck [deg].")],
    joint: Annotated[str, typer.Option(help="Joint of the neck.")] = "neck_ry",
    duration: Annotated[float | None, typer.Option(help="Duration [s].")] = None,
    as_json: Json = False,
) -> str:
    """Turn the head."""
    from math import radians

    move = {"joints": {joint: radians(angle)}, "along": "joint_cubic"}
    return _plan("neck", {"move": _with_duration(move, duration)}, where, as_json=as_json)


@command(has_verdict=True)
def preset_command(
    where: WhereOptions,
    posture: Annotated[str, typer.Argument(help="Posture of the robot (scopt robots ROBOT).", metavar="POSTURE")],
    duration: Annotated[float | None, typer.Option(help="Duration [s].")] = None,
    as_json: Json = False,
) -> str:
    """Move to a posture of the robot."""
    return _plan("preset", {"move": _with_duration({"posture": posture}, duration)}, where, as_json=as_json)


@command(has_verdict=True)
def freeze_command(
    where: WhereOptions,
    duration: Annotated[float | None, typer.Option(help="Duration [s].")] = None,
    as_json: Json = False,
) -> str:
    """Keep arms, spine and neck where they are, and stand in balance."""

    def make_request() -> tuple[PlanRequest, None]:
        plain = read_move_request({"move": {"posture": "stand"}}, where)
        move = {"joints": read_upper_joints(plain), "along": "free"}
        return read_move_request({"move": _with_duration(move, duration)}, where), None

    folder = where.out if where.out is not None else Path("out") / "move-freeze"
    return plan_and_write(make_request, folder, where, as_json=as_json)


def read_upper_joints(request: PlanRequest) -> dict[str, float]:
    """Return the positions at the start of all joints that carry no foot [rad, m].

    Raises:
        RequestError: the robot or its state cannot be used.
    """
    from service.start.configuration import make_start_configuration
    from service.start.robot import load_requested_robot

    robot = load_requested_robot(request)
    q, _ = make_start_configuration(robot, request.start)
    model = robot.model
    feet = [model.frames[model.getFrameId(foot)].parentJoint for foot in robot.link_groups.get("feet", ())]
    standing = {joint for foot in feet for joint in model.supports[foot]}
    upper = [model.joints[k] for k in range(1, model.njoints) if k not in standing]
    columns = sorted(own.idx_v for own in upper if own.nv == 1)
    return {robot.joint_names[k]: float(q[k]) for k in columns if k >= (6 if robot.is_floating else 0)}


def _with_duration(step: dict[str, Any], duration: float | None) -> dict[str, Any]:
    return step if duration is None else {**step, "duration_s": duration}


for _name, _function in {
    "line": line_command,
    "circle": circle_command,
    "plunge": plunge_command,
    "nudge": nudge_command,
    "joints": joints_command,
    "body": body_command,
    "neck": neck_command,
    "preset": preset_command,
    "freeze": freeze_command,
}.items():
    move_app.command(_name)(_function)
