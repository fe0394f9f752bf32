"""What a plan must be before the robot may carry it out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from service.errors import shown
from service.result.releases import describe_releases, list_held, list_releases
from service.server.operation.control import refuse
from service.store import Decision, NotStoredError, PlanRecord, PlanState, Review, Store

CERTIFIED = "CERTIFIED"
RESULT_NAME = "result.json"


def check_plan(record: PlanRecord, trajectory_sha256: str) -> None:
    """Check that a stored plan is certified, has files, and is the one that the operator has seen.

    Raises:
        Refusal: FAILED_PRECONDITION with a sentence.
    """
    if record.state is not PlanState.FINISHED:
        raise refuse(f"plan_id: plan {record.plan_id} is {record.state.value}; expected a finished plan")
    if record.verdict != CERTIFIED:
        raise refuse(f"plan_id: plan {record.plan_id} is {record.verdict}; only {CERTIFIED} plans are carried out")
    if trajectory_sha256 != record.plan_sha256:
        raise refuse(
            f"trajectory_sha256: plan {record.plan_id} has {shown(record.plan_sha256[:12])}, the order is about "
            f"{shown(trajectory_sha256[:12])}; it is not the plan that was looked at, look again"
        )
    if not record.archive_bytes:
        raise refuse(f"plan_id: plan {record.plan_id} was planned without files; plan it again with files")


def check_approval(
    plan_id: str, reviews: Sequence[Review], given: bytes, is_required: bool, now: float, *, is_direct: bool = False
) -> None:
    """Check the newest review of a plan where an approval is required or named.

    Args:
        plan_id: of the plan.
        reviews: oldest first.
        given: signed statement that the operator relies on; empty without one.
        is_required: whether the server demands an acceptance.
        now: [s since 1970].
        is_direct: whether it is a direct move, which nobody reviews by the way.

    Raises:
        Refusal: FAILED_PRECONDITION with a sentence.
    """
    if not (is_required or given):
        return
    last = reviews[-1] if reviews else None
    if last is None and is_direct:
        raise refuse(
            "approval: this server's robot carries out accepted plans only, and a nudge or another direct move has no "
            "review; scopt serve --no-require-approval allows them, or accept this one "
            f"(scopt review {plan_id} --accept)"
        )
    if last is None:
        raise refuse(f"approval: plan {plan_id} has no review; accept it first (scopt review {plan_id} --accept)")
    at = _format(last.time)
    if last.decision is Decision.REJECTED:
        is_revoked = len(reviews) > 1 and reviews[-2].decision is Decision.ACCEPTED
        what = "revoked the approval" if is_revoked else "rejected the plan"
        raise refuse(f"approval: {last.reviewer} {what} at {at}")
    if now >= last.expires:
        raise refuse(f"approval: that of {last.reviewer} expired at {_format(last.expires)}; review the plan again")
    if given and given != last.approval:
        raise refuse(f"approval: the plan's newest one is that of {last.reviewer} at {at}, not the one that was named")


def find_scan_age_s(result: Mapping[str, Any], record: PlanRecord, store: Store, now: float) -> float | None:
    """Return the age of what a plan knows of its surroundings [s]; None for a plan without scan.

    It is counted from when the scene was built, if the store has it, and from the plan's request at the latest.
    """
    scene = result.get("request", {}).get("scene", {})
    name = scene.get("file")
    if not (name or scene.get("cloud")):
        return None
    begin = record.created
    if isinstance(name, str):
        with suppress(NotStoredError):  # a file, or removed since: the plan is younger than its scene
            begin = min(begin, store.scenes.created(name))
    return max(now - begin, 0.0)


def check_scan_age(age_s: float | None, limit_s: float, accepted_s: float | None) -> None:
    """Check that a scan is younger than the limit, or than what the operator has found to be right still.

    Raises:
        Refusal: FAILED_PRECONDITION with a sentence.
    """
    if age_s is None:
        return
    most = limit_s if accepted_s is None else accepted_s
    if age_s > most:
        raise refuse(
            f"the plan's scan is {_describe(age_s)} old; expected at most {_describe(most)}: scan again and plan with "
            "it, or compare the scan with what is there and accept its age"
        )


def check_releases(result: Mapping[str, Any], confirmed: Sequence[str], held: Sequence[str] = ()) -> None:
    """Check that the operator has confirmed every object that hands let go.

    Args:
        result: of the plan.
        confirmed: objects that hands may let go.
        held: objects that the robot's hands hold now; a plan that does not begin with them in a hand may open it.

    Raises:
        Refusal: FAILED_PRECONDITION with a sentence.
    """
    known = {*list_held(result), *confirmed}
    forgotten = [shown(name) for name in held if name not in known]
    if forgotten:
        raise refuse(
            f"lets_go: the robot holds {' and '.join(forgotten)}, and the plan does not begin with that in a hand; "
            "plan with a step 'hold' first, or name what may be let go to confirm that the hand may open"
        )
    released = list_releases(result)
    open_ones = {name: phase for name, phase in released.items() if name not in confirmed}
    if open_ones:
        raise refuse(
            f"lets_go: the plan lets go of {describe_releases(open_ones)}; name what may be let go to confirm that the "
            "hand may open there"
        )


def read_result_json(files: Mapping[str, bytes]) -> Mapping[str, Any]:
    """Return the content of a plan's ``result.json``; empty where it has none."""
    data = json.loads(files.get(RESULT_NAME, b"{}"))
    return data if isinstance(data, dict) else {}


def _describe(seconds: float) -> str:
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def _format(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
