"""A start that leads what shall arrive straight to its goal, with everything else that is held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from costs.kinematics import planted_poses
from costs.terms import AxisDirection, FramePose
from service.body.holds import Hold, least_norm, linearized
from service.body.whole_body import WholeBody
from service.demands.goals import AXES, rotation_of
from service.request.schema import PoseGoalRequest
from service.tasks.goal import Goal

STEPS = 8  # of the projection from one waypoint onto what holds at the next
CLOSE = 1e-5  # a start need not be closer [m, rad]
LARGEST_STEP = 0.3  # of a coordinate in one step, where the next waypoint is out of reach [rad, m]
PLACE, TURN = (True,) * 3 + (False,) * 3, (False,) * 3 + (True,) * 3


def led(goal: Goal, n_waypoints: int) -> Float[np.ndarray, "T n"] | None:
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
    first = planted_poses(goal.body.engine, goal.body.nominal, [pose.link for pose in goal.poses])
    return tuple(hold for pose in goal.poses for hold in _way(goal.body, pose, first[pose.link], share))


def _way(body: WholeBody, pose: PoseGoalRequest, first: Float[np.ndarray, "4 4"], share: float) -> tuple[Hold, ...]:
    """Place and orientation of one link; of the latter as much as its goal speaks of."""
    robot, rotation, target = body.robot, rotation_of(pose), np.eye(4)
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
        value, jacobian = linearized(body.engine, row, holds)
        if np.abs(value).max() < CLOSE:
            break
        step = least_norm(np.where(at_limit, 0.0, jacobian), value)
        moved = row - np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        row = np.clip(moved, lower, upper)
        at_limit |= (row != moved)[0]
    return np.asarray(row[0])
