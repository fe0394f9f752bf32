"""Where a reach ends: joint positions, a posture or poses of links, as bounds, constraints and promises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint
from service.body.whole_body import WholeBody
from service.demands.goals import AXES, goal_joints, goal_targets, rotation_of
from service.explain.goal import GoalReasons, goal_reasons
from service.explain.keep import never_kept
from service.request.schema import GoalRequest, PoseGoalRequest
from service.verify import Target

AIM = 0.5  # the optimiser keeps to this share of a pose's tolerance, the rest is for the curve and the certificate


@dataclass(frozen=True)
class Goal:
    """What holds at the end of a reach.

    Attributes:
        body: the robot in its scene.
        request: the goal as it was asked for.
        joints: value by coordinate index.
    """

    body: WholeBody
    request: GoalRequest
    joints: Mapping[int, float]

    @property
    def poses(self) -> tuple[PoseGoalRequest, ...]:
        """Poses of links."""
        return self.request.poses

    @staticmethod
    def of(body: WholeBody, request: GoalRequest) -> Goal:
        """The goal of a request; a posture's base stays free, since the feet stand where they stand."""
        return Goal(body, request, goal_joints(body.robot, request))

    @property
    def is_complete(self) -> bool:
        """Whether it names a single configuration."""
        return len(self.joints) == self.body.robot.n

    def applied_to(self, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """A configuration with the goal's joint positions."""
        out = q.copy()
        out[list(self.joints)] = list(self.joints.values())
        return out

    def constraints(self, waypoint: int) -> list[Constraint[MotionState]]:
        """The poses at a waypoint."""
        return [constraint for pose in self.poses for constraint in _pose_constraints(self.body, pose, waypoint)]

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Fix the joints of the last waypoint, in place."""
        for index, value in self.joints.items():
            lower[-1, index] = upper[-1, index] = value

    def targets(self, s_last: float) -> tuple[Target, ...]:
        """What the verifier holds the end of the reach to."""
        return goal_targets(self.body.robot, self.request, s_last)

    def reasons(self) -> GoalReasons:
        """What stands against it before anything is planned."""
        targets = self.targets(0.0)
        reasons = goal_reasons(self.body, targets)
        return replace(reasons, impossible=(*reasons.impossible, *never_kept(self.body, targets)))


def _pose_constraints(body: WholeBody, pose: PoseGoalRequest, waypoint: int) -> list[Constraint[MotionState]]:
    """Position within its tolerance, orientation within its own, one axis of the frame perhaps free."""
    rotation = rotation_of(pose)
    target = np.eye(4)
    target[:3, 3] = pose.position
    if rotation is not None:
        target[:3, :3] = rotation
    where = [waypoint]
    robot = body.robot
    place = FramePose(robot, pose.link, where, target, (True,) * 3 + (False,) * 3)
    constraints = [_within(f"position of {pose.link}", place, pose.position_tolerance_m, "m")]
    tolerance = np.deg2rad(pose.rotation_tolerance_deg)
    if rotation is not None and pose.free_axis == "none":
        turn = FramePose(robot, pose.link, where, target, (False,) * 3 + (True,) * 3)
        constraints.append(_within(f"orientation of {pose.link}", turn, tolerance, "rad"))
    elif rotation is not None:
        axis = np.eye(3)[AXES[pose.free_axis]]
        along = AxisDirection(robot, pose.link, where, axis, rotation @ axis)
        constraints.append(_within(f"axis of {pose.link}", along, tolerance, "rad"))
    return constraints


def _within(name: str, residual: FramePose | AxisDirection, tolerance: float, unit: str) -> Constraint[MotionState]:
    reserve = max((1.0 - AIM) * tolerance, 1e-5)
    return Constraint(name, WithinTolerance(residual, AIM * tolerance), tolerance=reserve, unit=unit)
