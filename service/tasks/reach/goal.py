"""The goal of a reach: joints and link poses as constraints, as holds along straight lines, and as targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.collision import Contacts
from costs.kinematics import locate_links
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, Joined, NormWithin, WithinTolerance
from scopt import Constraint
from service.body.holds import POSITION, ROTATION, Hold, project_within_limits
from service.body.regions import lead_into, limit_goal
from service.body.whole_body import WholeBody
from service.demands.phase import EndTarget
from service.demands.regions import find_axis, make_goal_region
from service.demands.targets import find_goal_joints, make_goal_rotation, make_goal_targets
from service.request.tasks.reach import GoalPartRequest, GoalRequest, PoseGoalRequest

# Part of a pose's tolerance that the optimiser leaves to its own inaccuracy: a share of it, and no more than is needed.
RESERVE_SHARE, MOST_RESERVE = 0.5, {"m": 2.5e-3, "rad": 0.02}


@dataclass(frozen=True)
class Goal:
    """The goal of a reach.

    Attributes:
        body: the robot in its scene.
        request: the goal's section of the request.
        joints: value by coordinate index.
    """

    body: WholeBody
    request: GoalRequest | GoalPartRequest
    joints: Mapping[int, float]

    @staticmethod
    def of(body: WholeBody, request: GoalRequest | GoalPartRequest) -> Goal:
        """Return a request's goal; a posture's base stays free, since the feet are planted."""
        return Goal(body, request, find_goal_joints(body.robot, request, body.nominal))

    @property
    def is_complete(self) -> bool:
        """Whether it fixes every coordinate."""
        return len(self.joints) == self.body.robot.n

    def apply_joints(self, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return a configuration with the goal's joint positions."""
        out = q.copy()
        out[list(self.joints)] = list(self.joints.values())
        return out

    def constraints(self, waypoint: int, label: str = "") -> list[Constraint[MotionState]]:
        """Return the constraints of the goal's poses at a waypoint; ``label`` ends their names."""
        own = (each for pose in self.request.poses for each in _pose_constraints(self.body, pose, waypoint))
        return [replace(constraint, name=constraint.name + label) for constraint in own]

    def fix_joints(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Fix the goal's joints at the last waypoint, in place."""
        for index, value in self.joints.items():
            lower[-1, index] = upper[-1, index] = value

    def targets(self) -> tuple[EndTarget, ...]:
        """Return the verifier's targets of the reach's end."""
        return make_goal_targets(self.body.robot, self.request, self.body.nominal)


def _pose_constraints(body: WholeBody, pose: PoseGoalRequest, waypoint: int) -> list[Constraint[MotionState]]:
    """Return constraints of a link's region, or of its position and orientation, perhaps of one axis alone."""
    if not pose.is_plain:
        return limit_goal(body.robot, make_goal_region(pose), waypoint)
    rotation = _find_limited_rotation(pose)
    target = np.eye(4)
    target[:3, 3] = pose.origin
    if rotation is not None:
        target[:3, :3] = rotation
    robot, at = body.robot, [waypoint]
    position = FramePose(robot, pose.link, at, target, POSITION)
    constraints = [_keep_within(f"position of {pose.link}", position, 3, pose.position_tolerance_m, "m")]
    tolerance = np.deg2rad(pose.rotation_tolerance_deg)
    axis = find_axis(pose.free_axis)
    if rotation is not None and axis is None:
        orientation = FramePose(robot, pose.link, at, target, ROTATION)
        constraints.append(_keep_within(f"orientation of {pose.link}", orientation, 3, tolerance, "rad"))
    elif rotation is not None and axis is not None:
        direction = AxisDirection(robot, pose.link, at, axis, rotation @ axis)
        constraints.append(_keep_within(f"axis of {pose.link}", direction, 2, tolerance, "rad"))
    return constraints


def _find_limited_rotation(pose: PoseGoalRequest) -> Float[np.ndarray, "3 3"] | None:
    """Return the requested orientation; None where any is within its tolerance."""
    return None if pose.rotation_tolerance_deg >= 180.0 else make_goal_rotation(pose)


def _keep_within(
    name: str, residual: FramePose | AxisDirection, k: int, tolerance: float, unit: str
) -> Constraint[MotionState]:
    """Return a constraint on the norm of ``k`` rows.

    A small ball counts as the cube in it: limits of single rows are met in half of the steps, since a norm has one
    direction at a time.  In a large ball the optimiser needs the room, and the norm is smooth where it binds.
    """
    reserve = min(RESERVE_SHARE * tolerance, MOST_RESERVE[unit])
    aim = tolerance - reserve
    limits: WithinTolerance[MotionState] | Joined[MotionState]
    if reserve < MOST_RESERVE[unit]:
        side = 1.0 / np.sqrt(k)
        limits, reserve = WithinTolerance(residual, side * aim), side * reserve
    else:
        limits = Joined([WithinTolerance(residual, aim), NormWithin(residual, k, aim)])
    return Constraint(name, limits, tolerance=max(reserve, 1e-5), unit=unit)


def lead_path(goal: Goal, n_waypoints: int) -> Float[np.ndarray, "T n"] | None:
    """Return waypoints that lead the goal's links along straight lines; None where no link has a goal.

    Each is the nearest to the one before that keeps the holds, so that arms do not change branch between them.
    Obstacles are left to the optimiser.
    """
    if not goal.request.poses:
        return None
    body = goal.body
    q, reserved = [body.nominal], body.bounds(1, {})
    for share in np.linspace(0.0, 1.0, n_waypoints)[1:]:
        holds = (*body.holds(), *make_line_holds(goal, share))
        q.append(project_within_limits(body.engine, q[-1][None], holds, *reserved)[0])
    return np.stack(q)


def make_line_holds(goal: Goal, share: float) -> tuple[Hold, ...]:
    """Return holds of the goal's links at a share of their straight lines."""
    first = locate_links(goal.body.engine, goal.body.nominal, [pose.link for pose in goal.request.poses])
    return tuple(
        hold for pose in goal.request.poses for hold in _make_link_holds(goal.body, pose, first[pose.link], share)
    )


def _make_link_holds(
    body: WholeBody, pose: PoseGoalRequest, first: Float[np.ndarray, "4 4"], share: float
) -> tuple[Hold, ...]:
    """Return holds of a link's position, and of its orientation as far as its goal gives it; or of its region."""
    from scipy.spatial.transform import Rotation, Slerp  # slow to import

    if not pose.is_plain:
        at_first = MotionState(body.engine(body.nominal[None]), Contacts.none())
        return lead_into(body.robot, make_goal_region(pose), at_first, share)
    robot, rotation, target = body.robot, _find_limited_rotation(pose), np.eye(4)
    target[:3, 3] = (1.0 - share) * first[:3, 3] + share * np.array(pose.origin)
    position: Hold = lambda waypoints: FramePose(robot, pose.link, waypoints, target, POSITION)  # noqa: E731
    if rotation is None:
        return (position,)
    target[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix([first[:3, :3], rotation]))(share).as_matrix()
    axis = find_axis(pose.free_axis)
    if axis is None:
        return position, lambda waypoints: FramePose(robot, pose.link, waypoints, target, ROTATION)
    return position, lambda waypoints: AxisDirection(robot, pose.link, waypoints, axis, target[:3, :3] @ axis)
