"""The plan part of opening a door."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.request.tasks.door import DoorRequest
from service.request.tasks.registry import TaskRequest
from service.setup.prepare import PlanSetup
from service.setup.world import Surroundings
from service.tasks.door.plan import (
    choose_hands,
    find_door,
    find_narrow_lever,
    find_shut,
    list_clearances,
    plan_door,
)
from service.tasks.door.stance import DoorStance
from service.tasks.kind import PlanPart, check_displaceable, displace_place

TARGET = "door"  # leaf and handle together


class DoorPlanPart(PlanPart[DoorRequest]):
    """Opening a door."""

    def plan(self, section: DoorRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans that open the door."""
        return plan_door(setup, solver, section)

    @property
    def has_stances(self) -> bool:
        """Yes."""
        return True

    def find_stance_task(
        self, section: DoorRequest, setup: PlanSetup, body: WholeBody
    ) -> tuple[DoorStance, tuple[str, ...]] | str:
        """Return the door to open."""
        found = find_door(setup, section)
        if isinstance(found, str):
            return found
        door, note = found
        hands = choose_hands(body, section, door)
        shut = find_shut(section, door) or find_narrow_lever(body, door, hands)
        if shut is not None:
            return shut
        target = float(np.deg2rad(section.open_deg))
        return DoorStance.of(setup.robot, door, hands, target, list_clearances(hands, door)), (note,)

    def displace(
        self, request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
    ) -> tuple[PlanRequest, Surroundings | None]:
        """Displace leaf and handle of the request, or as its scan shows them."""
        check_displaceable(target, [TARGET])
        door = request.section
        if isinstance(door, DoorRequest) and door.leaf is not None:
            hinge, edge = (displace_place(place, offset) for place in (door.leaf.hinge, door.leaf.edge))
            handle = door.handle
            handle = None if handle is None else replace(handle, centre=displace_place(handle.centre, offset))
            given = replace(door, leaf=replace(door.leaf, hinge=hinge, edge=edge), handle=handle)
            return replace(request, task=TaskRequest(door=given)), around
        if around is None or not around.doors:
            raise RequestError("adjust: the earlier plan recorded no door")
        return request, around.move_door(offset)


PART = DoorPlanPart()
