"""Results as messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np

from service.json_data import to_json_data
from service.proto.planner.v1.result_pb2 import Certificate as CertificateMessage
from service.proto.planner.v1.result_pb2 import Check, MotionResult, PhaseReport, PhaseTimes, Trajectory
from service.proto.planner.v1.result_pb2 import Verdict as VerdictMessage
from service.request.file import request_hash
from service.result.motion_json import file_columns, file_positions, sample_times, samples_of
from service.result.result import PlanResult
from service.result.result_json import list_phases
from service.verify import Certificate, Motion
from service.wire.hashes import hash_certificate, hash_trajectory


def result_to_message(result: PlanResult, sha256: str = "") -> MotionResult:
    """Convert a result without its drawing: pieces, bodies, clouds and intermediate points are only in its files.

    Args:
        result: result of a plan.
        sha256: ``request_hash`` of its request if known already.
    """
    message = MotionResult(
        verdict=encode_verdict(result.verdict.value),
        explanation=result.explanation,
        notes=result.notes,
        found_from=result.found_from,
        request_sha256=sha256 or request_hash(result.request),
        planning_time_s=result.planning_time_s,
        timings=result.timings,
        phases=[PhaseReport(**phase) for phase in list_phases(result)],
    )
    message.figures.update(to_json_data(result.figures))
    for detection in result.detections:
        message.detections.add().update(to_json_data(detection))
    if result.conflict is not None:
        message.conflict.update(to_json_data(result.conflict.to_dict()))
    if result.motion is not None:
        message.trajectory.CopyFrom(_trajectory_to_message(result, result.motion))
    if result.certificate is not None:
        message.certificate.CopyFrom(_certificate_to_message(result.certificate))
    return message


def encode_verdict(name: str) -> VerdictMessage:
    """Return the wire's number of a verdict."""
    return cast(VerdictMessage, VerdictMessage.Value(f"VERDICT_{name}"))


def checks_to_messages(checks: Iterable[Mapping[str, Any]]) -> list[Check]:
    """Convert the checks of a certificate's JSON; null becomes NaN."""
    return [
        Check(
            name=check["name"],
            ok=check["ok"],
            value=_to_float(check["value"]),
            limit=_to_float(check["limit"]),
            unit=check["unit"],
            text=check["text"],
            basis=check["basis"],
        )
        for check in checks
    ]


def _to_float(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _trajectory_to_message(result: PlanResult, motion: Motion) -> Trajectory:
    s, times = samples_of(motion), sample_times(motion)
    names = file_columns(result.robot)
    positions = file_positions(result.robot, motion.curve(s)[:, : result.robot.n])
    ends = np.interp([(phase.first, phase.last) for phase in motion.phases], s, times) if motion.phases else ()
    return Trajectory(
        joint_names=names,
        times=times.tolist(),
        positions=positions.ravel().tolist(),
        phases=[
            PhaseTimes(name=phase.name, start_s=start, end_s=end)
            for phase, (start, end) in zip(motion.phases, ends, strict=True)
        ],
        is_timed=motion.law is not None,
        sha256=hash_trajectory(names, times, positions),
    )


def _certificate_to_message(certificate: Certificate) -> CertificateMessage:
    text = certificate.to_json().encode()
    return CertificateMessage(
        status=certificate.status.value,
        checks=[
            Check(
                name=check.name,
                ok=bool(check.ok),
                value=float(check.value),
                limit=float(check.limit),
                unit=check.unit,
                text=check.text,
                basis=check.basis.value,
            )
            for check in certificate.checks
        ],
        min_clearance_m=_finite_or_none(certificate.min_clearance_m),
        min_clearance_pair=certificate.min_clearance_pair or (),
        min_balance_margin_m=_finite_or_none(certificate.min_balance_margin_m),
        json=text,
        sha256=hash_certificate(text),
    )


def _finite_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
