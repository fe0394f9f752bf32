"""The demand part of a problem file."""

from __future__ import annotations

from costs.robot import RobotModel
from service.demands.kind import DemandPart, ResolvedStart, Shown
from service.demands.program import ProgramDemand
from service.demands.task_demand import World
from service.request.schema import PlanRequest
from service.request.tasks.trajopt import ProblemSection
from service.trajopt.program import Program
from service.trajopt.request import make_program
from service.trajopt.verifier_targets import make_program_demand


class ProblemDemandPart(DemandPart[ProblemSection]):
    """A problem file."""

    def make_demand(
        self, section: ProblemSection, world: World, shown: Shown, program: Program | None
    ) -> ProgramDemand:
        """Return the demands of the problem's steps."""
        assert program is not None  # resolve_start made it
        return make_program_demand(program, world.robot)

    def resolve_start(self, section: ProblemSection, request: PlanRequest, robot: RobotModel) -> ResolvedStart:
        """Return the start of the problem."""
        program, notes = make_program(request, section.document, robot)
        return ResolvedStart(program.start, notes, program)


PART = ProblemDemandPart()
