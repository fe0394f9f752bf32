"""Trajectories in messages of ROS and MoveIt and in the data of other planners, once they are mappings and lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from costs.robot import BASE_NAMES
from service.errors import RequestError, shown
from service.replay.exchange.base_motion import BaseMotion, check_times, read_base_motion
from service.replay.exchange.fields import (
    MAX_DEPTH,
    TakenFields,
    is_blank,
    note_rest,
    read_stamps,
    stack_rows,
    to_number,
)
from service.replay.exchange.joint_trajectory import LONGEST_S, MAX_JOINTS, MAX_POINTS, JointTrajectory
from service.replay.exchange.start_state import StartState, read_start_state
from service.result.motion_json import BASE_COLUMNS

NAMES = ("joint_names", "names", "name", "joints")
TIMES = ("times", "time", "time_from_start", "timestamps")
FIELDS = {
    "positions": ("positions", "position", "q"),
    "velocities": ("velocities", "velocity", "qd", "v"),
    "accelerations": ("accelerations", "acceleration", "qdd", "a"),
}
STEPS = ("dt", "interpolation_dt", "time_step")
# Keys under which messages and results of other planners hold the trajectory itself.
NESTED = ("joint_trajectory", "trajectory", "interpolated_plan", "planned_trajectory", "solution", "result")
SEVERAL = ("multi_dof_joint_trajectory", "multi_dof_trajectory")
SUCCESS = 1  # of MoveIt's error codes
EFFORT = "effort"


@dataclass
class _Around:
    """What stands around the points: the base, the state at the start, the robot's name, and fields read past."""

    source: str
    base: BaseMotion | None = None
    start: StartState | None = None
    model_id: str = ""
    notes: list[str] = field(default_factory=list)
    rest: list[str] = field(default_factory=list)

    def read(self, fields: TakenFields) -> None:
        """Take what belongs to the trajectory from a mapping around it."""
        base = read_base_motion(fields.take(*SEVERAL), self.source)
        start = read_start_state(fields.take("trajectory_start", "start_state"), self.source)
        self.base, self.start = base or self.base, start or self.start
        self.model_id = str(fields.take("model_id") or self.model_id)
        code, success = fields.take("error_code"), fields.take("success")
        value = code.get("val") if isinstance(code, Mapping) else code
        if value is not None and value not in (0, SUCCESS):
            self.notes.append(f"its planner reports the error code {shown(value)}")
        if success is not None and is_blank(success):
            self.notes.append(f"its planner reports success: {shown(success)}")

    def finish(self, trajectory: JointTrajectory) -> JointTrajectory:
        """Return the trajectory with the base and the notes."""
        if self.base is not None:
            trajectory = add_base(trajectory, self.base)
        own = (*trajectory.notes, *self.notes, *(() if self.start is None else self.start.notes), *note_rest(self.rest))
        return replace(trajectory, model_id=self.model_id, start=self.start, notes=own)


def parse_trajectory(data: object, source: str) -> JointTrajectory:
    """Make a trajectory of a message (JointTrajectory, RobotTrajectory, DisplayTrajectory), of columns, or of states.

    Every field is used, or a note of the trajectory names it.

    Raises:
        RequestError: the data hold no trajectory, or several.
    """
    body, around, depth = data, _Around(source), 0
    while True:
        depth += 1
        if depth > MAX_DEPTH:
            raise RequestError(f"{source}: holds no trajectory")
        if isinstance(body, list | tuple) and len(body) == 1 and not _is_state(body[0]):
            body = body[0]
        elif isinstance(body, list | tuple) and body and all(_is_state(entry) for entry in body):
            return around.finish(_read_states(body, around))
        elif isinstance(body, list | tuple):
            raise RequestError(f"{source}: holds {len(body)} trajectories; expected one")
        elif not isinstance(body, Mapping):
            raise RequestError(f"{source}: holds no trajectory; expected joint_names and points, got {shown(body)}")
        elif "points" in body:
            return around.finish(_read_points(body, around))
        elif any(key in body for key in FIELDS["positions"]):
            return around.finish(_read_columns(body, around))
        else:
            body = _enter(body, around)


