"""Demands of a reach: its goal at the end of the motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from costs.robot import RobotModel
from service.demands.kind import DemandPart, Shown
from service.demands.phase import TaskPhase
from service.demands.targets import make_goal_targets
from service.demands.task_demand import RecordDemand, TaskDemand, World
from service.errors import RequestError, would_do
from service.request.schema import PlanRequest
from service.request.tasks.reach import GoalRequest
from service.start.configuration import (
    SNAP_TOLERANCE,
    find_limit_violations,
    find_unknown_joints,
    find_unknown_links,
)
from service.start.followers import leave_out_followers
from service.verify import Motion


@dataclass(frozen=True)
class ReachDemand(TaskDemand):
    """A goal at the end of the last phase."""

    goal: GoalRequest

    @property
    def keeps_motion(self) -> bool:
        """No: a reach is searched anew."""
        return False

    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Demand the goal of the last phase."""
        # A joint without limits may arrive after any number of turns: its goal is the one near the recorded end.
        reached = recorded.curve.positions[-1, : world.robot.n]
        *before, last = (phase.name for phase in recorded.phases)
        goal = make_goal_targets(world.robot, self.goal, reached)
        return RecordDemand((*(TaskPhase(name) for name in before), TaskPhase(last, goal=goal)))


class ReachDemandPart(DemandPart[GoalRequest]):
    """A reach."""

    def make_demand(self, section: GoalRequest, world: World, shown: Shown, program: object) -> ReachDemand:
        """Return the goal as a demand."""
        return ReachDemand(section)

    def list_name_problems(self, section: GoalRequest, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield the goal's unknown names and impossible values."""
        locked = [name for name in section.joints if name in request.robot.locked]
        yield from (f"goal.joints.{name}: robot.locked fixes this joint; name it in one of them" for name in locked)
        free = {name: value for name, value in section.joints.items() if name not in locked}
        try:
            free = leave_out_followers(robot, free, None, "goal.joints")
        except RequestError as error:
            yield from error.problems
        unknown = find_unknown_joints(robot, free, "goal.joints")
        yield from unknown or find_limit_violations(robot, free, "goal.joints", SNAP_TOLERANCE)
        if section.posture is not None and section.posture not in robot.postures:
            known = would_do(section.posture, robot.postures) or "no postures; give goal.joints"
            yield f"unknown posture {section.posture!r} in goal.posture; {robot.name} has {known}"
        for index, pose in enumerate(section.poses):
            yield from find_unknown_links(robot, (pose.link,), f"goal.poses[{index}].link")


PART = ReachDemandPart()
