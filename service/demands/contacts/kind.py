"""The demand part of moving from stance to stance."""

from __future__ import annotations

from collections.abc import Iterator

from costs.robot import RobotModel
from service.demands.contacts.contact_task import make_stances
from service.demands.contacts.demand import ContactsDemand
from service.demands.contacts.stances import ContactStance
from service.demands.kind import DemandPart, Shown
from service.demands.task_demand import World
from service.errors import would_do
from service.request.schema import PlanRequest
from service.request.tasks.contacts import ContactsRequest


class ContactsDemandPart(DemandPart[ContactsRequest]):
    """Moving from stance to stance."""

    def make_demand(self, section: ContactsRequest, world: World, shown: Shown, program: object) -> ContactsDemand:
        """Return the demands of the request's stances."""
        stances = self.list_stances(section, world)
        return ContactsDemand(stances, world.scene, dict(section.surfaces), section.finish is not None)

    def list_name_problems(self, section: ContactsRequest, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield a line where the posture to end in is unknown."""
        if section.finish is not None and section.finish not in robot.postures:
            known = would_do(section.finish, robot.postures) or "no postures; leave it out"
            yield f"task.contacts.finish: unknown posture {section.finish!r}; {robot.name} has {known}"

    def list_stances(self, section: ContactsRequest, world: World) -> tuple[ContactStance, ...]:
        """Return all stances, that of the start first."""
        return make_stances(section, world.robot, world.scene, world.start)


PART = ContactsDemandPart()
