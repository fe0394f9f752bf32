"""The plan part of moving from stance to stance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.demands.rest.earlier_motion import read_earlier_motion
from service.request.schema import PlanRequest
from service.request.tasks.contacts import ContactsRequest
from service.setup.prepare import PlanSetup
from service.setup.world import Surroundings
from service.tasks.contacts.displaced import displace_contacts
from service.tasks.contacts.known_poses import make_known_poses
from service.tasks.contacts.motion import plan_contact_motion
from service.tasks.kind import PlanPart


class ContactsPlanPart(PlanPart[ContactsRequest]):
    """Moving from stance to stance."""

    @property
    def leaves_start(self) -> bool:
        """No: the first stance holds the robot."""
        return False

    def plan(self, section: ContactsRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield the plan through all stances."""
        robot, resume = setup.robot, setup.request.resume
        earlier = read_earlier_motion(robot, None if resume is None else resume.nominal, np.zeros(robot.n))
        known = make_known_poses(robot, section, earlier)
        finish = None if section.finish is None else robot.postures[section.finish]
        yield plan_contact_motion(solver, setup.stances, finish, known)

    def displace(
        self, request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
    ) -> tuple[PlanRequest, Surroundings | None]:
        """Displace the next place of a patch, or an obstacle with all contacts on it."""
        assert isinstance(request.section, ContactsRequest)
        return displace_contacts(request, request.section, target, offset), around


PART = ContactsPlanPart()