def _enter(body: Mapping[str, Any], around: _Around) -> object:
    """Return what a mapping around the trajectory holds as the trajectory."""
    inner = [key for key in NESTED if key in body]
    several = [key for key in SEVERAL if not is_blank(body.get(key))]
    if not inner and not several:
        raise RequestError(
            f"{around.source}: holds no trajectory; expected joint_names with points, or with positions and times, "
            f"got the keys {shown(sorted(map(str, body)))}"
        )
    fields = TakenFields(body)
    around.read(fields)
    fields.skip(*inner[:1])
    around.rest += fields.list_rest()
    found = body[inner[0]] if inner else {}
    if around.base is not None and isinstance(found, Mapping) and not found.get("points"):
        return {"joint_names": [], "points": []}  # the base alone moves
    return found


def add_base(trajectory: JointTrajectory, base: BaseMotion) -> JointTrajectory:
    """Return a trajectory with the columns of a base's motion.

    Where the base moves and its planner gives no velocities, those of the joints are left out, too: a controller could
    not follow both.
    """
    source, names = trajectory.source, trajectory.joint_names
    if names == BASE_COLUMNS:
        return replace(trajectory, notes=(*trajectory.notes, *base.notes))
    if set(names) & set(BASE_COLUMNS):
        raise RequestError(f"{source}: gives the base twice, as columns base_x ... and as {shown(base.name)}")
    check_times(base, len(trajectory.positions), trajectory.times, source)
    velocities, accelerations, notes = trajectory.velocities, trajectory.accelerations, list(base.notes)
    if velocities is not None and base.rates is None:
        notes.append(
            f"{shown(base.name)} moves and has no velocities: those of the joints are not used; give both, or certify "
            "the spline through the points (--interpolation spline)"
        )
        velocities = accelerations = None
    if velocities is None and base.rates is not None and not base.is_still:
        notes.append(f"velocities of {shown(base.name)} are not used, since those of the joints are not known")
    if accelerations is not None and not base.is_still:
        notes.append(f"accelerations are not used, since those of {shown(base.name)} are not known")
        accelerations = None
    still = np.zeros((len(base.poses), len(BASE_NAMES)))
    return JointTrajectory(
        (*BASE_COLUMNS, *names),
        trajectory.times,
        np.hstack([base.poses, trajectory.positions]),
        None if velocities is None or base.rates is None else np.hstack([base.rates, velocities]),
        None if accelerations is None else np.hstack([still, accelerations]),
        rate_names=(*BASE_NAMES, *trajectory.columns_of_rates),
        source=source,
        notes=(*trajectory.notes, *notes),
    )


def _is_state(entry: object) -> bool:
    return (
        isinstance(entry, Mapping)
        and any(key in entry for key in FIELDS["positions"])
        and TakenFields(entry).take(*NAMES) is not None
    )


def _read_points(body: Mapping[str, Any], around: _Around) -> JointTrajectory:
    """Read a JointTrajectory message, as ``ros2 topic echo`` prints it."""
    source, fields = around.source, TakenFields(body)
    points, names = body["points"], fields.take(*NAMES)
    fields.skip("points")
    if not isinstance(points, list | tuple) or not all(isinstance(point, Mapping) for point in points):
        raise RequestError(f"{source}: points must be a list of mappings, got {shown(points)}")
    if len(points) > MAX_POINTS:
        raise RequestError(f"{source}: has {len(points)} points; expected 2 to {MAX_POINTS}")
    around.read(fields)
    if around.base is not None and not points:
        return _make_base_alone(around.base, source)
    names = _check_names(names, source)
    rows = [TakenFields(point) for point in points]
    columns = {
        kind: stack_rows([row.take(*keys) for row in rows], len(names), kind, source) for kind, keys in FIELDS.items()
    }
    stamps = read_stamps([row.take(*TIMES) for row in rows], source)
    _note_points(rows, around)
    _note_header(fields.take("header"), around)
    around.rest += fields.list_rest()
    return _build(names, stamps, columns, around)


def _make_base_alone(base: BaseMotion, source: str) -> JointTrajectory:
    names = BASE_NAMES if base.rates is not None else ()
    return JointTrajectory(BASE_COLUMNS, base.times, base.poses, base.rates, rate_names=names, source=source)


