"""Verdict on a simulated plan: whether the robot stood, and slip, forces, errors and angles against the plan's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from costs.robot import RobotModel
from service.execution.guards import GuardSettings
from service.execution.reference import PlannedReference, ReferencePhase
from service.result.motion_json import file_columns, file_positions
from service.simulation.run import Execution, Record
from service.verify import PoseTarget
from service.verify.polygons import outside_polygon
from service.verify.timeline import list_phases

FORMAT = "scopt-simulation/1"
STOOD, FELL = "STOOD", "FELL"
FILTER_SAMPLES = 3  # samples of 20 ms whose mean is a force's value
SATURATED = 0.999  # share of the effort limit that counts as saturation
SLIP_M = 0.02  # from which a slip is named [m]
TOUCH_N = 20.0  # from which an unplanned touch is named [N]
LONG_S = 0.05  # for which a torque has to be saturated to be named [s]
BEFORE_FALL_S = 3.0  # in which the cause of a fall is looked for
EARLIER_S = 0.5  # before a fall without an unusual event, when the centre of mass is reported
LEAST_SHARE = 0.9  # of a mechanism's planned travel; less is named
LEAST_TRAVEL = 1e-3  # of a mechanism's joint that counts as moved [rad, m]
ABORT_AFTER_S = GuardSettings().hold_s  # above its threshold a hand's force aborts an execution [s]
TRACK_PERIOD_S = 0.02


def make_report(execution: Execution) -> dict[str, Any]:
    """Return what ``simulation.json`` holds (docs/simulation.md)."""
    reference, record = execution.reference, execution.record
    frames = _Frames(reference, record, [*_list_planted(reference), *_list_hands(reference)])
    phases = [_report_phase(execution, phase) for phase in reference.phases]
    slips = _measure_slips(reference, record, frames)
    hands = _report_hands(execution, frames)
    saturation = _list_saturation(execution)
    mechanism = _report_mechanism(execution)
    touches = _list_touches(execution)
    cause = None if record.fell_at_s is None else _find_cause(execution, frames, slips, saturation, touches)
    report: dict[str, Any] = {
        "format": FORMAT,
        "verdict": STOOD if record.fell_at_s is None else FELL,
        "explanation": [] if cause is None else [cause],
        "notes": [],
        "plan": {
            "verdict": execution.verdict,
            "request_hash": execution.request_hash,
            "duration_s": reference.duration_s,
        },
        "options": asdict(execution.options),
        "servo": {
            "stiffness": dict(zip(execution.model.joint_names, execution.model.stiffness.tolist(), strict=True)),
            "damping": dict(zip(execution.model.joint_names, execution.model.damping.tolist(), strict=True)),
        },
        "fell_at_s": record.fell_at_s,
        "computing_s": record.computing_s,
        "times_real_time": float(record.times[-1] - record.times[0]) / max(record.computing_s, 1e-9),
        "phases": phases,
        "slip": [
            {"link": link, "worst_m": float(slip.max()), "at_s": float(times[slip.argmax()])}
            for link, (times, slip) in slips.items()
        ],
        "hands": hands,
        "joint_error": _report_joint_error(execution),
        "saturation": saturation,
        "touches": touches,
        "mechanism": mechanism,
        "balance": _report_balance(execution, frames),
        "track": _write_track(execution),
    }
    report["notes"] = list(_write_notes(report))
    return report


class _Frames:
    """Poses of frames and the centre of mass along the record, simulated and planned."""

    def __init__(self, reference: PlannedReference, record: Record, names: Iterable[str]) -> None:
        model: pin.Model = reference.robot.model
        self._index = {name: k for k, name in enumerate(dict.fromkeys(names))}
        frames = [model.getFrameId(name) for name in self._index]
        self._poses = np.zeros((2, len(record.times), len(frames), 4, 4))
        self._com = np.zeros((2, len(record.times), 3))
        data = model.createData()
        for k, table in enumerate((record.configuration, record.planned)):
            for i, q in enumerate(table):
                self._com[k, i] = pin.centerOfMass(model, data, q, False)
                for j, frame in enumerate(frames):
                    self._poses[k, i, j] = pin.updateFramePlacement(model, data, frame).homogeneous

    def place(self, frame: str, planned: bool = False) -> Float[np.ndarray, "S 4 4"]:
        """Return the poses of a frame."""
        return np.asarray(self._poses[int(planned), :, self._index[frame]])

    def locate(self, frame: str, planned: bool = False) -> Float[np.ndarray, "S 3"]:
        """Return the origins of a frame [m]."""
        return self.place(frame, planned)[:, :3, 3]

    def com(self, planned: bool = False) -> Float[np.ndarray, "S 3"]:
        """Return the centres of mass [m]."""
        return np.asarray(self._com[int(planned)])


def _list_planted(reference: PlannedReference) -> list[str]:
    """Return the links that the plan plants in any phase."""
    return list(dict.fromkeys(contact.link for phase in reference.phases for contact in phase.contacts))


def _list_hands(reference: PlannedReference) -> list[str]:
    """Return the frames whose errors are reported: tools that press, frames with a target, hands."""
    robot = reference.robot
    names = dict.fromkeys(load.tool for phase in reference.phases for load in phase.loads)
    for phase in list_phases(reference.motion):
        names |= dict.fromkeys(target.frame for target in phase.targets if isinstance(target, PoseTarget))
    names |= dict.fromkeys(robot.link_groups.get("hands", ()))
    return [name for name in names if robot.model.existFrame(name)]


def _rows(record: Record, phase: ReferencePhase) -> np.ndarray:
    """Return the samples of a phase."""
    return np.flatnonzero((record.times >= phase.begin_s - 1e-9) & (record.times <= phase.end_s + 1e-9))


def _smooth(values: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the mean of neighbouring samples, which leaves out the impacts of a single instant."""
    width = min(FILTER_SAMPLES, len(values))
    return np.convolve(values, np.ones(width) / width, mode="same") if len(values) else values


