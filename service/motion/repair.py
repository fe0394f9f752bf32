"""Mending a motion that fails between waypoints: one goes in where the check fails, and the phase is solved on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.monitor import Monitor
from service.body.phases import TaskPlan
from service.verify import Basis, Certificate, Motion


def repair_plan(plan: TaskPlan, motion: Motion, certificate: Certificate, monitor: Monitor) -> TaskPlan | None:
    """The plan with denser waypoints where checks fail; None when no failing phase can be solved again.

    Args:
        plan: what was executed as ``motion``.
        motion: the curve that was checked.
        certificate: what was found.
        monitor: of the plan.
    """
    places = [
        check.where.s
        for check in certificate.checks
        if check.where is not None
        and (not check.ok or check.basis is Basis.UNPROVEN)
        and not check.name.startswith("coverage.")  # no waypoint mends what is not checked
    ]
    phases = list(plan.phases)
    is_changed = False
    for index, (phase, promise) in enumerate(zip(plan.phases, motion.phases, strict=True)):
        inside = [s for s in places if promise.first < s < promise.last]
        if not inside:
            continue
        with monitor.step(f"repair {phase.name}", 0.9):
            anew = phase.solve_again(_add_waypoints(motion, promise.first, promise.last, inside))
        if anew is not None:
            phases[index] = anew
            is_changed = True
    return replace(plan, phases=tuple(phases)) if is_changed else None


def _add_waypoints(motion: Motion, first: float, last: float, places: Sequence[float]) -> Float[np.ndarray, "T n"]:
    """The phase's waypoints on the curve, and one more in the middle of every interval that holds a place."""
    knots = motion.curve.knots
    knots = knots[(knots >= first) & (knots <= last)]
    rows = np.clip(np.searchsorted(knots, places, side="right") - 1, 0, len(knots) - 2)
    middle = 0.5 * (knots[rows] + knots[rows + 1])
    return motion.curve(np.union1d(knots, middle))
