"""Tasks: from a prepared request to the phases of a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.static_region import StaticRegionError
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.errors import RequestError, would_do
from service.setup.prepare import PlanSetup
from service.tasks.leave_start import leave_start
from service.tasks.reach.search import plan_reach


def plan_task(setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
    """Yield plans of the request's task, with phases that leave an unfit start first.

    Every plan does the whole task; the next is made on demand.

    Raises:
        RequestError: the request has no task with a planner.
    """
    request = setup.request
    if setup.unresolved:
        yield TaskPlan(solver.body, (), setup.unresolved)
        return
    if setup.program is not None:  # its waypoints include the start
        from service.tasks.trajopt.program import plan_program  # few requests need it

        yield from plan_program(solver, setup.program)
        return
    if request.task is not None and request.task.contacts is not None:
        from service.tasks.contacts.known_motion import read_known_motion
        from service.tasks.contacts.motion import plan_contact_motion

        contacts = request.task.contacts
        earlier = None if request.resume is None else request.resume.nominal
        guesses = read_known_motion(setup.robot, contacts, earlier)
        yield plan_contact_motion(solver, setup.stances, _find_finish(setup, contacts.finish), guesses)
        return
    if request.task is not None and request.task.egress is not None:
        from service.tasks.egress.task import plan_egress

        yield from plan_egress(setup, solver, request.task.egress)
        return
    lead = leave_start(solver, setup.overlaps)
    if lead.stuck is not None:
        yield lead
        return
    solver = replace(solver, body=lead.body)
    if request.goal is not None:
        plans = plan_reach(solver, request.goal, request.options.waypoints)
    elif request.task is not None and request.task.valve is not None:
        from service.tasks.valve.plan import plan_valve

        valve = request.task.valve
        plans = _list_plans(solver, lambda: plan_valve(setup, solver, valve))
    elif request.task is not None and request.task.door is not None:
        from service.tasks.door.plan import plan_door

        door = request.task.door
        plans = _list_plans(solver, lambda: plan_door(setup, solver, door))
    elif request.task is not None and request.task.mechanism is not None:
        from service.tasks.mechanism.plan import plan_mechanism

        mechanism = request.task.mechanism
        plans = _list_plans(solver, lambda: plan_mechanism(setup, solver, mechanism))
    else:
        words = "task.valve, task.door, task.mechanism, task.contacts, task.egress or task.trajopt"
        raise RequestError(f"request: expected a goal, {words}")
    for rest in plans:
        phases = (phase.for_body(rest.body) for phase in lead.phases)
        yield replace(rest, phases=(*phases, *rest.phases))


def _find_finish(setup: PlanSetup, posture: str | None) -> Float[np.ndarray, "n"] | None:
    """Return the configuration of a named posture (RequestError where the robot has none of that name)."""
    if posture is None:
        return None
    if posture not in setup.robot.postures:
        known = would_do(posture, sorted(setup.robot.postures)) or "no postures"
        raise RequestError(f"task.contacts.finish: unknown posture {posture!r}; {setup.robot.name} has {known}")
    return setup.robot.postures[posture]


def _list_plans(solver: PhaseSolver, plan: Callable[[], Iterator[TaskPlan]]) -> Iterator[TaskPlan]:
    """Yield the plans of a task with a mechanism, or a sentence where the ground does not hold its loads."""
    try:
        yield from plan()
    except StaticRegionError as error:
        words = "the ground does not hold the robot under the loads of the task"
        yield TaskPlan(solver.body, (), (f"{words} ({error}); smaller loads or a wider stance would help",))