def find_longest_stretch(times: Float[np.ndarray, "S"], is_over: Bool[np.ndarray, "S"]) -> float:
    """Return the longest time for which something holds without interruption, from sample to sample [s]."""
    longest, began = 0.0, None
    for time_s, over in zip(times.tolist(), is_over.tolist(), strict=True):
        began = (time_s if began is None else began) if over else None
        longest = max(longest, 0.0 if began is None else time_s - began)
    return longest


def _report_phase(execution: Execution, phase: ReferencePhase) -> dict[str, Any]:
    record, reference = execution.record, execution.reference
    rows = _rows(record, phase)
    ground = np.sum([wrench[:, 2] for wrench in record.wrenches.values()], axis=0) if record.wrenches else None
    loads = []
    for load in phase.loads:
        force = measure_hand_force(reference.robot, record, load.tool)[rows]
        exceeded = find_longest_stretch(record.times[rows], force > load.abort_n)
        loads.append(
            {
                "tool": load.tool,
                "links": list(load.links),
                "expected_n": load.expected_n,
                "cap_n": load.cap_n,
                "abort_n": load.abort_n,
                "peak_n": float(force.max(initial=0.0)),
                "exceeded_s": exceeded,
                "is_exceeded": exceeded > ABORT_AFTER_S,
            }
        )
    error = np.abs(record.configuration - record.planned)[np.ix_(rows, reference.joint_columns)]
    return {
        "name": phase.name,
        "begin_s": phase.begin_s,
        "end_s": phase.end_s,
        "is_reached": bool(len(rows)),
        "contacts": [contact.link for contact in phase.contacts],
        "ground_peak_n": None if ground is None or not len(rows) else float(_smooth(ground)[rows].max()),
        "loads": loads,
        "joint_error": float(error.max()) if error.size else 0.0,
    }


def measure_hand_force(robot: RobotModel, record: Record, tool: str) -> Float[np.ndarray, "S"]:
    """Return the size of the force of hand, rod and fingers of a tool on the mechanism, mean of 60 ms [N]."""
    model: pin.Model = robot.model
    carrier = int(model.frames[model.getFrameId(tool)].parentJoint)
    total = np.zeros((len(record.times), 3))
    for (frame, _), force in record.mechanism_force.items():
        if carrier in list(model.supports[model.frames[model.getFrameId(frame)].parentJoint]):
            total += force
    return np.asarray(np.linalg.norm([_smooth(column) for column in total.T], axis=0))


