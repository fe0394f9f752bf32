"""The goal of a reach as bounds, constraints and certificate targets, and starting trajectories that lead to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from costs.kinematics import locate_links
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint
from service.body.holds import Hold, least_norm_step, linearize_holds
from service.body.whole_body import WholeBody
from service.demands.targets import AXES, find_goal_joints, make_goal_rotation, make_goal_targets
from service.explain.goal import GoalReasons, find_goal_reasons
from service.explain.keep import find_never_kept
from service.request.schema import GoalRequest, PoseGoalRequest
from service.verify import Target

AIM = 0.5  # the optimiser keeps to this share of a pose's tolerance, the rest is for the curve and the certificate
STEPS = 8  # of the projection from one waypoint onto what holds at the next
CLOSE = 1e-5  # a start need not be closer [m, rad]
LARGEST_STEP = 0.3  # of a coordinate in one step, where the next waypoint is out of reach [rad, m]


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
        return Goal(body, request, find_goal_joints(body.robot, request))

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
        return make_goal_targets(self.body.robot, self.request, s_last)

    def reasons(self) -> GoalReasons:
        """What stands against it before anything is planned."""
        targets = self.targets(0.0)
        reasons = find_goal_reasons(self.body, targets)
        return replace(reasons, impossible=(*reasons.impossible, *find_never_kept(self.body, targets)))


def _pose_constraints(body: WholeBody, pose: PoseGoalRequest, waypoint: int) -> list[Constraint[MotionState]]:
    """Position within its tolerance, orientation within its own, one axis of the frame perhaps free."""
    rotation = make_goal_rotation(pose)
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


PLACE, TURN = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3


PLACE, TURN = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3


def lead_path(goal: Goal, n_waypoints: int) -> Float[np.ndarray, "T n"] | None:
    """Waypoints along which the goal's links go straight from where they are; None where no link has a goal.

    Each is the nearest to the one before that keeps what is held, so that arms do not change their ways between two of
    them. What stands around is left to the optimiser.
    """
    if not goal.poses:
        return None
    body = goal.body
    q, reserved = [body.nominal], body.bounds(1, {})
    for share in np.linspace(0.0, 1.0, n_waypoints)[1:]:
        q.append(_nearest(body, q[-1], (*body.holds(), *ways(goal, share)), *reserved))
    return np.stack(q)


def ways(goal: Goal, share: float) -> tuple[Hold, ...]:
    """What the goal's links hold when they have gone a share of their straight ways."""
    first = locate_links(goal.body.engine, goal.body.nominal, [pose.link for pose in goal.poses])
    return tuple(hold for pose in goal.poses for hold in _way(goal.body, pose, first[pose.link], share))


def _way(body: WholeBody, pose: PoseGoalRequest, first: Float[np.ndarray, "4 4"], share: float) -> tuple[Hold, ...]:
    """Place and orientation of one link; of the latter as much as its goal speaks of."""
    robot, rotation, target = body.robot, make_goal_rotation(pose), np.eye(4)
    target[:3, 3] = (1.0 - share) * first[:3, 3] + share * np.array(pose.position)
    place: Hold = lambda waypoints: FramePose(robot, pose.link, waypoints, target, PLACE)  # noqa: E731
    if rotation is None:
        return (place,)
    target[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix([first[:3, :3], rotation]))(share).as_matrix()
    if pose.free_axis == "none":
        return place, lambda waypoints: FramePose(robot, pose.link, waypoints, target, TURN)
    axis = np.eye(3)[AXES[pose.free_axis]]
    return place, lambda waypoints: AxisDirection(robot, pose.link, waypoints, axis, target[:3, :3] @ axis)


def _nearest(
    body: WholeBody,
    q: Float[np.ndarray, "n"],
    holds: Sequence[Hold],
    lower: Float[np.ndarray, "1 n"],
    upper: Float[np.ndarray, "1 n"],
) -> Float[np.ndarray, "n"]:
    """The holds kept as well as a few steps within the limits do; a joint that meets its limit stays there."""
    row, at_limit = q[None], np.zeros(len(q), dtype=bool)
    for _ in range(STEPS):
        value, jacobian = linearize_holds(body.engine, row, holds)
        if np.abs(value).max() < CLOSE:
            break
        step = least_norm_step(np.where(at_limit, 0.0, jacobian), value)
        moved = row - np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        row = np.clip(moved, lower, upper)
        at_limit |= (row != moved)[0]
    return np.asarray(row[0])
