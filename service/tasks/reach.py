"""Reaching joint positions, a posture, or poses of links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint
from service.phases import PhaseSolver, PlannedPhase, Solved, Targets, TaskPlan, guesses, straight, via
from service.reachability import beyond_reach
from service.request import GoalRequest, PoseGoalRequest
from service.start import collisions
from service.verify import AxisTarget, JointTarget, PoseTarget, Target
from service.whole_body import WholeBody

WAYPOINTS = 16
JOINT_TOLERANCE = 1e-3  # promised at the goal [rad, m]
SMALLEST_SHIFT, SMALLEST_TURN = 1e-4, 1e-3  # tolerances below these are beyond the optimiser's [m, rad]
AIM = 0.5  # the optimiser keeps to this share of a pose's tolerance, the rest is for the curve and the certificate
AXES = {"x": 0, "y": 1, "z": 2}


def plan_reach(solver: PhaseSolver, goal: GoalRequest, n_waypoints: int | None) -> TaskPlan:
    """One phase from the start to the goal."""
    body, monitor = solver.body, solver.monitor
    count = WAYPOINTS if n_waypoints is None else n_waypoints
    start = body.nominal
    joints = _joint_goal(body, goal)
    is_complete = len(joints) == body.robot.n
    impossible = _impossible(body, goal, joints)
    if impossible:
        return TaskPlan(body, (), impossible, is_impossible=True)
    end = _with_joints(start, joints)
    if not is_complete:
        with monitor.step("goal pose", 0.1):
            tasks = [constraint for pose in goal.poses for constraint in _pose_constraints(body, pose, 0)]
            candidates = [_with_joints(guess, joints) for guess in guesses(body)]
            found = solver.pose("goal pose", candidates, tasks, fixed=joints)
        end = found.x[0]
        if not found.is_feasible:
            attempt = PlannedPhase("reach", np.stack([start, end]), False)
            return TaskPlan(body, (attempt,), found.shortcomings("goal pose"))

    def at_goal(lower: np.ndarray, upper: np.ndarray) -> None:
        for index, value in joints.items():
            lower[-1, index] = upper[-1, index] = value

    starts = [straight(start, end, count)]
    starts += [via(start, guess, end, count) for guess in guesses(body)[1:]]

    def solve(by: PhaseSolver, from_starts: Sequence[Float[np.ndarray, "T n"]]) -> Solved:
        last = len(from_starts[0]) - 1
        return by.trajectory(
            "reach",
            from_starts,
            {0: start, last: end} if is_complete else {0: start},
            constraints=[c for pose in goal.poses for c in _pose_constraints(body, pose, last)],
            bounds=at_goal,
        )

    notes: tuple[str, ...] = ()
    with monitor.step("reach", 0.4):
        reach = solve(solver, starts)
    if not reach.is_feasible:
        with monitor.step("reach around", 0.5):
            for sampled in solver.sampled_starts(start, end, count):
                around = solve(solver, [sampled])
                if not around.is_feasible:  # a path that cannot be made smoother or clearer is still a way
                    around = solve(solver.as_it_is(), [sampled])
                if around.is_feasible:
                    reach, notes = around, ("found from the start of a sampling planner",)
                    break

    def resolve(q: Float[np.ndarray, "T n"]) -> Solved:
        return solver.trajectory("reach", [q], {0: q[0], len(q) - 1: q[-1]})

    phase = PlannedPhase("reach", reach.x, reach.is_feasible, targets=_targets(body, goal, joints), resolve=resolve)
    return TaskPlan(body, (phase,), () if reach.is_feasible else reach.shortcomings("reach"), notes=notes)


def _targets(body: WholeBody, goal: GoalRequest, joints: Mapping[int, float]) -> Targets:
    """What the verifier holds the end of the reach to."""

    def targets(s_last: float) -> tuple[Target, ...]:
        named = body.robot.joint_names
        return (
            *(JointTarget(named[index], value, JOINT_TOLERANCE, s_last) for index, value in joints.items()),
            *(target for pose in goal.poses for target in _pose_targets(pose, s_last)),
        )

    return targets


def _impossible(body: WholeBody, goal: GoalRequest, joints: Mapping[int, float]) -> tuple[str, ...]:
    """Reasons that hold for every motion: a target beyond the chain, a complete goal in collision."""
    reasons = [beyond_reach(body, pose.link, np.array(pose.position), pose.position_tolerance_m) for pose in goal.poses]
    lines = [reason for reason in reasons if reason is not None]
    if len(joints) == body.robot.n:
        end = _with_joints(body.nominal, joints)
        inside = collisions(body.robot, end, body.scene, [foot.link for foot in body.planted])
        lines += [f"the goal is in collision: {line}" for line in inside]
    return tuple(lines)


def _with_joints(q: Float[np.ndarray, "n"], joints: Mapping[int, float]) -> Float[np.ndarray, "n"]:
    """A configuration with some coordinates replaced."""
    out = q.copy()
    out[list(joints)] = list(joints.values())
    return out


def _joint_goal(body: WholeBody, goal: GoalRequest) -> Mapping[int, float]:
    """Goal value by coordinate index; a posture's base stays free, since the feet stand where they stand."""
    robot = body.robot
    if goal.posture is None:
        return {robot.joint_names.index(name): value for name, value in goal.joints.items()}
    posture = robot.postures[goal.posture]
    first = len(BASE_NAMES) if robot.is_floating else 0
    return {index: float(posture[index]) for index in range(first, robot.n)}


def _rotation(pose: PoseGoalRequest) -> Float[np.ndarray, "3 3"] | None:
    if pose.quaternion_wxyz is None:
        return None
    return np.asarray(Rotation.from_quat(pose.quaternion_wxyz, scalar_first=True).as_matrix())


def _pose_constraints(body: WholeBody, pose: PoseGoalRequest, waypoint: int) -> list[Constraint[MotionState]]:
    """Position within its tolerance, orientation within its own, one axis of the frame perhaps free."""
    rotation = _rotation(pose)
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


def _pose_targets(pose: PoseGoalRequest, at: float) -> tuple[Target, ...]:
    """What the verifier holds the end to: a pose, or a place and the direction of the axis that is not free."""
    rotation = _rotation(pose)
    turn = max(np.deg2rad(pose.rotation_tolerance_deg), SMALLEST_TURN)
    place = np.full(3, max(pose.position_tolerance_m, SMALLEST_SHIFT))
    position = np.asarray(pose.position, dtype=float)
    if rotation is None or pose.free_axis == "none":
        return (PoseTarget(pose.link, position, rotation, place, np.full(3, turn), at),)
    axis = np.eye(3)[AXES[pose.free_axis]]
    return (
        PoseTarget(pose.link, position, None, place, np.full(3, np.inf), at),
        AxisTarget(pose.link, axis, rotation @ axis, turn, at),
    )