def _measure_slips(
    reference: PlannedReference, record: Record, frames: _Frames
) -> dict[str, tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"]]]:
    """Return per planted link times and distances along the ground from where it was planted [s, m].

    Measured at the middle of its contact points, from a fifth of a second after it came.
    """
    slips: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for link in _list_planted(reference):
        poses = frames.place(link)
        times, distances = [], []
        rows: list[int] = []
        for k, phase in enumerate(reference.phases):
            contact = next((c for c in phase.contacts if c.link == link), None)
            if contact is not None:
                rows += [row for row in _rows(record, phase).tolist() if not rows or row > rows[-1]]
                after = reference.phases[k + 1].contacts if k + 1 < len(reference.phases) else ()
                if any(c.link == link for c in after):
                    continue
                held = [row for row in rows if record.times[row] >= record.times[rows[0]] + 0.2] or rows
                middle = contact.sole.mean(axis=0)
                at = poses[held][:, :3, :3] @ middle + poses[held][:, :3, 3]
                normal = contact.pose_world_link[:3, 2] if contact.normal is None else contact.normal
                moved = at - at[:1] if len(at) else at
                along = moved - (moved @ normal)[:, None] * normal
                times.append(record.times[held])
                distances.append(np.linalg.norm(along, axis=1))
            rows = []
        if times and sum(len(part) for part in times):
            slips[link] = (np.concatenate(times), np.concatenate(distances))
    return slips


def _report_hands(execution: Execution, frames: _Frames) -> list[dict[str, Any]]:
    """Return the distance of each tool and hand from its planned place."""
    reference, record = execution.reference, execution.record
    rows = np.flatnonzero((record.times >= 0.0) & (record.times <= reference.duration_s + 1e-9))
    if record.fell_at_s is not None:
        rows = rows[record.times[rows] < record.fell_at_s]
    hands = []
    for name in _list_hands(reference) if len(rows) else ():
        error = np.linalg.norm(frames.locate(name) - frames.locate(name, True), axis=1)
        worst = int(rows[error[rows].argmax()])
        hands.append(
            {
                "frame": name,
                "worst_m": float(error[worst]),
                "at_s": float(record.times[worst]),
                "end_m": float(error[rows[-1]]),
            }
        )
    return hands


def _report_joint_error(execution: Execution) -> dict[str, Any]:
    reference, record = execution.reference, execution.record
    error = np.abs(record.configuration - record.planned)[:, reference.joint_columns]
    row, column = np.unravel_index(int(error.argmax()), error.shape)
    return {
        "joint": reference.joint_names[column],
        "worst": float(error[row, column]),
        "at_s": float(record.times[row]),
    }


def _list_saturation(execution: Execution) -> list[dict[str, Any]]:
    """Return the joints whose torque was at its limit, the longest first."""
    record, names = execution.record, execution.reference.joint_names
    step = float(record.times[1] - record.times[0]) if len(record.times) > 1 else 0.0
    saturated = np.abs(record.torque_share) >= SATURATED
    joints = []
    for column in np.flatnonzero(saturated.any(axis=0)).tolist():
        rows = np.flatnonzero(saturated[:, column])
        joints.append({"joint": names[column], "seconds": step * len(rows), "first_s": float(record.times[rows[0]])})
    return sorted(joints, key=lambda joint: -float(str(joint["seconds"])))


def _report_mechanism(execution: Execution) -> list[dict[str, Any]]:
    """Return how far each joint of the mechanism moved, at most in the planned sense, against the plan."""
    reference, record = execution.reference, execution.record
    n = reference.robot.n
    moved = []
    for k, name in enumerate(reference.mechanism_names):
        column = n - len(reference.mechanism_names) + k
        planned, true = record.planned[:, column], record.configuration[:, column]
        travel = planned - planned[0]
        farthest = int(np.abs(travel).argmax())
        if abs(travel[farthest]) < LEAST_TRAVEL:
            continue
        sense = float(np.sign(travel[farthest]))
        reached = float((sense * (true - true[0])).max())
        joint = reference.robot.model.joints[reference.robot.model.getJointId(name)]
        moved.append(
            {
                "joint": name,
                "unit": "m" if "Prismatic" in joint.shortname() else "rad",
                "planned": float(travel[farthest]),
                "reached": sense * reached,
                "share": reached / abs(float(travel[farthest])),
                "planned_end": float(planned[-1]),
                "end": float(true[-1]),
            }
        )
    return moved


def _list_touches(execution: Execution) -> list[dict[str, Any]]:
    """Return forces between the robot and what the plan lets it not touch, the strongest first."""
    reference, record = execution.reference, execution.record
    planned = list_phases(reference.motion)
    allowed: list[set[tuple[str, str]]] = []
    for phase in planned:
        pairs = set()
        for allowance in phase.allowances:
            a, b = allowance.first, allowance.second
            pairs |= {
                (a.link or a.body or "", b.link or b.body or ""),
                (b.link or b.body or "", a.link or a.body or ""),
            }
            pairs |= {(a.link or "", b.body or ""), (b.link or "", a.body or "")}
        allowed.append(pairs)
    touches = []
    for (link, other), force in record.touches.items():
        smooth = _smooth(force)
        rows = []
        for k, (span, pairs) in enumerate(zip(reference.phases, allowed, strict=True)):
            near = planned[max(k - 1, 0) : k + 2]  # a foot lands before its contact begins
            if any(contact.link == link for phase in near for contact in phase.contacts) or (link, other) in pairs:
                continue
            rows += _rows(record, span).tolist()
        strong = [row for row in rows if smooth[row] > TOUCH_N]
        if strong:
            touches.append(
                {
                    "link": link,
                    "other": other,
                    "peak_n": float(smooth[strong].max()),
                    "first_s": float(record.times[min(strong)]),
                }
            )
    return sorted(touches, key=lambda touch: -float(str(touch["peak_n"])))


def _report_balance(execution: Execution, frames: _Frames) -> dict[str, Any]:
    """Return the smallest distance of the centre of mass inside the feet, planned and simulated, on level soles [m]."""
    reference, record = execution.reference, execution.record
    planned, true, worst = np.inf, np.inf, None
    com, wanted = frames.com(), frames.com(True)
    for phase, span in zip(list_phases(reference.motion), reference.phases, strict=True):
        rows = _rows(record, span)
        if phase.support is None or not len(rows):
            continue
        inside = -outside_polygon(phase.support.polygon, com[rows][:, :2])
        planned = min(planned, float(-outside_polygon(phase.support.polygon, wanted[rows][:, :2]).max()))
        if float(inside.min()) < true:
            true, worst = float(inside.min()), float(record.times[rows[int(inside.argmin())]])
    shift = np.linalg.norm((com - wanted)[:, :2], axis=1)
    rows = np.flatnonzero(record.times >= 0.0)
    if record.fell_at_s is not None:
        rows = rows[record.times[rows] < record.fell_at_s]
    return {
        "planned_margin_m": None if np.isinf(planned) else planned,
        "margin_m": None if np.isinf(true) else true,
        "at_s": worst,
        "com_shift_m": float(shift[rows].max(initial=0.0)),
    }


def _find_cause(
    execution: Execution,
    frames: _Frames,
    slips: Mapping[str, tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"]]],
    saturation: list[dict[str, Any]],
    touches: list[dict[str, Any]],
) -> str:
    """Return a sentence on the fall: when, in which phase, and the first unusual event before it."""
    reference, record = execution.reference, execution.record
    fell = record.fell_at_s or 0.0
    phase = reference.find_phase(fell).name
    events: list[tuple[float, str]] = []
    for joint in saturation:
        if joint["seconds"] >= LONG_S and joint["first_s"] < fell:
            events.append((joint["first_s"], f"{joint['joint']} reached its torque limit"))
    for link, (times, slip) in slips.items():
        rows = np.flatnonzero((slip > SLIP_M) & (times < fell))
        if len(rows):
            events.append((float(times[rows[0]]), f"{link} slipped by more than {1e3 * SLIP_M:.0f} mm"))
    for touch in touches:
        if touch["first_s"] < fell:
            events.append((touch["first_s"], f"{touch['link']} pressed {touch['other']}"))
    for span in reference.phases:
        rows = _rows(record, span)
        for load in span.loads:
            force = measure_hand_force(reference.robot, record, load.tool)
            high = [row for row in rows.tolist() if force[row] > load.abort_n and record.times[row] < fell]
            if high:
                events.append((float(record.times[high[0]]), f"the force of {load.tool} passed {load.abort_n:.0f} N"))
    recent = sorted(event for event in events if event[0] > fell - BEFORE_FALL_S)
    words = f"fell at {fell:.2f} s in phase '{phase}'"
    if not recent:
        earlier = int(np.abs(record.times - (fell - EARLIER_S)).argmin())
        off = 1e3 * float(np.linalg.norm((frames.com() - frames.com(True))[earlier, :2]))
        return f"{words}; {EARLIER_S:g} s before, the centre of mass was {off:.0f} mm off the plan"
    return f"{words}; before that, at {recent[0][0]:.2f} s, {recent[0][1]}"


def _write_track(execution: Execution) -> dict[str, Any]:
    """Return the simulated motion in the columns of a trajectory, and the ground's force, planned and simulated."""
    reference, record = execution.reference, execution.record
    rows = np.flatnonzero((record.times >= -1e-9) & (record.times <= reference.duration_s + execution.options.after_s))
    step = max(round(TRACK_PERIOD_S / max(float(record.times[1] - record.times[0]), 1e-9)), 1)
    rows = rows[::step]
    n_own = reference.robot.n - len(reference.mechanism_names)
    robot = reference.robot
    columns = file_columns(robot)[: n_own + 1] if robot.is_floating else file_columns(robot)[:n_own]
    positions = file_positions(robot, record.configuration[rows])
    zero = np.zeros((len(record.times), 6))
    return {
        "joint_names": list(columns),
        "times": np.round(record.times[rows], 6).tolist(),
        "positions": np.round(positions[:, : len(columns)], 6).tolist(),
        "movables": {
            name: np.round(record.configuration[rows, n_own + k], 6).tolist()
            for k, name in enumerate(reference.mechanism_names)
        },
        "ground_n": {link: np.round(_column(wrench, rows), 2).tolist() for link, wrench in record.wrenches.items()},
        "planned_ground_n": {
            link: np.round(_column(record.planned_wrenches.get(link, zero), rows), 2).tolist()
            for link in record.wrenches
        },
    }


def _column(wrench: Float[np.ndarray, "S 6"], rows: np.ndarray) -> Float[np.ndarray, "R"]:
    return np.asarray(np.linalg.norm(wrench[:, :3], axis=1)[rows])


def _write_notes(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences on what a person should know of a simulation; after a fall only of what was moved."""
    for joint in report["mechanism"]:
        if joint["share"] < LEAST_SHARE:
            yield f"{joint['joint']} moved {100.0 * joint['share']:.0f} % of its planned travel"
    if report["fell_at_s"] is not None:
        return
    for phase in report["phases"]:
        for load in phase["loads"]:
            if load["is_exceeded"]:
                yield (
                    f"{load['tool']} pressed {' and '.join(load['links'])} in phase '{phase['name']}' with up to "
                    f"{load['peak_n']:.0f} N, for {load['exceeded_s']:.2f} s with more than {load['abort_n']:.0f} N, "
                    f"at which an executor stops; the plan expects {load['expected_n']:.0f} N"
                )
    for slip in report["slip"]:
        if slip["worst_m"] > SLIP_M:
            yield f"{slip['link']} slipped by {1e3 * slip['worst_m']:.0f} mm"
    for joint in report["saturation"]:
        if joint["seconds"] >= LONG_S:
            yield f"{joint['joint']} was at its torque limit for {joint['seconds']:.2f} s"
    for touch in report["touches"]:
        yield f"{touch['link']} pressed {touch['other']} with {touch['peak_n']:.0f} N, which the plan keeps apart"
