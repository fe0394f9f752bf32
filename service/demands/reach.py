"""Demands of a reach: its goal at the end of the motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from costs.robot import RobotModel
from service.demands.kind import DemandPart, Shown
from service.demands.passes import choose_alternative, find_passes
from service.demands.phase import TaskPhase
from service.demands.targets import make_goal_targets
from service.demands.task_demand import RecordDemand, TaskDemand, World
from service.errors import RequestError, would_do
from service.request.schema import PlanRequest
from service.request.tasks.reach import GoalPartRequest, GoalRequest
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
        """Demand the goal of the last phase, and what it passes on the way."""
        # A joint without limits may arrive after any number of turns: its goal is the one near the recorded end.
        reached = recorded.curve.positions[-1, : world.robot.n]
        part = self.goal.alternatives[choose_alternative(world.robot, self.goal, reached)]
        goal = make_goal_targets(world.robot, part, reached)
        *before, last = recorded.phases
        passes = find_passes(world.robot, self.goal, recorded, last)
        phases = (*(TaskPhase(phase.name) for phase in before), TaskPhase(last.name, goal=goal, passes=passes))
        return RecordDemand(phases)


class ReachDemandPart(DemandPart[GoalRequest]):
    """A reach."""

    def make_demand(self, section: GoalRequest, world: World, shown: Shown, program: object) -> ReachDemand:
        """Return the goal as a demand."""
        return ReachDemand(section)

    def list_name_problems(self, section: GoalRequest, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield the goal's unknown names and impossible values."""
        for name, part in section.list_parts():
            yield from _list_name_problems(f"goal.{name}", part, request, robot)


def _list_name_problems(field: str, part: GoalPartRequest, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
    """Yield the unknown names and impossible values of one part of a goal; ``field`` ends with a dot."""
    locked = [name for name in part.joints if name in request.robot.locked]
    yield from (f"{field}joints.{name}: robot.locked fixes this joint; name it in one of them" for name in locked)
    free = {name: value for name, value in part.joints.items() if name not in locked}
    try:
        free = leave_out_followers(robot, free, None, f"{field}joints")
    except RequestError as error:
        yield from error.problems
    unknown = find_unknown_joints(robot, free, f"{field}joints")
    yield from unknown or find_limit_violations(robot, free, f"{field}joints", SNAP_TOLERANCE)
    if part.posture is not None and part.posture not in robot.postures:
        known = would_do(part.posture, robot.postures) or f"no postures; give {field}joints"
        yield f"unknown posture {part.posture!r} in {field}posture; {robot.name} has {known}"
    for index, pose in enumerate(part.poses):
        yield from find_unknown_links(robot, (pose.link,), f"{field}poses[{index}].link")
        if pose.relative_to is None:
            continue
        yield from find_unknown_links(robot, (pose.relative_to,), f"{field}poses[{index}].relative_to")
        model = robot.model
        both = [name for name in (pose.link, pose.relative_to) if model.existFrame(name)]
        if len(both) == 2 and len({model.frames[model.getFrameId(name)].parentJoint for name in both}) == 1:
            yield (
                f"{field}poses[{index}].relative_to: {pose.relative_to} moves with {pose.link}: no motion "
                "changes the pose between them; expected the world or another link"
            )


PART = ReachDemandPart()
