"""The plan part of a reach."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.aims import Aims
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.targets import make_goal_rotation
from service.request.schema import PlanRequest
from service.request.tasks.reach import GoalRequest
from service.setup.prepare import PlanSetup
from service.setup.world import Surroundings
from service.tasks.kind import PlanPart, RequestedEnd, check_displaceable, displace_place
from service.tasks.reach.goal import Goal
from service.tasks.reach.search import plan_reach


class ReachPlanPart(PlanPart[GoalRequest]):
    """A reach."""

    def plan(self, section: GoalRequest, setup: PlanSetup, solver: PhaseSolver) -> Iterator[TaskPlan]:
        """Yield plans that lead to the goal."""
        return plan_reach(solver, section, setup.request.options.waypoints, setup.known)

    def get_end(self, section: GoalRequest, setup: PlanSetup) -> RequestedEnd:
        """Return the goal's joints and poses."""
        body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims())
        goal = Goal.of(body, section.alternatives[0])
        poses = tuple(
            (pose.link, np.array(pose.origin), make_goal_rotation(pose))
            for pose in goal.request.poses
            if pose.relative_to is None and pose.position is not None
        )
        return RequestedEnd(goal.targets(), goal.apply_joints(setup.start) if goal.joints else None, poses)

    def displace(
        self, request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
    ) -> tuple[PlanRequest, Surroundings | None]:
        """Displace the pose of a link."""
        assert request.goal is not None
        placed = [pose.link for pose in request.goal.poses if pose.relative_to is None and pose.position is not None]
        check_displaceable(target, placed)
        poses = tuple(
            replace(pose, position=displace_place(pose.origin, offset)) if pose.link == target else pose
            for pose in request.goal.poses
        )
        return replace(request, goal=replace(request.goal, poses=poses)), around


PART = ReachPlanPart()
