"""Tasks: from a prepared request to the phases of a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from service.body.phases import PhaseSolver, TaskPlan
from service.errors import RequestError
from service.setup.prepare import PlanSetup
from service.tasks.escape import escape
from service.tasks.reach import plan_reach
from service.tasks.settle import needs_settling, settle


def plan_task(setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
    """Plan what the request asks for, leaving a collision and settling first where the start needs it.

    Every plan is another way to do the whole task; the next is worked out when it is asked for.

    Raises:
        RequestError: the request asks for nothing that is known here.
    """
    if setup.unresolved:
        yield TaskPlan(solver.body, (), setup.unresolved)
        return
    if setup.program is not None:  # says itself where its waypoints are, the first among them
        from service.tasks.program import plan_program  # what few requests need is read when it is needed

        yield from plan_program(solver, setup.program)
        return
    lead = _lead(setup, solver)
    if lead.stuck is not None:
        yield lead
        return
    for rest in _plan(setup, replace(solver, body=lead.body)):
        phases = (phase.for_robot(rest.body.robot) for phase in lead.phases)
        yield replace(rest, phases=(*phases, *rest.phases))


def _lead(setup: PlanSetup, solver: PhaseSolver) -> TaskPlan:
    """What comes before the task: out of what the start is in, then into balance; no phase where neither is needed."""
    lead = TaskPlan(solver.body, ())
    if setup.overlaps:
        lead = escape(solver, setup.overlaps)
    if lead.stuck is None and needs_settling(lead.body):
        settled = settle(replace(solver, body=lead.body))
        lead = replace(settled, phases=(*lead.phases, *settled.phases))
    return lead


def _plan(setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
    request = setup.request
    if request.goal is not None:
        return plan_reach(solver, request.goal, request.options.waypoints)
    if request.task is not None and request.task.valve is not None:
        from service.tasks.valve_task import plan_valve

        return iter([plan_valve(setup, solver, request.task.valve)])
    raise RequestError("request: goal, task.valve or task.trajopt is needed")
