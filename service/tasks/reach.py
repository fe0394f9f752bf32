"""Reaching a goal: starts that differ in the way they take around what is there, tried until one is certified."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from jaxtyping import Float

from service.body.monitor import Interrupted
from service.body.phases import (
    PhaseSolver,
    PlannedPhase,
    Solved,
    Stuck,
    TaskPlan,
    path_via,
    posture_guesses,
    random_guesses,
    straight_path,
)
from service.body.restore import restore_feasibility
from service.body.sampling import Tree
from service.request.schema import GoalRequest
from service.tasks.goal import Goal, lead_path

LEAST_WAYPOINTS, MOST_WAYPOINTS = 8, 16
WAYPOINT_STEP = 0.15  # of the joint that moves most [rad, m]
# A first try: what needs more steps, or stands still for some, is found sooner from another start.
QUICK: dict[str, float] = {"max_iterations": 20, "patience": 6}
POSE: dict[str, float] = {"patience": 12, "min_improvement_feasible": 0.3}
SAMPLED: dict[str, float] = {"max_iterations": 50, "patience": 8}  # a sampled path is clear from the beginning
RANDOM: dict[str, float] = {"max_iterations": 40}  # among the last: every step is worth it
LED: dict[str, float] = {"max_iterations": 40, "patience": 10}  # where the straight line has failed
# How long a tree takes to find its way is a matter of luck: several short tries beat a long one.
TREES = (
    Tree(0, 1000, "LBKPIECE1"),
    Tree(1, 1500, "RRTConnect"),
    Tree(2, 2000, "LBKPIECE1"),
    Tree(3, 4000, "RRTConnect"),
    Tree(4, 4000, "LBKPIECE1"),
    Tree(5, 8000, "RRTConnect"),
)
RESTORABLE = 10.0  # tolerances that a start may fall short of being feasible for a restoration to be tried
RANDOM_GUESSES = 8  # about half of them lead to a pose
SAME_END = 0.05  # ends that differ by less are one [rad, m]


def plan_reach(solver: PhaseSolver, request: GoalRequest, n_waypoints: int | None) -> Iterator[TaskPlan]:
    """One phase from the start to the goal, as often as a start leads there; one that falls short if none does."""
    body = solver.body
    goal = Goal.of(body, request)
    reasons = goal.reasons()
    if reasons.impossible or reasons.unresolved:
        yield TaskPlan(body, (), reasons.impossible or reasons.unresolved, is_impossible=bool(reasons.impossible))
        return
    search = _Search(solver, goal, n_waypoints, reasons.notes)
    best: tuple[str, Solved] | None = None
    is_found = False
    try:
        for name, solved in islice(search.solutions(), solver.most_starts):
            if solved.is_feasible:
                is_found = True
                yield search.plan(name, solved)
            elif best is None or solved.shortfall < best[1].shortfall:
                best = name, solved
    except Interrupted:
        if not is_found and best is not None:
            yield search.plan(*best)
        raise
    if not is_found and best is not None:
        yield search.plan(*best)


@dataclass(frozen=True)
class _Search:
    """The starts of one reach, the most promising first, and what the optimiser makes of them."""

    solver: PhaseSolver
    goal: Goal
    n_waypoints: int | None
    notes: tuple[str, ...] = ()

    def solutions(self) -> Iterator[tuple[str, Solved]]:
        """Solved starts by name, feasible or not; every one asked for costs its solve."""
        for name, solved in self._attempts():
            yield name, solved
            is_near = not solved.is_feasible and solved.shortfall < RESTORABLE
            if is_near and not self.goal.is_complete and len(solved.x) > 1:
                yield name, self._restored(solved)

    def _attempts(self) -> Iterator[tuple[str, Solved]]:
        start = self.solver.body.nominal
        ends = self._ends()
        end, shortfall = next(ends)
        if shortfall is not None:
            yield "goal pose", shortfall
            yield from self._led()
            yield from self._to_random_postures()
            return
        count = self._count(end)
        quick = self._solve(straight_path(start, end, count), **QUICK)
        yield "straight line", quick
        yield from self._around(end, TREES[0])
        if self.solver.body.kept:
            line = self.solver.body.on_holds(straight_path(start, end, count))
            yield "straight line along what is kept", self._solve(line, **LED)
        yield from self._led()
        for other, shortfall in ends:
            if shortfall is None:
                name = "straight line to another posture at the goal"
                yield name, self._solve(straight_path(start, other, self._count(other)), **QUICK)
        yield from self._around(end, TREES[1])
        yield from self._around(end, TREES[2])
        for name, posture in posture_guesses(self.solver.body)[1:]:
            yield f"via posture '{name}'", self._solve(path_via(start, posture, end, count), **QUICK)
        yield from self._to_random_postures()
        if not quick.is_feasible:
            yield "straight line", self._solve(quick.x, penalty=quick.result.penalty)
        for tree in TREES[3:]:
            yield from self._around(end, tree)

    def _restored(self, solved: Solved) -> Solved:
        """Once more from where a solve has failed, for nothing but what must hold."""
        with self.solver.monitor.step("reach", 0.4):
            return restore_feasibility(self.solver, "reach", solved)

    def plan(self, name: str, solved: Solved) -> TaskPlan:
        """A solution as a task's plan."""
        is_pose = len(solved.x) == 1
        q = np.concatenate([self.solver.body.nominal[None], solved.x]) if is_pose else solved.x
        phase = PlannedPhase(
            "reach", q, solved.is_feasible, targets=self.goal.targets, resolve=partial(_resolve, self.solver)
        )
        stuck = Stuck.at("goal pose" if is_pose else "reach", solved)
        return TaskPlan(self.solver.body, (phase,), stuck=stuck, found_from=name, notes=self.notes)

    def _count(self, end: Float[np.ndarray, "n"]) -> int:
        """Waypoints on the way to an end."""
        if self.n_waypoints is not None:
            return self.n_waypoints
        farthest = np.abs(end - self.solver.body.nominal).max(initial=0.0)
        return int(np.clip(np.ceil(farthest / WAYPOINT_STEP), LEAST_WAYPOINTS, MOST_WAYPOINTS))

    def _ends(self) -> Iterator[tuple[Float[np.ndarray, "n"], Solved | None]]:
        """Configurations at the goal that differ; if there is none, the best and in what it falls short."""
        body, goal = self.solver.body, self.goal
        if goal.is_complete:
            yield goal.applied_to(body.nominal), None
            return
        found: list[np.ndarray] = []
        worst: Solved | None = None
        for _, guess in posture_guesses(body):
            solved = self._at_goal(guess)
            if not solved.is_feasible:
                worst = solved if worst is None or solved.shortfall < worst.shortfall else worst
            elif all(np.abs(solved.x[0] - other).max() > SAME_END for other in found):
                found.append(solved.x[0])
                yield solved.x[0], None
        if not found and worst is not None:
            with self.solver.monitor.step("goal pose", 0.1):
                last = restore_feasibility(self.solver, "goal pose", worst)
            yield last.x[0], None if last.is_feasible else last

    def _at_goal(self, guess: Float[np.ndarray, "n"]) -> Solved:
        """The goal's pose from a guess."""
        goal, brief = self.goal, self.solver.with_settings(**POSE)
        with self.solver.monitor.step("goal pose", 0.1):
            return brief.pose("goal pose", [goal.applied_to(guess)], goal.constraints(0), fixed=goal.joints)

    def _to_random_postures(self) -> Iterator[tuple[str, Solved]]:
        """Straight to configurations at the goal that random guesses about the start lead to."""
        body = self.solver.body
        if self.goal.is_complete:
            return
        for guess in random_guesses(body, RANDOM_GUESSES, self.solver.seed):
            solved = self._at_goal(guess)
            if solved.is_feasible:
                end = solved.x[0]
                line = straight_path(body.nominal, end, self._count(end))
                yield "straight line to a random posture at the goal", self._solve(line, **RANDOM)

    def _led(self) -> Iterator[tuple[str, Solved]]:
        """From the straight ways of the links that shall arrive."""
        q = lead_path(self.goal, LEAST_WAYPOINTS if self.n_waypoints is None else self.n_waypoints)
        if q is not None:
            yield "straight way of what shall arrive", self._solve(q, **LED)

    def _around(self, end: Float[np.ndarray, "n"], tree: Tree) -> Iterator[tuple[str, Solved]]:
        """From the path of a sampling planner: optimised, and as it is where that fails."""
        with self.solver.monitor.step("sampling", 0.5):
            seeded = replace(tree, seed=tree.seed + self.solver.seed)
            path = self.solver.sample_start(self.solver.body.nominal, end, self._count(end), seeded)
        if path is None:
            return
        name = f"path of {tree.planner}, tree {tree.seed + 1}"
        solved = self._solve(path, **SAMPLED)
        if not solved.is_feasible:  # a path that cannot be made smoother or clearer is still a way
            as_it_is = self._solve(path, max_iterations=0)
            solved = as_it_is if as_it_is.is_feasible else solved
        yield name, solved

    def _solve(self, q: Float[np.ndarray, "T n"], **settings: float) -> Solved:
        solver, goal = self.solver.with_settings(**settings), self.goal
        last = len(q) - 1
        fixed = {0: q[0], last: q[-1]} if goal.is_complete else {0: q[0]}
        with self.solver.monitor.step("reach", 0.4):
            return solver.trajectory("reach", [q], fixed, constraints=goal.constraints(last), bounds=goal.bound)


def _resolve(solver: PhaseSolver, q: Float[np.ndarray, "T n"]) -> Solved:
    """A denser trajectory between the same ends."""
    return solver.trajectory("reach", [q], {0: q[0], len(q) - 1: q[-1]})