def _read_states(states: Sequence[Mapping[str, Any]], around: _Around) -> JointTrajectory:
    """Read a list of states (Tesseract), each of which names its joints, in any order."""
    source = around.source
    if len(states) > MAX_POINTS:
        raise RequestError(f"{source}: has {len(states)} points; expected 2 to {MAX_POINTS}")
    rows = [TakenFields(state) for state in states]
    names = _check_names(rows[0].take(*NAMES), source)
    columns: dict[str, list[Any]] = {kind: [] for kind in FIELDS}
    for number, row in enumerate(rows):
        own = _check_names(row.take(*NAMES), source)
        if sorted(own) != sorted(names):
            other = sorted(set(own) ^ set(names))
            raise RequestError(
                f"{source}: state {number} has other joints than the first: {shown(other[0] if other else own)}"
            )
        order = [own.index(name) for name in names]
        for kind, keys in FIELDS.items():
            values = row.take(*keys)
            is_row = isinstance(values, list | tuple) and len(values) == len(own)
            columns[kind].append([values[k] for k in order] if is_row else values)
    stacked = {kind: stack_rows(lines, len(names), kind, source) for kind, lines in columns.items()}
    stamps = read_stamps([row.take(*TIMES) for row in rows], source)
    _note_points(rows, around)
    return _build(names, stamps, stacked, around)


def _read_columns(body: Mapping[str, Any], around: _Around) -> JointTrajectory:
    """Read columns: joint_names, times (or a step ``dt``), positions, and perhaps velocities and accelerations."""
    source, fields = around.source, TakenFields(body)
    around.read(fields)
    names = _check_names(fields.take(*NAMES), source)
    columns = {}
    for kind, keys in FIELDS.items():
        rows = fields.take(*keys)
        if rows is not None and not isinstance(rows, list | tuple | np.ndarray):
            raise RequestError(f"{source}: {kind} must be one list per point, got {shown(rows)}")
        columns[kind] = None if rows is None else stack_rows(list(rows), len(names), kind, source)
    times = fields.take(*TIMES)
    stamps: np.ndarray | None = None
    if times is not None:
        stamps = read_stamps(list(times) if isinstance(times, list | tuple | np.ndarray) else [times], source)
    elif (step := fields.take(*STEPS)) is not None:
        value = to_number(step, "dt", source)
        if not 0.0 < value <= LONGEST_S:
            raise RequestError(f"{source}: dt is {value:g}; expected a step of more than 0 s")
        count = 0 if columns["positions"] is None else len(columns["positions"])
        stamps = value * np.arange(count)
    around.rest += fields.list_rest()
    return _build(names, stamps, columns, around)


def _note_points(rows: Sequence[TakenFields], around: _Around) -> None:
    """Note fields of the points that are read past."""
    rest = list(dict.fromkeys(key for row in rows for key in row.list_rest()))
    if EFFORT in rest:
        around.notes.append("effort of the points is not compared; torques are computed from the motion")
    around.rest += [f"points[].{key}" for key in rest if key != EFFORT]


def _note_header(header: object, around: _Around) -> None:
    """Note a stamp; frame and sequence number have no meaning for positions of joints."""
    if isinstance(header, Mapping):
        fields = TakenFields(header)
        fields.skip("frame_id", "seq")
        around.rest += [f"header.{key}" for key in fields.list_rest()]


def _build(
    names: tuple[str, ...], times: np.ndarray | None, columns: Mapping[str, np.ndarray | None], around: _Around
) -> JointTrajectory:
    source, positions = around.source, columns["positions"]
    if positions is None:
        raise RequestError(f"{source}: has no positions")
    if times is not None and len(times) > 1 and not np.any(times):
        around.notes.append("all points are at 0 s: read as a path without times")
        times = None
    return JointTrajectory(names, times, positions, columns["velocities"], columns["accelerations"], source=source)


def _check_names(names: object, source: str) -> tuple[str, ...]:
    names = () if names is None else names
    if isinstance(names, np.ndarray):
        names = names.tolist()
    if not isinstance(names, list | tuple) or not names or not all(isinstance(name, str) for name in names):
        raise RequestError(f"{source}: joint_names must be a list of texts, got {shown(names)}")
    if len(names) > MAX_JOINTS:
        raise RequestError(f"{source}: has {len(names)} joints; expected at most {MAX_JOINTS}")
    return tuple(names)
