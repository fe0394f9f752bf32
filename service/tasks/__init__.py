"""Tasks: from a prepared request to the phases of a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from costs.static_region import StaticRegionError
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.setup.prepare import PlanSetup
from service.tasks.kind import find_plan_part
from service.tasks.leave_start import leave_start
from service.verify import Carrier


def plan_task(setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
    """Yield plans of the request's task, with phases that leave an unfit start first.

    Every plan does the whole task; the next is made on demand.
    """
    if setup.unresolved:
        yield TaskPlan(solver.body, (), setup.unresolved)
        return
    part, section = find_plan_part(setup.request), setup.request.section
    if not part.leaves_start:
        yield from part.plan(section, setup, solver)
        return
    lead = leave_start(solver, setup.overlaps, setup.rests)
    if lead.stuck is not None:
        yield lead
        return
    solver = replace(solver, body=lead.body)
    try:
        for rest in part.plan(section, setup, solver):
            still = tuple(Carrier(item.name) for item in rest.objects)
            leading = (phase.for_body(rest.body) for phase in lead.phases)
            phases = (replace(phase, phase=replace(phase.phase, carriers=still)) for phase in leading)
            yield replace(rest, phases=(*phases, *rest.phases))
    except StaticRegionError as error:
        words = "the ground does not hold the robot under the loads of the task"
        sentence = f"{words} ({error}); smaller loads or a wider stance would help"
        yield TaskPlan(solver.body, lead.phases, (sentence,))
