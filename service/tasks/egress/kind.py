"""The plan part of getting out of a vehicle."""

from __future__ import annotations

from collections.abc import Iterator

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.request.tasks.egress import EgressRequest
from service.setup.prepare import PlanSetup
from service.tasks.egress.task import plan_egress
from service.tasks.kind import PlanPart


class EgressPlanPart(PlanPart[EgressRequest]):
    """Getting out of a vehicle."""

    @property
    def leaves_start(self) -> bool:
        """No: the first stance holds the robot."""
        return False

    def plan(self, section: EgressRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield the plan along the cheapest sequence of poses."""
        return plan_egress(setup, solver, section)


PART = EgressPlanPart()
