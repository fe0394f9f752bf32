"""The plan part of a problem file."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from costs.rotation import quaternion_matrix
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.request.tasks.trajopt import ProblemSection
from service.setup.prepare import PlanSetup
from service.start.overlaps import find_overlaps
from service.tasks.kind import PlanPart, RequestedEnd
from service.tasks.trajopt.program import plan_program
from service.trajopt.problem import PoseTerm
from service.verify import JointTarget, PoseTarget, Target

FREE = np.full(3, np.inf)


class ProblemPlanPart(PlanPart[ProblemSection]):
    """A problem file."""

    @property
    def leaves_start(self) -> bool:
        """No: the waypoints of a problem include the start."""
        return False

    def plan(self, section: ProblemSection, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans that solve the problem."""
        assert setup.program is not None
        return plan_program(solver, setup.program)

    def get_end(self, section: ProblemSection, setup: PlanSetup) -> RequestedEnd | None:
        """Return the first fixed waypoint after the start that overlaps something, else the last, and the poses."""
        program = setup.program
        assert program is not None
        fixed = [q for step, q in sorted(program.fixed.items()) if step]
        hit = [q for q in fixed if find_overlaps(setup.robot, q, setup.scene, tuple(setup.soles))]
        poses = [
            (term.frame, np.array(term.xyz), _read_rotation(term) if all(term.rot_coeffs) else None)
            for term in program.problem.terms
            if isinstance(term, PoseTerm) and not term.is_cost and term.reference is None and not any(term.offset_xyz)
        ]
        targets: list[Target] = [PoseTarget(frame, place, turn, FREE, FREE, 0.0) for frame, place, turn in poses]
        shown = [*hit[:1], *fixed[-1:]]
        if not shown:
            return RequestedEnd(tuple(targets), None, tuple(poses))
        q, names = shown[0], setup.robot.joint_names
        targets += [JointTarget(names[column], float(q[column]), 0.0, 0.0) for column in program.columns.tolist()]
        return RequestedEnd(tuple(targets), q)


def _read_rotation(term: PoseTerm) -> Float[np.ndarray, "3 3"]:
    return quaternion_matrix(term.wxyz)


PART = ProblemPlanPart()
