"""The plan part of taking an object and putting it elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.request.tasks.pick_place import PickRequest
from service.setup.prepare import PlanSetup
from service.tasks.kind import PlanPart
from service.tasks.pick_place.plan import plan_pick_place


class PickPlacePlanPart(PlanPart[PickRequest]):
    """Taking an object and putting it elsewhere."""

    def plan(self, section: PickRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans that carry the object."""
        return plan_pick_place(setup, solver, section)


PART = PickPlacePlanPart()
