"""Reach for a goal from starts that take different ways around the obstacles, until one is certified."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from costs.kinematics import locate_links
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint
from service.body.holds import POSITION, ROTATION, Hold, least_norm_step, linearize_holds
from service.body.phases import (
    PhaseSolver,
    path_via,
    posture_guesses,
    random_guesses,
    report_solutions,
    straight_path,
)
from service.body.sampling import Tree, resample_path
from service.body.task_plan import PlannedPhase, Solved, Stuck, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.targets import AXES, find_goal_joints, make_goal_rotation, make_goal_targets
from service.explain.goal import find_goal_reasons
from service.request.schema import GoalRequest, PoseGoalRequest
from service.verify import Target

LEAST_WAYPOINTS, MOST_WAYPOINTS = 8, 16
WAYPOINT_STEP = 0.15  # of the joint that moves most, between waypoints [rad, m]
# First attempts: another start is faster than more steps, or than waiting for progress.
QUICK: dict[str, float] = {"max_iterations": 20, "patience": 6}
POSE: dict[str, float] = {"patience": 12, "min_improvement_feasible": 0.3}
SAMPLED: dict[str, float] = {"max_iterations": 50, "patience": 8}  # a sampled path is free of collisions already
RANDOM: dict[str, float] = {"max_iterations": 40}  # among the last attempts
LEAD: dict[str, float] = {"max_iterations": 40, "patience": 10}  # after the straight line has failed
# The effort of a search varies with its seed: several short searches are faster than a long one.
TREES = (
    Tree(0, 1000, "LBKPIECE1"),
    Tree(1, 1500, "RRTConnect"),
    Tree(2, 2000, "LBKPIECE1"),
    Tree(3, 4000, "RRTConnect"),
    Tree(4, 4000, "LBKPIECE1"),
    Tree(5, 8000, "RRTConnect"),
)
RESTORABLE = 10.0  # largest shortfall from which a restoration is tried
RANDOM_GUESSES = 8  # about half of them lead to a pose
SAME_END = 0.05  # largest difference of equal ends [rad, m]
AIM = 0.5  # share of a pose's tolerance for the optimiser, the rest is for the curve and the certificate
STEPS = 8  # of the projection from a waypoint onto the holds of the next
CLOSE = 1e-5  # residual at which the projection ends [m, rad]
LARGEST_STEP = 0.3  # of a coordinate in one step, where the next waypoint is out of reach [rad, m]


def plan_reach(solver: PhaseSolver, request: GoalRequest, n_waypoints: int | None) -> Iterator[TaskPlan]:
    """Yield a plan of one phase for every start that leads to the goal; the best attempt if none does."""
    body = solver.body
    goal = Goal.of(body, request)
    reasons = find_goal_reasons(body, goal.targets(0.0))
    if reasons.impossible or reasons.unresolved:
        yield TaskPlan(body, (), reasons.impossible or reasons.unresolved, is_impossible=bool(reasons.impossible))
        return
    search = _ReachSearch(solver, goal, n_waypoints, reasons.notes)
    yield from report_solutions(islice(search.solutions(), solver.most_starts), search.make_plan)


@dataclass(frozen=True)
class _ReachSearch:
    """Starts of one reach, the most promising first, solved on demand."""

    solver: PhaseSolver
    goal: Goal
    n_waypoints: int | None
    notes: tuple[str, ...] = ()

    def solutions(self) -> Iterator[tuple[str, Solved]]:
        """Yield solved starts by name, feasible or not; a near miss is followed by its restoration."""
        for name, solved in self._attempts():
            yield name, solved
            is_near = not solved.is_feasible and solved.shortfall < RESTORABLE
            if is_near and not self.goal.is_complete and len(solved.x) > 1:
                with self.solver.monitor.step("reach", 0.4):
                    restored = self.solver.restore_feasibility("reach", solved)
                yield name, restored

    def _attempts(self) -> Iterator[tuple[str, Solved]]:
        start = self.solver.body.nominal
        ends = self._find_ends()
        end, shortfall = next(ends)
        if shortfall is not None:
            yield "goal pose", shortfall
            yield from self._lead_links()
            yield from self._to_random_postures()
            return
        count = self._count_waypoints(end)
        quick = self._solve(straight_path(start, end, count), **QUICK)
        yield "straight line", quick
        yield from self._around(end, TREES[0])
        if self.solver.body.kept:
            line = self.solver.body.project_onto_holds(straight_path(start, end, count))
            yield "straight line along the kept poses", self._solve(line, **LEAD)
        yield from self._lead_links()
        for other, shortfall in ends:
            if shortfall is None:
                name = "straight line to another posture at the goal"
                yield name, self._solve(straight_path(start, other, self._count_waypoints(other)), **QUICK)
        yield from self._around(end, TREES[1])
        yield from self._around(end, TREES[2])
        for name, posture in posture_guesses(self.solver.body)[1:]:
            yield f"via posture '{name}'", self._solve(path_via(start, posture, end, count), **QUICK)
        yield from self._to_random_postures()
        if not quick.is_feasible:
            yield "straight line", self._solve(quick.x, penalty=quick.result.penalty)
        for tree in TREES[3:]:
            yield from self._around(end, tree)

    def make_plan(self, name: str, solved: Solved) -> TaskPlan:
        """Return a solution as the task's plan."""
        is_pose = len(solved.x) == 1
        q = np.concatenate([self.solver.body.nominal[None], solved.x]) if is_pose else solved.x
        resolve = partial(_solve_again, self.solver)
        phase = PlannedPhase("reach", q, solved.is_feasible, targets=self.goal.targets, resolve=resolve)
        stuck = Stuck.at("goal pose" if is_pose else "reach", solved)
        return TaskPlan(self.solver.body, (phase,), stuck=stuck, found_from=name, notes=self.notes)

    def _count_waypoints(self, end: Float[np.ndarray, "n"]) -> int:
        """Return the number of waypoints to an end."""
        if self.n_waypoints is not None:
            return self.n_waypoints
        farthest = np.abs(end - self.solver.body.nominal).max(initial=0.0)
        return int(np.clip(np.ceil(farthest / WAYPOINT_STEP), LEAST_WAYPOINTS, MOST_WAYPOINTS))

    def _find_ends(self) -> Iterator[tuple[Float[np.ndarray, "n"], Solved | None]]:
        """Yield different configurations at the goal; if there is none, the best attempt with its solve."""
        body, goal = self.solver.body, self.goal
        if goal.is_complete:
            yield goal.apply_joints(body.nominal), None
            return
        ends: list[np.ndarray] = []
        best: Solved | None = None
        for _, guess in posture_guesses(body):
            solved = self._solve_at_goal(guess)
            if not solved.is_feasible:
                best = solved if best is None or solved.shortfall < best.shortfall else best
            elif all(np.abs(solved.x[0] - other).max() > SAME_END for other in ends):
                ends.append(solved.x[0])
                yield solved.x[0], None
        if not ends and best is not None:
            with self.solver.monitor.step("goal pose", 0.1):
                last = self.solver.restore_feasibility("goal pose", best)
            yield last.x[0], None if last.is_feasible else last

    def _solve_at_goal(self, guess: Float[np.ndarray, "n"]) -> Solved:
        """Solve for a configuration at the goal from a guess."""
        goal, brief = self.goal, self.solver.with_settings(**POSE)
        with self.solver.monitor.step("goal pose", 0.1):
            return brief.solve_pose("goal pose", [goal.apply_joints(guess)], goal.constraints(0), fixed=goal.joints)

    def _to_random_postures(self) -> Iterator[tuple[str, Solved]]:
        """Yield straight lines to configurations at the goal that random guesses about the start lead to."""
        body = self.solver.body
        if self.goal.is_complete:
            return
        for guess in random_guesses(body, RANDOM_GUESSES, self.solver.seed):
            solved = self._solve_at_goal(guess)
            if solved.is_feasible:
                end = solved.x[0]
                line = straight_path(body.nominal, end, self._count_waypoints(end))
                yield "straight line to a random posture at the goal", self._solve(line, **RANDOM)

    def _lead_links(self) -> Iterator[tuple[str, Solved]]:
        """Yield the solve from straight lines of the goal's links."""
        q = lead_path(self.goal, LEAST_WAYPOINTS if self.n_waypoints is None else self.n_waypoints)
        if q is not None:
            yield "straight lines of the goal's links", self._solve(q, **LEAD)

    def _around(self, end: Float[np.ndarray, "n"], tree: Tree) -> Iterator[tuple[str, Solved]]:
        """Yield the solve from a sampled path; the path itself where the solve fails and the path does not."""
        with self.solver.monitor.step("sampling", 0.5):
            corners = self.solver.sample_corners(self.solver.body.nominal, end, tree)
        if corners is None:
            return
        path = resample_path(corners, max(self._count_waypoints(end), 2 * len(corners)))
        solved = self._solve(path, **SAMPLED)
        if not solved.is_feasible:
            unchanged = self._solve(path, max_iterations=0)
            solved = unchanged if unchanged.is_feasible else solved
        yield f"path of {tree.planner}, tree {tree.seed + 1}", solved

    def _solve(self, q: Float[np.ndarray, "T n"], **settings: float) -> Solved:
        solver, goal = self.solver.with_settings(**settings), self.goal
        last = len(q) - 1
        fixed = {0: q[0], last: q[-1]} if goal.is_complete else {0: q[0]}
        with self.solver.monitor.step("reach", 0.4):
            return solver.solve_trajectory(
                "reach", [q], fixed, constraints=goal.constraints(last), bounds=goal.fix_joints
            )


