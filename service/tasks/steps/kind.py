"""The plan part of a list of steps."""

from __future__ import annotations

from collections.abc import Iterator

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.demands.steps.pick_place import list_pick_steps
from service.request.tasks.pick_place import PickRequest
from service.request.tasks.steps import StepsSection
from service.setup.prepare import PlanSetup
from service.tasks.kind import PlanPart
from service.tasks.steps.plan import plan_steps


class StepsPlanPart(PlanPart[StepsSection]):
    """Steps one after the other."""

    def plan(self, section: StepsSection, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield the plan of the steps."""
        return plan_steps(section, setup, solver)


class PickPlacePlanPart(PlanPart[PickRequest]):
    """The steps of taking an object and putting it elsewhere."""

    def plan(self, section: PickRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield the plan of the steps."""
        return plan_steps(list_pick_steps(section, setup.request), setup, solver)


PART, PICK_PLACE = StepsPlanPart(), PickPlacePlanPart()
