"""Reach for a goal from starts that take different ways around the obstacles, until one is certified."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, count, islice

import numpy as np
from jaxtyping import Float, Int

from costs.kinematics import locate_frame
from costs.scene import ConvexPiece, Scene
from service.body.phases import (
    PhaseSolver,
    path_via,
    posture_guesses,
    random_guesses,
    report_solutions,
    straight_path,
)
from service.body.sampling import Tree, measure_length, resample_path
from service.body.task_plan import PlannedPhase, Solved, Stuck, TaskPlan
from service.body.trees import ARM_TREES, LARGE_TREES, MOST_ARM_JOINTS, TREES
from service.body.whole_body import SAMPLING_CLEARANCE, WholeBody
from service.explain.goal import find_goal_reasons
from service.request.tasks.reach import GoalRequest
from service.start.standing import FLOOR_KIND
from service.tasks.reach.goal import Goal, lead_path
from service.tasks.reach.goal_poses import bring_to_goal, find_random_ends, is_new_end, solve_at_goal

LEAST_WAYPOINTS, MOST_WAYPOINTS = 8, 16
WAYPOINT_STEP = 0.15  # of the joint that moves most, between waypoints [rad, m]
# First attempts: another start is faster than more steps, or than waiting for progress. Steps of a feasible path that
# gain less than a tenth of its merit shorten it by half a percent.
QUICK: dict[str, float] = {
    "max_iterations": 20,
    "patience": 6,
    "acceptable_steps": 2,
    "min_improvement_feasible": 0.1,
}
SAMPLED: dict[str, float] = {"max_iterations": 50, "patience": 8}  # a sampled path is free of collisions already
RANDOM: dict[str, float] = {"max_iterations": 40}  # among the last attempts
LEAD: dict[str, float] = {"max_iterations": 40, "patience": 10}  # after the straight line has failed
MOST_NARROW = 400  # waypoints of such a path
MOST_HELD = 40  # waypoints of a path of a standing robot
HELD_SHARE = 0.2  # of the checks of a tree whose poses are brought onto the holds, which take ten times longer
CHECKS_TO_OTHER_END, CHECKS_AMONG_SHRUNKEN = 2000, 4000  # of trees beside these
RESTORABLE = 10.0  # largest shortfall from which a restoration is tried
RANDOM_GUESSES = 8  # about half of them lead to a pose
FIRST_DRAWS, FIRST_ENDS = 2, 3  # of random ends where no posture leads to the goal
ENDS_PER_ROUND = 3
MOST_CHECKS = 40_000  # of one tree: some seconds
SHRINK = (0.8, 0.6, 0.4)  # sizes of shrunken obstacles
EXPLAIN_RESERVE_S, EXPLAIN_SHARE = 10.0, 0.2
TIGHTENINGS = 3
DENSER = 3  # times the waypoints of a path that was not solved
LONG = 1.15  # length of a path, relative to the straight line, from which shortcuts are tried
SHORTER = 0.97  # of the length before, from which another solve is worth it
TIGHT = 4.5e-3  # clearance of a start or a goal below which a straight phase leads off it [m]
RETREAT = 12e-3  # clearance at the end of that phase [m]


def plan_reach(solver: PhaseSolver, request: GoalRequest, n_waypoints: int | None) -> Iterator[TaskPlan]:
    """Yield a plan of one phase for every start that leads to the goal; the best attempt if none does."""
    body = solver.body
    goal = Goal.of(body, request)
    reasons = find_goal_reasons(body, goal.targets(0.0))
    if reasons.impossible or reasons.unresolved:
        yield TaskPlan(body, (), reasons.impossible or reasons.unresolved, is_impossible=bool(reasons.impossible))
        return
    search = _ReachSearch(solver, goal, n_waypoints, reasons.notes)
    solutions: Iterator[tuple[str, Solved]] = islice(search.solutions(), solver.most_starts)
    first = next(solutions)
    if first[1].is_feasible:  # most requests end here
        yield search.make_plan(*first)
        solutions = (other for other in solutions if other[1].is_feasible or other[1].may_hold)
    else:
        solutions = chain([first], solutions)
    around = _leave_tight_ends(solver, goal, n_waypoints, reasons.notes) if solver.most_starts > 1 else None
    if around is None:
        yield from report_solutions(solutions, search.make_plan)
        return
    if not first[1].is_feasible:
        yield search.make_plan(*first)
    yield from report_solutions(islice(around.solutions(), solver.most_starts - 1), around.make_plan)


def _leave_tight_ends(
    solver: PhaseSolver, goal: Goal, n_waypoints: int | None, notes: tuple[str, ...]
) -> _ReachSearch | None:
    """Return a search between configurations off a start and a goal that nearly touch; None where neither does.

    A short straight phase leads from the start to the first, another one from the last to the goal.
    """
    body = solver.body
    if body.robot.is_floating or body.kept:
        return None
    start, end = body.nominal, goal.apply_joints(body.nominal) if goal.is_complete else None
    with solver.monitor.step("reach", 0.2):
        first = solver.move_clear("retreat", start, RETREAT) if body.measure_nearest(start) < TIGHT else None
        last = None
        if end is not None and body.measure_nearest(end) < TIGHT:
            last = solver.move_clear("approach", end, RETREAT)
    if first is None and last is None:
        return None
    moved = body if first is None else replace(body, nominal=first)
    inner = goal if last is None else replace(goal, joints=dict(enumerate(last.tolist())))
    inner = replace(inner, body=moved)
    own = replace(solver, body=moved)
    return _ReachSearch(
        own, inner, n_waypoints, notes, None if first is None else start, None if last is None else goal
    )


@dataclass(frozen=True)
class _ReachSearch:
    """Starts of one reach, the most promising first, solved on demand.

    Attributes:
        notes: on the goal.
        retreat_from: (n,) start of the robot, where the reach begins a little off it.
        approach_to: goal of the request, where the reach ends a little off it.
    """

    solver: PhaseSolver
    goal: Goal
    n_waypoints: int | None
    notes: tuple[str, ...] = ()
    retreat_from: Float[np.ndarray, "n"] | None = None
    approach_to: Goal | None = None

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
        waypoints = self._count_waypoints(end)
        quick = self._solve(straight_path(start, end, waypoints), **QUICK)
        yield "straight line", quick
        is_standing = self.solver.body.robot.is_floating
        if not is_standing:  # on its feet a robot needs trees seldom, and they take longer
            yield from self._around(end, TREES[0])
        if self.solver.body.kept:
            line = self.solver.body.project_onto_holds(straight_path(start, end, waypoints))
            yield "straight line along the kept poses", self._solve(line, **LEAD)
        yield from self._lead_links()
        for other, shortfall in ends:
            if shortfall is None:
                name = "straight line to another posture at the goal"
                yield name, self._solve(straight_path(start, other, self._count_waypoints(other)), **QUICK)
        trees = TREES if is_standing else TREES[1:]
        n_early = 0 if is_standing else 3
        if self._is_small_arm and self.goal.is_complete:
            trees, n_early = ARM_TREES[1:], len(ARM_TREES) - 1
        for tree in trees[:n_early]:
            yield from self._around(end, tree)
        for name, posture in posture_guesses(self.solver.body)[1:]:
            yield f"via posture '{name}'", self._solve(path_via(start, posture, end, waypoints), **QUICK)
        yield from self._to_random_postures()
        if not quick.is_feasible:
            yield "straight line", self._solve(quick.x, penalty=quick.result.penalty)
        for tree in trees[n_early:]:
            yield from self._around(end, tree)
        yield from self._search_on([end])

    def _search_on(self, ends: list[Float[np.ndarray, "n"]]) -> Iterator[tuple[str, Solved]]:
        """Yield attempts with more ends, larger trees and shrunken obstacles until little time is left."""
        solver, body = self.solver, self.solver.body
        limit = solver.monitor.time_limit_s
        reserve = min(EXPLAIN_RESERVE_S, EXPLAIN_SHARE * limit)  # for the explanation of why nothing was found
        checks = LARGE_TREES[0].most_checks
        other = Tree(0, CHECKS_TO_OTHER_END, keeps_holds=bool(body.kept))
        shrunken = replace(other, most_checks=CHECKS_AMONG_SHRUNKEN)
        for number in count(len(TREES)):
            if not self.goal.is_complete:
                for end in islice(find_random_ends(solver, self.goal, ends, 1, number), ENDS_PER_ROUND):
                    waypoints = self._count_waypoints(end)
                    yield (
                        "straight line to a random posture at the goal",
                        self._solve(straight_path(body.nominal, end, waypoints), **QUICK),
                    )
                    yield from self._around(end, replace(other, seed=number))
                    if solver.monitor.remaining_s() < reserve:
                        return
            end = ends[number % len(ends)]
            yield from self._through_shrunken(end, replace(shrunken, seed=number), SHRINK[number % len(SHRINK)])
            if solver.monitor.remaining_s() < reserve:
                return
            large = replace(LARGE_TREES[number % len(LARGE_TREES)], seed=number, most_checks=checks)
            if body.kept or (body.robot.is_floating and number % 2):
                large = replace(large, most_checks=int(HELD_SHARE * checks), keeps_holds=True)
            yield from self._around(end, large)
            if solver.monitor.remaining_s() < reserve:
                return
            checks = min(checks * 3 // 2, MOST_CHECKS)

    def _through_shrunken(self, end: Float[np.ndarray, "n"], tree: Tree, share: float) -> Iterator[tuple[str, Solved]]:
        """Yield the solve from a path among smaller obstacles, which the optimiser moves out of the true ones."""
        body = self.solver.body
        corners = self._sample(end, tree, replace(body, scene=shrink_scene(body.scene, share)))
        if corners is None:
            return
        solved = self._solve(resample_path(corners, self._count_along(corners, end)), **SAMPLED)
        if not solved.is_feasible and solved.shortfall < RESTORABLE:
            solved = self.solver.restore_feasibility("reach", solved)
        yield f"path among obstacles of {100.0 * share:.0f} % size, tree {tree.seed + 1}", solved

    def make_plan(self, name: str, solved: Solved) -> TaskPlan:
        """Return a solution as the task's plan."""
        is_pose = len(solved.x) == 1
        q = np.concatenate([self.solver.body.nominal[None], solved.x]) if is_pose else solved.x
        resolve = partial(_solve_again, self.solver)
        goal = self.goal if self.approach_to is None else self.approach_to
        stuck = Stuck.at("goal pose" if is_pose else "reach", solved)
        body, phases = self.solver.body, []
        if self.retreat_from is not None:
            body = replace(body, nominal=self.retreat_from)
            phases.append(PlannedPhase("retreat", np.stack([self.retreat_from, q[0]]), True, is_tight=True))
        phase = PlannedPhase("reach", q, solved.is_feasible, resolve=resolve)
        if self.approach_to is None:
            phases.append(replace(phase, targets=goal.targets))
        else:
            line = np.stack([q[-1], goal.apply_joints(q[-1])])
            phases += [phase, PlannedPhase("approach", line, True, targets=goal.targets, is_tight=True)]
        return TaskPlan(body, tuple(phases), stuck=stuck, found_from=name, notes=self.notes)

    @cached_property
    def _keeps_holds(self) -> bool:
        """Whether more than free joints has to move: on planted feet the base, with kept poses whatever they need."""
        return self.solver.body.robot.is_floating or bool(self.solver.body.kept)

    @property
    def _is_small_arm(self) -> bool:
        """Whether all that moves is a few joints, so that their space can be searched."""
        return not self.solver.body.robot.is_floating and self.solver.body.robot.n <= MOST_ARM_JOINTS

    def _count_waypoints(self, end: Float[np.ndarray, "n"]) -> int:
        """Return the number of waypoints to an end."""
        if self.n_waypoints is not None:
            return self.n_waypoints
        farthest = np.abs(end - self.solver.body.nominal).max(initial=0.0)
        return int(np.clip(np.ceil(farthest / WAYPOINT_STEP), LEAST_WAYPOINTS, MOST_WAYPOINTS))

    @cached_property
    def _reaching(self) -> Int[np.ndarray, "k"] | None:
        """Coordinates that lead to the goal's links; None where the goal is not given by poses alone."""
        body, request = self.solver.body, self.goal.request
        if self.goal.joints or not request.poses:
            return None
        joints = [locate_frame(body.robot, pose.link)[0] for pose in request.poses]
        return np.flatnonzero(body.engine.topology.supports[joints].any(axis=0))

    def _count_along(self, corners: Float[np.ndarray, "K n"], end: Float[np.ndarray, "n"]) -> int:
        """Return the number of waypoints of a sampled path; that of a standing robot has many corners already."""
        least = self._count_waypoints(end)
        if not self._keeps_holds:
            return max(least, 2 * len(corners))
        steps = np.abs(np.diff(corners, axis=0)).max(axis=1).sum() / WAYPOINT_STEP
        return int(np.clip(np.ceil(steps), least, max(least, MOST_HELD)))

    def _find_ends(self) -> Iterator[tuple[Float[np.ndarray, "n"], Solved | None]]:
        """Yield different configurations at the goal; if there is none, the best attempt with its solve."""
        body, goal = self.solver.body, self.goal
        if goal.is_complete:
            yield goal.apply_joints(body.nominal), None
            return
        ends: list[np.ndarray] = []
        best: Solved | None = None
        for guess in chain(bring_to_goal(body, goal), (posture for _, posture in posture_guesses(body))):
            solved = solve_at_goal(self.solver, goal, guess)
            if not solved.is_feasible:
                best = solved if best is None or solved.shortfall < best.shortfall else best
            elif is_new_end(solved.x[0], ends):
                ends.append(solved.x[0])
                yield solved.x[0], None
        if not ends:
            for end in islice(find_random_ends(self.solver, goal, ends, FIRST_DRAWS), FIRST_ENDS):
                yield end, None
        if not ends and best is not None:
            with self.solver.monitor.step("goal pose", 0.1):
                last = self.solver.restore_feasibility("goal pose", best)
            yield last.x[0], None if last.is_feasible else last

    def _to_random_postures(self) -> Iterator[tuple[str, Solved]]:
        """Yield straight lines to configurations at the goal that random guesses about the start lead to."""
        body = self.solver.body
        if self.goal.is_complete:
            return
        for guess in random_guesses(body, RANDOM_GUESSES, self.solver.seed):
            solved = solve_at_goal(self.solver, self.goal, guess)
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
        corners = self._sample(end, tree, replace(self.solver.body, sampled_clearance=tree.clearance))
        if corners is None:
            return
        name, waypoints = f"path of {tree.planner}, tree {tree.seed + 1}", self._count_along(corners, end)
        solved = self._solve_sampled(resample_path(corners, waypoints))
        if solved.may_hold and not solved.is_feasible:
            yield name, solved
        if not solved.is_feasible and self.n_waypoints is None:
            # The hull of a long step may contain what the step itself goes around.
            denser = self._solve_sampled(resample_path(corners, DENSER * waypoints))
            solved = denser if denser.is_feasible else solved
        if not solved.is_feasible and self.n_waypoints is None and tree.clearance < SAMPLING_CLEARANCE:
            narrow = self._solve_narrow(corners, tree)
            solved = narrow if narrow.is_feasible else solved
        if solved.is_feasible:
            solved = self._tighten(solved, tree)
        yield name, solved

    def _sample(self, end: Float[np.ndarray, "n"], tree: Tree, body: WholeBody) -> Float[np.ndarray, "K n"] | None:
        """Return a sampled path from the start to an end; None where no tree finds one.

        On planted feet base and legs go straight along the feet while the limbs that lead to the goal's links are
        drawn, or all of the robot is drawn, with ten times the effort.
        """
        solver = replace(self.solver, body=body)
        with solver.monitor.step("sampling", 0.5):
            if tree.keeps_holds or not body.robot.is_floating:
                return solver.sample_corners(body.nominal, end, tree)
            if body.kept:
                return None
            return solver.sample_carried(body.nominal, end, tree, self._reaching)

    def _solve_narrow(self, corners: Float[np.ndarray, "K n"], tree: Tree) -> Solved:
        """Return the solve from a path with little clearance: with a small margin, and in steps like its checks."""
        body = self.solver.body
        aims = replace(body.aims, margin=min(body.aims.margin, tree.clearance))
        narrow = replace(self, solver=replace(self.solver, body=replace(body, aims=aims)))
        length = float(np.abs(np.diff(corners, axis=0)).max(axis=1).sum())
        waypoints = int(np.ceil(length / tree.edge_step)) + len(corners)
        most = DENSER * MOST_HELD if self._keeps_holds else MOST_NARROW
        return narrow._solve_sampled(resample_path(corners, min(waypoints, most)))

    def _solve_sampled(self, path: Float[np.ndarray, "T n"]) -> Solved:
        """Return the solve from a sampled path; the path itself where only that is feasible, or may hold."""
        solved = self._solve(path, **SAMPLED)
        if solved.is_feasible:
            return solved
        unchanged = self._solve(path, max_iterations=0)
        return unchanged if unchanged.is_feasible or (unchanged.may_hold and not solved.may_hold) else solved

    def _tighten(self, solved: Solved, tree: Tree) -> Solved:
        """Return a shorter solution found from shortcuts between the waypoints, or the solution as it is."""
        for attempt in range(TIGHTENINGS):
            before = measure_length(solved.x)
            if before <= LONG * np.linalg.norm(solved.x[-1] - solved.x[0]):
                break
            with self.solver.monitor.step("sampling", 0.5):
                corners = self.solver.shorten_path(solved.x, tree.seed + attempt, keeps_holds=self._keeps_holds)
            if measure_length(corners) > SHORTER * before:
                break
            shorter = self._solve(resample_path(corners, len(solved.x)), **SAMPLED)
            if not shorter.is_feasible or measure_length(shorter.x) > SHORTER * before:
                break
            solved = shorter
        return solved

    def _solve(self, q: Float[np.ndarray, "T n"], **settings: float) -> Solved:
        solver, goal = self.solver.with_settings(**settings), self.goal
        last = len(q) - 1
        fixed = {0: q[0], last: q[-1]} if goal.is_complete else {0: q[0]}
        with self.solver.monitor.step("reach", 0.4):
            return solver.solve_trajectory(
                "reach", [q], fixed, constraints=goal.constraints(last), bounds=goal.fix_joints
            )


def shrink_scene(scene: Scene, share: float) -> Scene:
    """Return a scene whose pieces, floors aside, are smaller about their centres."""

    def shrink(piece: ConvexPiece) -> ConvexPiece:
        if piece.kind == FLOOR_KIND:
            return piece
        centre = 0.5 * (piece.lower + piece.upper)
        return ConvexPiece(piece.name, centre + share * (piece.vertices - centre), piece.kind)

    return Scene(tuple(shrink(piece) for piece in scene.pieces))


def _solve_again(solver: PhaseSolver, q: Float[np.ndarray, "T n"]) -> Solved:
    """Solve a denser trajectory between the same ends."""
    return solver.solve_trajectory("reach", [q], {0: q[0], len(q) - 1: q[-1]})
