"""A result as the plain data of ``result.json`` (docs/result-format.md)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.json_data import encode_piece, to_json_data
from service.request.file import request_hash, to_json
from service.result.folder import FORMAT
from service.result.motion_json import file_columns, file_positions, motion_json, sample_times, samples_of
from service.result.result import PlanResult
from service.verify import Certificate
from service.verify.hashes import link_vertices, robot_hash

MAX_CLOUD_POINTS = 60_000


def to_result_json(result: PlanResult) -> dict[str, Any]:
    """Everything ``result.json`` holds, as JSON-ready data."""
    robot = result.robot
    return {
        "format": FORMAT,
        "request": to_json(result.request),
        "request_hash": request_hash(result.request),
        **_summary(result),
        "robot": _robot(robot),
        "bodies": [
            {"name": b.name, "link": b.link, "vertices": link_vertices(robot, b.link, b.vertices).tolist()}
            for b in robot.bodies
        ],
        "ignored_pairs": sorted(list(pair) for pair in robot.ignored_pairs),
        "pieces": [encode_piece(piece) for piece in result.scene.pieces],
        **(_at_rest(result) if result.motion is None else motion_json(result.motion, robot)),
        "certificate": None if result.certificate is None else result.certificate.to_dict(),
        "obstruction": to_json_data(result.obstruction),
        "cloud": _thinned(result.cloud).tolist(),
    }


def summary_json(result: PlanResult) -> dict[str, Any]:
    """What ``--json`` prints: the verdict and its figures, without the motion and its proof."""
    motion = result.motion
    return {
        "format": FORMAT,
        "request_hash": request_hash(result.request),
        **_summary(result),
        "phases": [] if motion is None else _phase_times(result),
        "duration_s": None if motion is None else float(sample_times(motion)[-1]),
    }


def proof_summary(certificate: Certificate | None) -> dict[str, Any]:
    """The figures, checks and exempt pairs of a certificate; absent figures are null."""
    proof = {} if certificate is None else certificate.to_dict()
    return {
        "min_clearance_m": proof.get("min_clearance_m"),
        "min_clearance_pair": proof.get("min_clearance_pair"),
        "min_balance_margin_m": proof.get("min_balance_margin_m"),
        "checks": proof.get("checks", []),
        "exempt": proof.get("exempt", []),
        "coverage": proof.get("coverage"),
    }


def _summary(result: PlanResult) -> dict[str, Any]:
    return {
        "verdict": result.verdict.value,
        "explanation": list(result.explanation),
        "conflict": None if result.conflict is None else result.conflict.to_dict(),
        "found_from": result.found_from,
        "notes": list(result.notes),
        "planning_time_s": result.planning_time_s,
        "timings": to_json_data(result.timings),
        **proof_summary(result.certificate),
        "figures": to_json_data(result.figures),
        "detections": to_json_data(result.detections),
    }


def _phase_times(result: PlanResult) -> list[dict[str, Any]]:
    if result.motion is None:
        return []
    s, times = samples_of(result.motion), sample_times(result.motion)
    return [
        {
            "name": phase.name,
            "start_s": float(np.interp(phase.first, s, times)),
            "end_s": float(np.interp(phase.last, s, times)),
        }
        for phase in result.motion.phases
    ]


def _at_rest(result: PlanResult) -> dict[str, Any]:
    """The motion's keys when there is none: the start as the only sample."""
    return {
        "trajectory": {
            "joint_names": list(file_columns(result.robot)),
            "positions": file_positions(result.robot, result.start[None]).tolist(),
            "times": [0.0],
        },
        "curve": None,
        **{key: [] for key in ("waypoints", "phases", "waived", "movables", "support_polygons", "com", "zmp")},
    }


def _robot(robot: RobotModel) -> dict[str, Any]:
    """Paths are relative to the result's folder, where ``service.result.output`` writes the files."""
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
    """Links that have no collision shape, so that nothing of them is checked, in the robot's order."""
    shaped = {body.link for body in robot.bodies}
    frames = (frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
    return [frame.name for frame in frames if frame.name != "universe" and frame.name not in shaped]


def _thinned(cloud: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "K 3"]:
    step = max(1, -(-len(cloud) // MAX_CLOUD_POINTS))
    return np.round(cloud[::step], 4)
