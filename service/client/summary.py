"""A result off the wire with the keys of ``result.json``, as a terminal shows it and ``--json`` prints it."""

from __future__ import annotations

import json
from typing import Any

import grpc

from service.client.answers import verdict_of
from service.client.errors import PlannerError
from service.proto.planner.v1.result_pb2 import Certificate, MotionResult
from service.result.folder import FORMAT
from service.wire.plain import to_plain


def summary_of(result: MotionResult) -> dict[str, Any]:
    """As ``service.result.result_json.summary_json`` makes it where the plan was made.

    Raises:
        PlannerError: the certificate is no JSON.
    """
    trajectory = result.trajectory if result.HasField("trajectory") else None
    return {
        "format": FORMAT,
        "request_hash": result.request_sha256,
        "verdict": verdict_of(result),
        "explanation": list(result.explanation),
        "conflict": to_plain(result.conflict) if result.HasField("conflict") else None,
        "found_from": result.found_from,
        "notes": list(result.notes),
        "planning_time_s": result.planning_time_s,
        "timings": dict(result.timings),
        **_proof(result.certificate),
        "figures": to_plain(result.figures),
        "detections": [to_plain(detection) for detection in result.detections],
        "phases": [
            {"name": phase.name, "start_s": phase.start_s, "end_s": phase.end_s}
            for phase in (trajectory.phases if trajectory is not None else ())
        ],
        "duration_s": trajectory.times[-1] if trajectory is not None and trajectory.times else None,
    }


def _proof(certificate: Certificate) -> dict[str, Any]:
    try:
        proof = json.loads(certificate.json) if certificate.json else {}
    except (ValueError, RecursionError):
        raise PlannerError(grpc.StatusCode.DATA_LOSS, "the certificate is no JSON") from None
    figures = ("min_clearance_m", "min_clearance_pair", "min_balance_margin_m", "coverage")
    return {**{key: proof.get(key) for key in figures}, **{key: proof.get(key, []) for key in ("checks", "exempt")}}
