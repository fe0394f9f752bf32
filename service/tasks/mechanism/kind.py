"""The plan part of moving a mechanism that the request gives."""

from __future__ import annotations

from collections.abc import Iterator

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.mechanism.given import read_given_mechanism
from service.request.tasks.mechanism import MechanismRequest
from service.setup.prepare import PlanSetup
from service.tasks.kind import PlanPart
from service.tasks.mechanism.plan import choose_hands, list_clearances, plan_mechanism
from service.tasks.mechanism.stance import MechanismStance


class MechanismPlanPart(PlanPart[MechanismRequest]):
    """Moving a mechanism of a URDF."""

    def plan(self, section: MechanismRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans that move the mechanism."""
        return plan_mechanism(setup, solver, section)

    @property
    def has_stances(self) -> bool:
        """Yes."""
        return True

    def find_stance_task(
        self, section: MechanismRequest, setup: PlanSetup, body: WholeBody
    ) -> tuple[MechanismStance, tuple[str, ...]] | str:
        """Return the mechanism to move."""
        given = read_given_mechanism(section)
        hands = choose_hands(body, given)
        note = f"a mechanism of {len(given.mechanism.joints)} joint(s), held at {section.handle.link}"
        return MechanismStance(given, hands, list_clearances(hands, given)), (note,)


PART = MechanismPlanPart()
