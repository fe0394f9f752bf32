"""Report on a simulated plan: its verdict, and slip, forces, errors and travel against the plan's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from service.execution.guards import GuardSettings
from service.execution.reference import PlannedReference, ReferencePhase
from service.replay.simulation_claims import FORMAT, WORSE
from service.result.motion_json import file_columns, file_positions
from service.simulation.cause import LONG_S, SLIP_M, find_cause
from service.simulation.measures import Frames, list_planted, list_rows, measure_hand_force, measure_slips, smooth
from service.simulation.run import SimulatedRun
from service.simulation.verdict import judge, list_goal_frames, measure_objects
from service.verify import list_phases, outside_polygon

SATURATED = 0.999  # share of the effort limit that counts as saturation
TOUCH_N = 20.0  # from which an unplanned touch is named [N]
ABORT_AFTER_S = GuardSettings().hold_s  # above its threshold a hand's force aborts an execution [s]
TRACK_PERIOD_S = 0.02


def make_report(executions: Sequence[SimulatedRun]) -> tuple[dict[str, Any], SimulatedRun]:
    """Return what ``simulation.json`` holds (docs/simulation.md), and the run that it shows: the worst one.

    Args:
        executions: of one plan, one per friction of the hands.
    """
    made = [_report_run(execution) for execution in executions]
    worst = max(range(len(made)), key=lambda k: WORSE.index(made[k]["verdict"]))  # the first of equals
    if len(made) > 1:
        for report in made:
            friction = report["options"]["hand_friction"]
            report["explanation"] = [f"hand friction {friction:g}: {line}" for line in report["explanation"]]
    runs = [
        {
            "hand_friction": report["options"]["hand_friction"],
            **{key: report[key] for key in ("verdict", "explanation", "fell_at_s", "mechanism")},
        }
        for report in made
    ]
    return {**made[worst], "runs": runs}, executions[worst]


def _report_run(execution: SimulatedRun) -> dict[str, Any]:
    """Return the report on one run."""
    reference, record = execution.reference, execution.record
    frames = Frames(reference, record, [*list_planted(reference), *_list_hands(reference)])
    phases = [_report_phase(execution, phase) for phase in reference.phases]
    slips = measure_slips(reference, record, frames)
    hands = _report_hands(execution, frames)
    saturation = _list_saturation(execution)
    judged = judge(reference, record, execution.model.physics)
    touches = _list_touches(execution)
    explanation = list(judged.reasons)
    if record.fell_at_s is not None:
        explanation.insert(0, find_cause(execution, frames, slips, saturation, touches))
    report: dict[str, Any] = {
        "format": FORMAT,
        "verdict": judged.verdict,
        "explanation": explanation,
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
        "mechanism": [move.to_json() for move in judged.moves],
        "objects": [asdict(end) for end in measure_objects(reference, record)],
        "balance": _report_balance(execution, frames),
        "track": _write_track(execution),
    }
    report["notes"] = list(_write_notes(report))
    return report


def _list_hands(reference: PlannedReference) -> list[str]:
    """Return the frames whose errors are reported: tools that press, frames with a target, hands."""
    names = dict.fromkeys(load.tool for phase in reference.phases for load in phase.loads)
    names |= dict.fromkeys(list_goal_frames(reference.motion))
    return [name for name in names if reference.robot.model.existFrame(name)]


def find_longest_stretch(times: Float[np.ndarray, "S"], is_over: Bool[np.ndarray, "S"]) -> float:
    """Return the longest time for which something holds without interruption, from sample to sample [s]."""
    longest, began = 0.0, None
    for time_s, over in zip(times.tolist(), is_over.tolist(), strict=True):
        began = (time_s if began is None else began) if over else None
        longest = max(longest, 0.0 if began is None else time_s - began)
    return longest


def _report_phase(execution: SimulatedRun, phase: ReferencePhase) -> dict[str, Any]:
    record, reference = execution.record, execution.reference
    rows = list_rows(record, phase)
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
        "ground_peak_n": None if ground is None or not len(rows) else float(smooth(ground)[rows].max()),
        "loads": loads,
        "joint_error": float(error.max()) if error.size else 0.0,
    }


def _report_hands(execution: SimulatedRun, frames: Frames) -> list[dict[str, Any]]:
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


def _report_joint_error(execution: SimulatedRun) -> dict[str, Any]:
    reference, record = execution.reference, execution.record
    error = np.abs(record.configuration - record.planned)[:, reference.joint_columns]
    row, column = np.unravel_index(int(error.argmax()), error.shape)
    return {
        "joint": reference.joint_names[column],
        "worst": float(error[row, column]),
        "at_s": float(record.times[row]),
    }


def _list_saturation(execution: SimulatedRun) -> list[dict[str, Any]]:
    """Return the joints whose torque was at its limit, the longest first."""
    record, names = execution.record, execution.reference.joint_names
    step = float(record.times[1] - record.times[0]) if len(record.times) > 1 else 0.0
    saturated = np.abs(record.torque_share) >= SATURATED
    joints = []
    for column in np.flatnonzero(saturated.any(axis=0)).tolist():
        rows = np.flatnonzero(saturated[:, column])
        joints.append({"joint": names[column], "seconds": step * len(rows), "first_s": float(record.times[rows[0]])})
    return sorted(joints, key=lambda joint: -float(str(joint["seconds"])))


def _list_touches(execution: SimulatedRun) -> list[dict[str, Any]]:
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
        mean = smooth(force)
        rows = []
        for k, (span, pairs) in enumerate(zip(reference.phases, allowed, strict=True)):
            near = planned[max(k - 1, 0) : k + 2]  # a foot lands before its contact begins
            if any(contact.link == link for phase in near for contact in phase.contacts) or (link, other) in pairs:
                continue
            rows += list_rows(record, span).tolist()
        strong = [row for row in rows if mean[row] > TOUCH_N]
        if strong:
            touches.append(
                {
                    "link": link,
                    "other": other,
                    "peak_n": float(mean[strong].max()),
                    "first_s": float(record.times[min(strong)]),
                }
            )
    return sorted(touches, key=lambda touch: -float(str(touch["peak_n"])))


def _report_balance(execution: SimulatedRun, frames: Frames) -> dict[str, Any]:
    """Return the smallest distance of the centre of mass inside the feet, planned and simulated, on level soles [m]."""
    reference, record = execution.reference, execution.record
    planned, true, worst = np.inf, np.inf, None
    com, wanted = frames.com(), frames.com(True)
    for phase, span in zip(list_phases(reference.motion), reference.phases, strict=True):
        rows = list_rows(record, span)
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


def _write_track(execution: SimulatedRun) -> dict[str, Any]:
    """Return the simulated motion in the columns of a trajectory, and the ground's force, planned and simulated."""
    reference, record = execution.reference, execution.record
    rows = np.flatnonzero(record.times >= -1e-9)
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
    """Yield sentences on what a person should know of a simulation; none after a fall."""
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
