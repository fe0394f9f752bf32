"""The demand part of taking an object and putting it elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

from costs.robot import RobotModel
from service.demands.grasping.objects import find_object
from service.demands.kind import DemandPart, Shown
from service.demands.pick_place.demand import PickPlaceDemand
from service.demands.pick_place.work import FIELD, PickPlace, choose_grippers
from service.demands.task_demand import World
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.request.tasks.pick_place import PickRequest


class PickPlaceDemandPart(DemandPart[PickRequest]):
    """Taking an object and putting it elsewhere."""

    def make_demand(self, section: PickRequest, world: World, shown: Shown, program: object) -> PickPlaceDemand:
        """Return the demands on the object."""
        work = PickPlace.of(section, world.request, world.robot, world.scene)
        return PickPlaceDemand(work, choose_grippers(world.robot, section))

    def list_name_problems(self, section: PickRequest, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield a line where the scene has no such object, or the robot no such hand."""
        try:
            find_object(request, section.object, f"{FIELD}.object")
            choose_grippers(robot, section)
        except RequestError as error:
            yield from error.problems


PART = PickPlaceDemandPart()