def _solve_again(solver: PhaseSolver, q: Float[np.ndarray, "T n"]) -> Solved:
    """Solve a denser trajectory between the same ends."""
    return solver.solve_trajectory("reach", [q], {0: q[0], len(q) - 1: q[-1]})


@dataclass(frozen=True)
class Goal:
    """The goal of a reach.

    Attributes:
        body: the robot in its scene.
        request: the goal's section of the request.
        joints: value by coordinate index.
    """

    body: WholeBody
    request: GoalRequest
    joints: Mapping[int, float]

    @staticmethod
    def of(body: WholeBody, request: GoalRequest) -> Goal:
        """Return a request's goal; a posture's base stays free, since the feet are planted."""
        return Goal(body, request, find_goal_joints(body.robot, request))

    @property
    def is_complete(self) -> bool:
        """Whether it fixes every coordinate."""
        return len(self.joints) == self.body.robot.n

    def apply_joints(self, q: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return a configuration with the goal's joint positions."""
        out = q.copy()
        out[list(self.joints)] = list(self.joints.values())
        return out

    def constraints(self, waypoint: int) -> list[Constraint[MotionState]]:
        """Return the constraints of the goal's poses at a waypoint."""
        return [
            constraint for pose in self.request.poses for constraint in _pose_constraints(self.body, pose, waypoint)
        ]

    def fix_joints(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Fix the goal's joints at the last waypoint, in place."""
        for index, value in self.joints.items():
            lower[-1, index] = upper[-1, index] = value

    def targets(self, s_last: float) -> tuple[Target, ...]:
        """Return the verifier's targets of the reach's end."""
        return make_goal_targets(self.body.robot, self.request, s_last)


def _pose_constraints(body: WholeBody, pose: PoseGoalRequest, waypoint: int) -> list[Constraint[MotionState]]:
    """Return constraints of a link's position and orientation; of the latter perhaps only one axis."""
    rotation = make_goal_rotation(pose)
    target = np.eye(4)
    target[:3, 3] = pose.position
    if rotation is not None:
        target[:3, :3] = rotation
    robot, at = body.robot, [waypoint]
    position = FramePose(robot, pose.link, at, target, POSITION)
    constraints = [_keep_within(f"position of {pose.link}", position, pose.position_tolerance_m, "m")]
    tolerance = np.deg2rad(pose.rotation_tolerance_deg)
    if rotation is not None and pose.free_axis == "none":
        orientation = FramePose(robot, pose.link, at, target, ROTATION)
        constraints.append(_keep_within(f"orientation of {pose.link}", orientation, tolerance, "rad"))
    elif rotation is not None:
        axis = np.eye(3)[AXES[pose.free_axis]]
        direction = AxisDirection(robot, pose.link, at, axis, rotation @ axis)
        constraints.append(_keep_within(f"axis of {pose.link}", direction, tolerance, "rad"))
    return constraints


def _keep_within(
    name: str, residual: FramePose | AxisDirection, tolerance: float, unit: str
) -> Constraint[MotionState]:
    reserve = max((1.0 - AIM) * tolerance, 1e-5)
    return Constraint(name, WithinTolerance(residual, AIM * tolerance), tolerance=reserve, unit=unit)


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
        q.append(_project_within_limits(body, q[-1], (*body.holds(), *make_line_holds(goal, share)), *reserved))
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
    """Return holds of a link's position, and of its orientation as far as its goal gives it."""
    robot, rotation, target = body.robot, make_goal_rotation(pose), np.eye(4)
    target[:3, 3] = (1.0 - share) * first[:3, 3] + share * np.array(pose.position)
    position: Hold = lambda waypoints: FramePose(robot, pose.link, waypoints, target, POSITION)  # noqa: E731
    if rotation is None:
        return (position,)
    target[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix([first[:3, :3], rotation]))(share).as_matrix()
    if pose.free_axis == "none":
        return position, lambda waypoints: FramePose(robot, pose.link, waypoints, target, ROTATION)
    axis = np.eye(3)[AXES[pose.free_axis]]
    return position, lambda waypoints: AxisDirection(robot, pose.link, waypoints, axis, target[:3, :3] @ axis)


def _project_within_limits(
    body: WholeBody,
    q: Float[np.ndarray, "n"],
    holds: Sequence[Hold],
    lower: Float[np.ndarray, "1 n"],
    upper: Float[np.ndarray, "1 n"],
) -> Float[np.ndarray, "n"]:
    """Return a configuration nearer to the holds after a few steps; joints that reach their limit stay there."""
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
