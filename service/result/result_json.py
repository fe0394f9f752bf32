"""Content of ``result.json`` (docs/result-format.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pinocchio as pin

from costs.robot import RobotModel
from service.request.file import request_hash, to_json
from service.request.versions import find_format, list_defaults
from service.result.folder import FORMAT
from service.result.motion_json import file_columns, file_positions, motion_json, sample_times, samples_of
from service.result.phase_report import PhaseReport, PhaseStatus
from service.result.result import PlanResult
from service.scan.json_data import encode_piece, to_json_data
from service.verify import Approach, Certificate, Motion, link_vertices, robot_hash

MAX_CLOUD_POINTS = 60_000


def to_result_json(result: PlanResult) -> dict[str, Any]:
    """Return the content of ``result.json``."""
    from service.viewer.payload import thin_points  # slow to import, and not needed for a summary

    robot = result.robot
    return {
        "format": FORMAT,
        "request": to_json(result.request),
        "request_hash": request_hash(result.request),
        "request_format": find_format(result.request),
        "request_defaults": list_defaults(result.request),
        **_summarize(result),
        "robot": _write_robot(robot),
        "bodies": [
            {"name": b.name, "link": b.link, "vertices": link_vertices(robot, b.link, b.vertices).tolist()}
            for b in robot.bodies
        ],
        "ignored_pairs": sorted(list(pair) for pair in robot.ignored_pairs),
        "pieces": [encode_piece(piece) for piece in result.scene.pieces],
        **(_write_start(result) if result.motion is None else _write_motion(result, result.motion)),
        "not_planned": [report.name for report in result.phases if report.status is PhaseStatus.NOT_PLANNED],
        "certificate": None if result.certificate is None else result.certificate.to_dict(),
        "obstruction": to_json_data(result.obstruction),
        "pose_graph": to_json_data(result.pose_graph),
        "cloud": np.round(thin_points(result.cloud, MAX_CLOUD_POINTS), 4).tolist(),
    }


def summary_json(result: PlanResult) -> dict[str, Any]:
    """Return what ``--json`` prints: the verdict and its figures, without the motion and its proof."""
    motion = result.motion
    return {
        "format": FORMAT,
        "request_hash": request_hash(result.request),
        **_summarize(result),
        "phases": list_phases(result),
        "duration_s": None if motion is None else float(sample_times(motion)[-1]),
    }


def proof_summary(certificate: Certificate | None) -> dict[str, Any]:
    """Return figures, checks, exempt pairs and coverage of a certificate; null or empty without one."""
    proof = {} if certificate is None else certificate.to_dict()
    return {
        "min_clearance_m": proof.get("min_clearance_m"),
        "min_clearance_pair": proof.get("min_clearance_pair"),
        "min_balance_margin_m": proof.get("min_balance_margin_m"),
        "checks": proof.get("checks", []),
        "exempt": proof.get("exempt", []),
        "coverage": proof.get("coverage"),
    }


def _summarize(result: PlanResult) -> dict[str, Any]:
    return {
        "verdict": result.verdict.value,
        "explanation": list(result.explanation),
        "conflict": None if result.conflict is None else result.conflict.to_dict(),
        "found_from": result.found_from,
        "notes": list(result.notes),
        "planning_time_s": result.planning_time_s,
        "timings": to_json_data(result.timings),
        **proof_summary(result.certificate),
        "servo": to_json_data(result.servo),
        "figures": to_json_data(result.figures),
        "detections": to_json_data(result.detections),
    }


def list_phases(result: PlanResult) -> list[dict[str, Any]]:
    """Return the phases with status, checks and times [s]; a phase that was not planned has null for its times."""
    ends = {} if result.motion is None else _find_phase_times(result.motion)
    nothing = (None, None)
    return [
        {
            **report.to_dict(),
            **dict(zip(("start_s", "end_s"), ends.get(report.name, nothing), strict=True)),
        }
        for report in result.phases
    ]


def _find_phase_times(motion: Motion) -> dict[str, tuple[float, float]]:
    s, times = samples_of(motion), sample_times(motion)
    return {
        phase.name: (float(np.interp(phase.first, s, times)), float(np.interp(phase.last, s, times)))
        for phase in motion.phases
    }


def _write_motion(result: PlanResult, motion: Motion) -> dict[str, Any]:
    """Return the motion's keys, its phases with their status and checks."""
    data = motion_json(motion, result.robot)
    reports = [report for report in result.phases if report.status is not PhaseStatus.NOT_PLANNED]
    return {**data, "phases": add_reports(data["phases"], reports)}


def add_reports(phases: Sequence[Mapping[str, Any]], reports: Sequence[PhaseReport]) -> list[dict[str, Any]]:
    """Return phases of ``result.json`` with the status and the checks of their reports."""
    return [{**phase, **report.to_dict()} for phase, report in zip(phases, reports, strict=True)]


def _write_start(result: PlanResult) -> dict[str, Any]:
    """Return the motion's keys of a result without a motion: the start is the only sample."""
    return {
        "trajectory": {
            "joint_names": list(file_columns(result.robot)),
            "positions": file_positions(result.robot, result.start[None]).tolist(),
            "times": [0.0],
        },
        "curve": None,
        "clearance_m": result.request.options.clearance_m,
        "sway_m": result.request.options.sway_m,
        "sway_deg": result.request.options.sway_deg,
        "padding": dict(result.request.options.padding),
        "jerk_scale": result.request.options.jerk_scale,
        "tool_speed_m_s": result.request.options.tool_speed_m_s,
        "pace": result.request.options.pace,
        "approach": asdict(Approach.of(result.request.hand_servo)),
        "start_rates": result.request.end_rates[0],
        "end_rates": result.request.end_rates[1],
        **{key: [] for key in ("waypoints", "phases", "waived", "movables", "support_polygons", "com", "zmp")},
    }


def _write_robot(robot: RobotModel) -> dict[str, Any]:
    """Return the robot's section, with paths relative to the result's folder."""
    return {
        "name": robot.name,
        "urdf": "robot/robot.urdf",
        "srdf": "robot/robot.srdf" if robot.source.srdf else None,
        "package_dirs": ["robot"],
        "root": "floating" if robot.is_floating else "fixed",
        "sha256": robot_hash(robot),
        "links_without_shape": links_without_shape(robot),
    }


def links_without_shape(robot: RobotModel) -> list[str]:
    """Return the links without a collision shape, which are not checked, in the robot's order."""
    shaped = {body.link for body in robot.bodies}
    frames = (frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
    return [frame.name for frame in frames if frame.name != "universe" and frame.name not in shaped]
