"""Trajectories of another planner that are not what their file seems to say: bases, times, robots, followers."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack import bases
from benchmarks.attack.outcome import Answer, Attack
from service import certify, parse_request, plan, read_trajectory
from service.errors import RequestError
from service.request.schema import PlanRequest

FINGERS = """
  <link name="left_finger"/><link name="right_finger"/>
  <joint name="finger" type="prismatic"><parent link="hand"/><child link="left_finger"/><axis xyz="0 1 0"/>
    <limit lower="-0.1" upper="0.1" velocity="1" effort="10"/></joint>
  <joint name="other_finger" type="prismatic"><parent link="hand"/><child link="right_finger"/><axis xyz="0 1 0"/>
    <limit lower="-0.1" upper="0.1" velocity="1" effort="10"/><mimic joint="finger" multiplier="-1"/></joint>
</robot>"""
Message = dict[str, Any]
Change = Callable[[Message], Message]

LONG = ("fixed: times in milliseconds",)  # asked by results/test_certify_doubts.py too; it lasts 3,200 s


def attacks() -> list[Attack]:
    """Return lies, each with a word that the answer must have, and honest files."""
    lies = ((f"{robot}: {name}", partial(_lie, robot, *rest)) for name, (robot, *rest) in LIES.items())
    honest = ((f"certify, {robot}: {name}", partial(_honest, robot, *rest)) for name, (robot, *rest) in HONEST.items())
    return [
        *(Attack("certify", name, run, name not in LONG) for name, run in lies),
        *(Attack("harmless", name, run) for name, run in honest),
        Attack("certify", "planar: the base through the post", partial(_lie, "planar", "post", BACK, how="spline")),
        Attack("certify", "fixed: points given twice", _repeat_points),
    ]


@cache
def request_of(robot: str) -> PlanRequest:
    """Return the request of the arm with a fixed or planar base, or with fingers of which one follows the other."""
    folder = bases.original("arm").parent / f"certify-{robot}"
    data = bases.request_of("arm", folder)
    if robot == "planar":
        data["robot"]["root"] = "planar"
    if robot == "fingers":
        urdf = Path(data["robot"]["urdf"])
        urdf.write_text(urdf.read_text(encoding="utf-8").replace("</robot>", FINGERS), encoding="utf-8")
    return parse_request(data, folder)


@cache
def _samples() -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return names, times and derivatives of the honest motion of the arm."""
    result = plan(request_of("fixed"))
    return tuple(result.joint_names), result.times, result.positions, result.velocities, result.accelerations


def message_of() -> Message:
    """Return the honest motion as a RobotTrajectory."""
    names, times, q, v, a = _samples()
    points = [
        {
            "positions": q[k].tolist(),
            "velocities": v[k].tolist(),
            "accelerations": a[k].tolist(),
            "time_from_start": float(times[k]),
        }
        for k in range(len(times))
    ]
    return {"joint_trajectory": {"joint_names": list(names), "points": points}}


def _ask(
    robot: str, message: Message, scratch: Path, interpolation: Any = "auto"
) -> tuple[Answer, str, tuple[str, ...]]:
    path = scratch / "plan.json"
    path.write_text(json.dumps(message), encoding="utf-8")
    try:
        outcome = certify(read_trajectory(path), request_of(robot), interpolation)
    except RequestError as error:
        return Answer.REFUSED, str(error).splitlines()[0], ()
    if not outcome.is_certified:
        return Answer.REPORTED, "; ".join(outcome.failures), outcome.notes
    return Answer.BELIEVED, "CERTIFIED", outcome.notes


def _lie(robot: str, word: str, change: Change, scratch: Path, *, how: str = "auto") -> tuple[Answer, str]:
    answer, text, notes = _ask(robot, change(message_of()), scratch, how)
    named = [note for note in notes if word in note]
    if answer is Answer.BELIEVED and named:
        return Answer.REPORTED, f"CERTIFIED, {named[0]}"
    is_named = answer is Answer.BELIEVED or bool(named) or word in text
    return (answer, text) if is_named else (Answer.CRASHED, f"{word} is not in: {text}")


