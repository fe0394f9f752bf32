"""The demand part of a list of steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.demands.kind import DemandPart, Shown
from service.demands.mechanism.given import GivenMechanism
from service.demands.mechanism.kind import read_given_physics
from service.demands.plausible import list_mechanism_problems
from service.demands.resistance import MechanismPhysics
from service.demands.steps.blends import list_blend_problems
from service.demands.steps.demand import StepsDemand
from service.demands.steps.extent import Extent
from service.demands.steps.faces import explain_beyond_edge
from service.demands.steps.holding import Holding, list_sequence_problems
from service.demands.steps.moved import MovedParts
from service.demands.steps.names import list_step_problems
from service.demands.task_demand import World
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.request.tasks.steps import StepsSection


class StepsDemandPart(DemandPart[StepsSection]):
    """Steps one after the other."""

    def make_demand(self, section: StepsSection, world: World, shown: Shown, program: object) -> StepsDemand:
        """Return the steps as a demand.

        Raises:
            RequestError: the list contradicts itself.
        """
        problems = (*list_sequence_problems(section), *list_blend_problems(section))
        if problems:
            raise RequestError(problems)
        return StepsDemand(section, Holding.of(section, world.request, world.robot, world.scene))

    def list_name_problems(self, section: StepsSection, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield a line per unknown hand, frame, joint or posture of a step."""
        yield from list_sequence_problems(section)
        yield from list_blend_problems(section)
        try:
            start = Holding.of(section, request, robot, Scene(()))
        except RequestError as error:
            yield from error.problems
            return
        for named in Extent.of(section).done:
            yield from list_step_problems(start, named.step, f"task.steps[{named.index}]", request)

    def list_given_problems(
        self, section: StepsSection, robot: RobotModel, start: Float[np.ndarray, "n"], obstacles: Sequence[ConvexPiece]
    ) -> Iterator[str]:
        """Yield a line for each moving part that is inside what stands still."""
        for index, given in MovedParts.of(section).distinct.items():
            if section.steps[index].mechanism is not None:  # a part that is pressed goes into its wall
                for problem in list_mechanism_problems(given, obstacles):
                    yield problem.replace("task.mechanism", f"task.steps[{index}].mechanism")
        known = {piece.name: piece for piece in obstacles}
        for named in Extent.of(section).done:
            follow = named.step.follow
            if follow is not None and set(follow.face.pieces) <= known.keys():  # a scan's pieces end where it ends
                beyond = explain_beyond_edge(follow, [known[name] for name in follow.face.pieces])
                if beyond is not None:
                    yield f"task.steps[{named.index}].follow: {beyond}"

    def read_mechanisms(self, section: StepsSection) -> tuple[GivenMechanism, ...]:
        """Return what the steps push, as it is at the start."""
        return tuple(MovedParts.of(section).distinct.values())

    def read_physics(self, section: StepsSection) -> MechanismPhysics:
        """Return masses, friction and springs of what the steps push."""
        return read_given_physics(self.read_mechanisms(section))


PART = StepsDemandPart()
