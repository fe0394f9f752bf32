"""``task.pick_place`` as the steps that it stands for: grasp, lift, carry, lower, release."""

from __future__ import annotations

from collections.abc import Iterator

from costs.robot import RobotModel
from service.demands.grasping.objects import find_object
from service.demands.kind import DemandPart, Shown
from service.demands.steps.demand import StepsDemand
from service.demands.steps.holding import Holding, choose_grippers
from service.demands.task_demand import World
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.request.tasks.hand_steps import MoveStep, ShiftRequest
from service.request.tasks.pick_place import PickRequest
from service.request.tasks.reach import PoseGoalRequest
from service.request.tasks.step_objects import GraspStep, ReleaseStep
from service.request.tasks.steps import StepRequest, StepsSection

FIELD = "task.pick_place"
GRASP, LIFT, CARRY, LOWER, RELEASE = "grasp", "lift", "carry", "lower", "release"


def list_pick_steps(section: PickRequest, request: PlanRequest) -> StepsSection:
    """Return the steps of taking an object and putting it elsewhere.

    Raises:
        RequestError: there is no such object.
    """
    given, _ = find_object(request, section.object, f"{FIELD}.object")
    name, turned = section.object, section.to.quaternion_wxyz or given.quaternion_wxyz
    x, y, z = section.to.position
    over = PoseGoalRequest(name, (x, y, z + section.lift_m), turned)
    down = PoseGoalRequest(name, (x, y, z), turned)
    up = ShiftRequest((0.0, 0.0, section.lift_m))
    return StepsSection(
        (
            StepRequest(
                GRASP,
                grasp=GraspStep(name, section.hand, force_n=section.grip_n, opening_m=section.opening_m),
            ),
            StepRequest(LIFT, move=MoveStep(by=up, frame=name, along="line")),
            StepRequest(CARRY, move=MoveStep(poses=(over,))),
            StepRequest(LOWER, move=MoveStep(poses=(down,), along="line")),
            StepRequest(RELEASE, release=ReleaseStep(name, opening_m=section.opening_m)),
        )
    )


class PickPlaceDemandPart(DemandPart[PickRequest]):
    """Taking an object and putting it elsewhere."""

    def make_demand(self, section: PickRequest, world: World, shown: Shown, program: object) -> StepsDemand:
        """Return the demands on the object."""
        steps = list_pick_steps(section, world.request)
        return StepsDemand(steps, Holding.of(steps, world.request, world.robot, world.scene))

    def list_name_problems(self, section: PickRequest, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield a line where the scene has no such object, or the robot no such hand."""
        try:
            find_object(request, section.object, f"{FIELD}.object")
            choose_grippers(robot, section.hand, f"{FIELD}.hand")
        except RequestError as error:
            yield from error.problems


PART = PickPlaceDemandPart()
