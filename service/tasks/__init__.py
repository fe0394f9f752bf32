"""Tasks: from a prepared request to the phases of a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from service.errors import RequestError
from service.phases import PhaseSolver, TaskPlan
from service.setup import PlanSetup
from service.tasks.program import plan_program
from service.tasks.reach import plan_reach
from service.tasks.settle import needs_settling, settle
from service.tasks.valve_task import plan_valve


def plan_task(setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
    """Plan what the request asks for, settling first where the start is not balanced enough.

    Every plan is another way to do the whole task; the next is worked out when it is asked for.

    Raises:
        RequestError: the request asks for nothing that is known here.
    """
    if setup.program is not None:  # says itself where its waypoints are, the first among them
        yield from plan_program(solver, setup.program)
        return
    if not needs_settling(solver.body):
        yield from _plan(setup, solver)
        return
    settled = settle(solver)
    if not settled.is_feasible:
        yield settled
        return
    for rest in _plan(setup, replace(solver, body=settled.body)):
        first = settled.phases[0].for_robot(rest.body.robot)
        yield replace(rest, phases=(first, *rest.phases))


def _plan(setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
    request = setup.request
    if request.goal is not None:
        return plan_reach(solver, request.goal, request.options.waypoints)
    if request.task is not None and request.task.valve is not None:
        return iter([plan_valve(setup, solver, request.task.valve)])
    raise RequestError("request: goal, task.valve or task.trajopt is needed")
