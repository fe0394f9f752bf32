"""Tasks: from a prepared request to the phases of a motion."""

from __future__ import annotations

from service.errors import RequestError
from service.phases import PhaseSolver, TaskPlan
from service.setup import PlanSetup
from service.tasks.reach import plan_reach
from service.tasks.valve_task import plan_valve


def plan_task(setup: PlanSetup, solver: PhaseSolver) -> TaskPlan:
    """Plan what the request asks for: a goal or a task.

    Raises:
        RequestError: the request asks for nothing that is known here.
    """
    request = setup.request
    if request.goal is not None:
        return plan_reach(solver, request.goal, request.options.waypoints)
    if request.task is not None and request.task.valve is not None:
        return plan_valve(setup, solver, request.task.valve)
    raise RequestError("request: goal or task.valve is needed")
