"""Settling: bringing the centre of mass inside its margin before anything else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.body.phases import PhaseSolver, PlannedPhase, Stuck, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.stance import BALANCE_RESERVE

WAYPOINTS = 6


def needs_settling(body: WholeBody) -> bool:
    """Whether the start is balanced by less than the margin that the motion shall keep."""
    if body.polygon is None:
        return False
    com = body.engine(body.nominal[None]).com[:, :2]
    return bool(body.polygon.margin(com)[0] < body.aims.balance_margin + BALANCE_RESERVE)


def settle(solver: PhaseSolver) -> TaskPlan:
    """One phase from the start to a nearby configuration inside the margin; the plan's body starts from there."""
    body = solver.body
    start = np.tile(body.nominal, (WAYPOINTS, 1))
    with solver.monitor.step("settle", 0.05):
        result = solver.trajectory("settle", [start], {0: body.nominal}, balanced=[WAYPOINTS - 1])
    phase = PlannedPhase("settle", result.x, result.is_feasible, is_settling=True)
    settled = replace(body, nominal=result.x[-1])
    return TaskPlan(settled, (phase,), stuck=Stuck.at("settle", result))
