"""Whether a motion does the whole of its request, so that its certificate decides and not the optimiser."""

from __future__ import annotations

from service.demands import compare_pace, hold_to_request
from service.errors import RequestError
from service.replay.rebuild import make_setup_demands
from service.setup.prepare import PlanSetup
from service.verify import Certificate, Motion, VerifySettings, verify


def certify_whole(setup: PlanSetup, motion: Motion, settings: VerifySettings | None = None) -> Certificate | None:
    """Certify a motion for the demands of its request, made anew; None where phases or promises of it are missing.

    None also where the request demands more than a verifier checks: of that the optimiser alone knows.
    """
    try:
        demands = make_setup_demands(setup)
    except RequestError:  # nothing to hold a motion to
        return None
    if demands.task.unproven:
        return None
    held = hold_to_request(demands, motion)
    if held.differences:
        return None
    certificate = verify(held.motion, settings)
    return None if any(compare_pace(setup.request, certificate)) else certificate
