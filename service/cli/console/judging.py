"""A plan as an operator judges it: risk first, what is assumed, then the checks by phase.

All of it comes from the certificate, whose hash a review is bound to.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from service.client import PlannerError
from service.client.answers import read_verdict
from service.proto.planner.v1.planner_pb2 import PlanRecord

WHOLE = "whole motion"
Check = Mapping[str, Any]
CLOSEST = "Closest pair"
# Risks by kind of check: how they are called, and what is worst of them.
RISKS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (CLOSEST, ("clearance",)),
    ("Largest torque", ("torque",)),
    ("Hand forces against their contacts", ("hand_contact", "hand_touch", "grasp", "resting", "equilibrium")),
    ("Balance", ("balance", "zmp")),
)
ORDER = ("refuted", "unproven", "at samples", "proven")  # worst first


def judge_plan(record: PlanRecord) -> dict[str, Any]:
    """Return the risks, assumptions and grouped checks of a finished plan, JSON-ready.

    Raises:
        PlannerError: the certificate is no JSON.
    """
    result = record.result
    certificate = _read_certificate(result.certificate.json)
    checks = [dict(check, standing=find_standing(check)) for check in certificate.get("checks") or ()]
    phases = [phase.name for phase in result.trajectory.phases]
    notes = list(dict.fromkeys([*(certificate.get("notes") or ()), *result.notes]))
    return {
        "verdict": read_verdict(result),
        "explanation": list(result.explanation),
        "checks": checks,
        "risks": list_risks(checks, certificate),
        "assumed": notes,
        "not_checked": list((certificate.get("coverage") or {}).get("not_checked") or ()),
        "groups": group_checks(checks, phases),
        "duration_s": result.trajectory.times[-1] if len(result.trajectory.times) else None,
        "planning_time_s": result.planning_time_s,
    }


def find_standing(check: Check) -> str:
    """Return what a check rests on: ``refuted``, ``unproven``, ``at samples`` or ``proven``."""
    if not check.get("ok"):
        return "refuted"
    return {"unproven": "unproven", "samples": "at samples"}.get(str(check.get("basis")), "proven")


def find_phase(name: str, phases: Iterable[str]) -> str:
    """Return the phase that a check's name (``KIND.PHASE.MORE``) belongs to; ``WHOLE`` for those of no phase.

    Phases may have dots in their names: the longest that fits counts.
    """
    _, _, rest = name.partition(".")
    fitting = [phase for phase in phases if rest == phase or rest.startswith(f"{phase}.")]
    return max(fitting, key=len, default=WHOLE)


def list_risks(checks: Sequence[Check], certificate: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the worst check of each kind of risk, with its index among the checks."""
    risks = []
    for title, kinds in RISKS:
        own = [index for index, check in enumerate(checks) if str(check["name"]).partition(".")[0] in kinds]
        if not own:
            continue
        worst = min(own, key=lambda index: _rank(checks[index]))
        check = checks[worst]
        risks.append({
            "title": title,
            "check": worst,
            "standing": check["standing"],
            "value": check.get("value"),
            "unit": check.get("unit"),
            "text": check.get("text") or check["name"],
            "count": len(own),
        })  # fmt: skip
    pair, least = list(certificate.get("min_clearance_pair") or []), certificate.get("min_clearance_m")
    for risk in risks:
        if risk["title"] == CLOSEST and len(pair) == 2 and risk["standing"] == "proven":
            risk.update(value=least, text=f"{pair[0]} and {pair[1]}")
    return risks


def group_checks(checks: Sequence[Check], phases: Sequence[str]) -> list[dict[str, Any]]:
    """Return the indices of the checks by phase, in the motion's order, with those that do not hold apart."""
    indices: dict[str, list[int]] = {phase: [] for phase in (WHOLE, *phases)}
    for index, check in enumerate(checks):
        indices[find_phase(str(check["name"]), phases)].append(index)
    return [
        {
            "phase": phase,
            "open": [index for index in own if checks[index]["standing"] in ORDER[:2]],
            "passed": [index for index in own if checks[index]["standing"] not in ORDER[:2]],
        }
        for phase, own in indices.items()
        if own
    ]


def _rank(check: Check) -> tuple[int, float]:
    """Return the order of a check among those of its risk: the worst standing first, then the least to spare."""
    value, limit = check.get("value"), check.get("limit")
    if value is None:
        return ORDER.index(check["standing"]), float("-inf")
    return ORDER.index(check["standing"]), _measure_spare(str(check["name"]), float(value), float(limit or 0.0))


def _measure_spare(name: str, value: float, limit: float) -> float:
    """Return how far a value is from its limit, positive if it holds; most kinds are upper limits."""
    is_lower = name.partition(".")[0] in ("clearance", "balance", "zmp")
    return value - limit if is_lower else limit - value


def _read_certificate(text: bytes) -> dict[str, Any]:
    from grpc import StatusCode

    try:
        data = json.loads(text) if text else {}
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise PlannerError(StatusCode.DATA_LOSS, "the certificate is no JSON object; this console cannot show it")
    return data