def _honest(robot: str, interpolation: str, change: Change, scratch: Path) -> tuple[Answer, str]:
    answer, text, notes = _ask(robot, change(message_of()), scratch, interpolation)
    doubts = [note for note in notes if "are its times" in note or "not read" in note or "model_id" in note]
    is_fine = answer is Answer.BELIEVED and not doubts
    return (Answer.TRUE if is_fine else Answer.ALARM), " ".join([text, *doubts])


def _repeat_points(scratch: Path) -> tuple[Answer, str]:
    """Give the points twice: readers differ in which they take."""
    text = json.dumps(message_of()["joint_trajectory"])
    (scratch / "plan.json").write_text(text[:-1] + ', "points": []}', encoding="utf-8")
    try:
        read_trajectory(scratch / "plan.json")
    except RequestError as error:
        return (Answer.REFUSED if "twice" in str(error) else Answer.CRASHED), str(error)
    return Answer.BELIEVED, "one of them is read"


def _points(message: Message) -> list[Message]:
    found: list[Message] = message["joint_trajectory"]["points"]
    return found


def _ease(message: Message) -> np.ndarray:
    """Return a share from 0 to 1 for each point, at rest at both ends."""
    s = np.array([point["time_from_start"] for point in _points(message)])
    s = s / s[-1]
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def _move_base(to: tuple[float, float, float], *, back: bool = False, shift_s: float = 0.0) -> Change:
    """Return a change that moves the base to a place [m], and perhaps back."""

    def change(message: Message) -> Message:
        share = _ease(message)
        share = 4.0 * share * (1.0 - share) if back else share
        points = []
        for point, s in zip(_points(message), share.tolist(), strict=True):
            place = dict(zip("xyz", (s * np.array(to)).tolist(), strict=True))
            transform = {"translation": place, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
            points.append({"transforms": [transform], "time_from_start": point["time_from_start"] + shift_s})
        return {**message, "multi_dof_joint_trajectory": {"joint_names": ["virtual_joint"], "points": points}}

    return change


def _times(value: Callable[[float], float], factor: float = 1.0) -> Change:
    """Return a change of all times, with derivatives as they are then if times are multiplied."""

    def change(message: Message) -> Message:
        for point in _points(message):
            point["time_from_start"] = value(point["time_from_start"])
            point["velocities"] = [v / factor for v in point["velocities"]]
            point["accelerations"] = [a / factor**2 for a in point["accelerations"]]
        return message

    return change


def _around(**more: Any) -> Change:
    """Return a change that puts the trajectory into a DisplayTrajectory with further fields."""
    return lambda message: {"model_id": "arm", "trajectory": [message], **more}


def _start(changes: dict[str, float], **more: Any) -> Change:
    """Return a change that adds a start state with some joints elsewhere."""

    def change(message: Message) -> Message:
        joints = message["joint_trajectory"]
        state = dict(zip(joints["joint_names"], _points(message)[0]["positions"], strict=True)) | changes
        body = {"joint_state": {"name": list(state), "position": list(state.values())}, **more}
        return {"model_id": "arm", "trajectory": [message], "trajectory_start": body}

    return change


def _finger(follow: Callable[[float], float], *, has_leader: bool = True) -> Change:
    """Return a change that closes a finger by 2 cm, with another one that follows as a function says."""

    def change(message: Message) -> Message:
        joints = message["joint_trajectory"]
        joints["joint_names"] += [*(["finger"] if has_leader else []), "other_finger"]
        for point, s in zip(_points(message), _ease(message).tolist(), strict=True):
            point["positions"] += [*([0.02 * s] if has_leader else []), follow(0.02 * s)]
            point["velocities"] = point["accelerations"] = []
        return message

    return change


def _scale(**factors: float) -> Change:
    """Return a change that multiplies positions, velocities or accelerations."""

    def change(message: Message) -> Message:
        for point in _points(message):
            point.update({name: [factor * value for value in point[name]] for name, factor in factors.items()})
        return message

    return change


def _exchange_names(message: Message) -> Message:
    names = message["joint_trajectory"]["joint_names"]
    names[:2] = names[1::-1]
    return message


def _point_field(**more: Any) -> Change:
    def change(message: Message) -> Message:
        _points(message)[3].update(more)
        return message

    return change


DEG = float(np.rad2deg(1.0))
BACK = _move_base((0.4, 0.0, 0.0), back=True)
ELSEWHERE = {"translation": {"x": 0.5, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
BASE_STATE = {"joint_names": ["virtual_joint"], "transforms": [ELSEWHERE]}
LIES: dict[str, tuple[str, str, Change]] = {
    "the base moved by 1 m": ("fixed", "moves the base (by 1 m", _move_base((1.0, 0.0, 0.0))),
    "the base moved and moved back": ("fixed", "moves the base", _move_base((0.3, 0.0, 0.0), back=True)),
    "the base without velocities": ("planar", "has no velocities", _move_base((-0.2, 0.0, 0.0))),
    "the base off its plane": ("planar", "leaves its plane", _move_base((0.0, 0.0, 0.3))),
    "the base with other times": ("planar", "is at", _move_base((0.1, 0.0, 0.0), shift_s=0.5)),
    "the base at another place at the start": ("planar", "base_x", _start({}, multi_dof_joint_state=BASE_STATE)),
    "the base at another place, and fixed": ("fixed", "places the base", _start({}, multi_dof_joint_state=BASE_STATE)),
    "a model id of another robot": ("fixed", "model_id", _around(model_id="panda")),
    "a planner that failed": ("fixed", "error code -4", _around(error_code={"val": -4})),
    "a plan that is no success": ("fixed", "success", _around(success=False)),
    "another start": ("fixed", "trajectory_start has elbow", _start({"elbow": 1.3})),
    "another start of a joint that the robot lacks": ("fixed", "lacks", _start({"hip": 0.3})),
    "something carried": (
        "fixed",
        "carries 'ladder'",
        _start({}, attached_collision_objects=[{"object": {"id": "ladder"}}]),
    ),
    "a second trajectory beside the first": ("fixed", "not read", _around(solution={"joint_names": ["elbow"]})),
    "efforts that the motors lack": ("fixed", "effort", _point_field(effort=[9e9] * 5)),
    "limits of its own": ("fixed", "not read", _point_field(velocity_limits=[9e9] * 5)),
    "all in degrees": ("fixed", "yaw starts at -51", _scale(positions=DEG, velocities=DEG, accelerations=DEG)),
    "velocities in degrees": ("fixed", "of its speed limit", _scale(velocities=DEG)),
    "accelerations in degrees": ("fixed", "of its acceleration limit", _scale(accelerations=DEG)),
    "velocities the other way": ("fixed", "of its acceleration limit", _scale(velocities=-1.0)),
    "names of two joints exchanged": ("fixed", "yaw starts at", _exchange_names),
    "times in milliseconds": ("fixed", "milliseconds", _times(lambda t: 1e3 * t, 1e3)),
    "times in microseconds": ("fixed", "microseconds", _times(lambda t: 1e6 * t, 1e6)),
    "times divided by 1000": ("fixed", "in another unit", _times(lambda t: 1e-3 * t, 1e-3)),
    "all times equal": ("fixed", "expected times that increase", _times(lambda t: 2.0)),
    "all times 0": ("fixed", "no times", _times(lambda t: 0.0)),
    "times of the clock": ("fixed", "times of the clock", _times(lambda t: 1.7e9 + t)),
    "a finger that moves the other way": ("fingers", "which it follows", _finger(lambda f: f)),
    "a finger that lags by 2 mm": ("fingers", "which it follows", _finger(lambda f: -0.9 * f)),
    "a finger without the one it follows": ("fingers", "which it follows", _finger(lambda f: -f, has_leader=False)),
}
HONEST: dict[str, tuple[str, str, Change]] = {
    "as it was planned": ("fixed", "auto", lambda message: message),
    "as a DisplayTrajectory": ("fixed", "auto", _start({})),
    "30 times slower": ("fixed", "auto", _times(lambda t: 30.0 * t, 30.0)),
    "a base that stays": ("fixed", "auto", _move_base((0.0, 0.0, 0.0))),
    "a base that stays, by name": ("planar", "auto", _move_base((0.0, 0.0, 0.0))),
    "a base that moves away from the post": ("planar", "spline", _move_base((-0.2, 0.0, 0.0))),
    "a finger that follows": ("fingers", "spline", _finger(lambda f: -f)),
    "a message in a copy": ("fixed", "auto", copy.deepcopy),
}
