"""Results as messages: what a client executes, shows and reviews."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np

from service.json_data import plain
from service.proto.planner.v1.result_pb2 import Certificate as CertificateMessage
from service.proto.planner.v1.result_pb2 import Check, MotionResult, PhaseTimes, Trajectory
from service.proto.planner.v1.result_pb2 import Verdict as VerdictMessage
from service.request.file import request_hash
from service.result.motion_json import file_columns, file_positions, sample_times, samples_of
from service.result.result import PlanResult, Verdict
from service.verify import Certificate, Motion
from service.wire.hashes import certificate_sha256, trajectory_sha256


def result_to_message(result: PlanResult, sha256: str = "") -> MotionResult:
    """Everything of a result but what is drawn: pieces, bodies, clouds and intermediate points are in its files.

    Args:
        result: of a plan.
        sha256: ``request_hash`` of its request where it is known already.
    """
    message = MotionResult(
        verdict=verdict_number(result.verdict.value),
        explanation=result.explanation,
        notes=result.notes,
        found_from=result.found_from,
        request_sha256=sha256 or request_hash(result.request),
        planning_time_s=result.planning_time_s,
        timings=result.timings,
    )
    message.figures.update(plain(result.figures))
    for detection in result.detections:
        message.detections.add().update(plain(detection))
    if result.conflict is not None:
        message.conflict.update(plain(result.conflict.to_dict()))
    if result.motion is not None:
        message.trajectory.CopyFrom(_trajectory(result, result.motion))
    if result.certificate is not None:
        message.certificate.CopyFrom(_certificate(result.certificate))
    return message


def verdict_number(name: str) -> VerdictMessage:
    """The verdict on the wire."""
    return cast(VerdictMessage, VerdictMessage.Value(f"VERDICT_{name}"))


def verdict_name(number: int) -> str:
    """The verdict as ``result.json`` writes it.

    Raises:
        ValueError: there is no such verdict.
    """
    return Verdict(VerdictMessage.Name(cast(VerdictMessage, number)).removeprefix("VERDICT_")).value


def checks_to_messages(checks: Iterable[Mapping[str, Any]]) -> list[Check]:
    """The checks of a certificate's JSON; a value that is no number there is NaN."""
    return [
        Check(
            name=check["name"],
            ok=check["ok"],
            value=_number(check["value"]),
            limit=_number(check["limit"]),
            unit=check["unit"],
            text=check["text"],
            basis=check["basis"],
        )
        for check in checks
    ]


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _trajectory(result: PlanResult, motion: Motion) -> Trajectory:
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
        sha256=trajectory_sha256(names, times, positions),
    )


def _certificate(certificate: Certificate) -> CertificateMessage:
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
        min_clearance_m=_or_none(certificate.min_clearance_m),
        min_clearance_pair=certificate.min_clearance_pair or (),
        min_balance_margin_m=_or_none(certificate.min_balance_margin_m),
        json=text,
        sha256=certificate_sha256(text),
    )


def _or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
