"""A small plan as a job: what a cluster's machine makes of it is held against what this one does."""

from __future__ import annotations

import numpy as np

from service.executor import Control
from service.planner import plan
from service.request.file import parse_request


def bend_an_elbow(control: Control | None = None) -> tuple[str, np.ndarray]:
    """Verdict and waypoints of a plan whose steps are reported."""
    request = parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.6}}})
    if control is None:
        result = plan(request)
    else:
        result = plan(request, lambda step, fraction: control.report(step), control.should_stop)
    assert result.motion is not None
    return result.verdict.value, result.motion.curve.positions
