"""The demand part of getting out of a vehicle."""

from __future__ import annotations

from service.demands.contacts.stances import ContactStance
from service.demands.egress.demand import EgressDemand
from service.demands.kind import DemandPart, Shown
from service.demands.task_demand import World
from service.request.tasks.egress import EgressRequest


class EgressDemandPart(DemandPart[EgressRequest]):
    """Getting out of a vehicle."""

    def make_demand(self, section: EgressRequest, world: World, shown: Shown, program: object) -> EgressDemand:
        """Return the demands of the request's phases."""
        return EgressDemand.of(section, world.robot, world.scene, world.start, world.request.folder)

    def list_stances(self, section: EgressRequest, world: World) -> tuple[ContactStance, ...]:
        """Return the stance at the start; planning finds the others."""
        return (EgressDemand.of(section, world.robot, world.scene, world.start, world.request.folder).seat(),)


PART = EgressDemandPart()
