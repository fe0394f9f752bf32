"""The plan part of turning a valve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.valve.wheel import make_wheel
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.request.tasks.registry import TaskRequest
from service.request.tasks.valve import ValveRequest
from service.setup.prepare import PlanSetup
from service.setup.world import Surroundings
from service.tasks.kind import PlanPart, RequestedEnd, check_displaceable, displace_place
from service.tasks.valve.plan import choose_hands, find_valve, list_clearances, plan_valve, refuse_lever
from service.tasks.valve.stance import ValveStance
from service.verify import CircleTarget

TARGET = "valve"


class ValvePlanPart(PlanPart[ValveRequest]):
    """Turning a valve."""

    def plan(self, section: ValveRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans that turn the valve."""
        return plan_valve(setup, solver, section)

    @property
    def has_stances(self) -> bool:
        """Yes."""
        return True

    def find_stance_task(
        self, section: ValveRequest, setup: PlanSetup, body: WholeBody
    ) -> tuple[ValveStance, tuple[str, ...]] | str:
        """Return the wheel to turn."""
        valve = find_valve(setup, section)
        if isinstance(valve, str):
            return valve
        refused = refuse_lever(valve, section)
        if refused is not None:
            return refused
        hooks = choose_hands(body, section, valve)
        note = f"valve at {np.round(valve.centre, 3).tolist()}, rim radius {valve.rim_radius:.3f} m"
        return ValveStance(make_wheel(valve, section), hooks, section, list_clearances(hooks)), (note,)

    def get_end(self, section: ValveRequest, setup: PlanSetup) -> RequestedEnd | None:
        """Return the rim of a valve that the request gives."""
        radius = section.radius if section.lever is None else section.lever.length_m
        if section.centre is None or section.axis is None or radius is None:
            return None
        axis = np.array(section.axis) / np.linalg.norm(section.axis)
        return RequestedEnd((CircleTarget("rim", np.array(section.centre), axis, radius, 0.0),))

    def displace(
        self, request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
    ) -> tuple[PlanRequest, Surroundings | None]:
        """Displace the valve that the request gives, or that its scan shows with the piece behind it."""
        check_displaceable(target, [TARGET])
        valve = request.section
        if isinstance(valve, ValveRequest) and valve.centre is not None:
            given = replace(valve, centre=displace_place(valve.centre, offset))
            return replace(request, task=TaskRequest(valve=given)), around
        if around is None or not around.valves:
            raise RequestError("adjust: the earlier plan recorded no valve")
        return request, around.move_valve(offset)


PART = ValvePlanPart()
