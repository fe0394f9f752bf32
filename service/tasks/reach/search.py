"""Reach for a goal from starts that take different ways around the obstacles, until one is certified."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice

import numpy as np
from jaxtyping import Float, Int

from costs.kinematics import locate_frame
from service.body.ladder import LEAST_WAYPOINTS, MotionSearch, Path, find_motion, list_motions
from service.body.paths import bend_path, resample_path
from service.body.phases import PhaseSolver, report_solutions
from service.body.starts import DIRECT, End, Way, choose_policy
from service.body.task_plan import PlannedPhase, Solved, Stuck, TaskPlan
from service.demands.passes import choose_alternative
from service.demands.phase import TaskPhase
from service.demands.targets import make_goal_targets
from service.explain.goal import GoalReasons, find_goal_reasons
from service.request.tasks.reach import GoalRequest
from service.tasks.hints import PhaseHints
from service.tasks.nearby import find_clear_pose
from service.tasks.phase_compiler import PhaseCompiler
from service.tasks.reach.goal import Goal, lead_path
from service.tasks.reach.goal_poses import STEP, GoalEnds, order_goals
from service.tasks.reach.through import list_ways_through, pass_through

RETREAT, REACH, APPROACH = "retreat", "reach", "approach"
RESTORABLE = 10.0  # largest shortfall from which a restoration is tried
TIGHT = 4.5e-3  # clearance of a start or a goal below which a straight phase leads off it [m]
OFF_M = 12e-3  # clearance at the end of that phase [m]


def plan_reach(
    solver: PhaseSolver, request: GoalRequest, n_waypoints: int | None, known: Path | None = None
) -> Iterator[TaskPlan]:
    """Yield a plan of one phase for every start that leads to the goal; the best attempt if none does.

    Of several goals the nearest come first; their starts are tried in turns.

    Args:
        solver: of the robot at its start.
        request: the goal.
        n_waypoints: of every path; as many as its length needs if it is not given.
        known: an earlier motion that led from near the start to near the goal.
    """
    body = solver.body
    goals = [Goal.of(body, part) for part in request.alternatives]
    reasons = [find_goal_reasons(body, goal.targets()) for goal in goals]
    passed = [find_goal_reasons(body, Goal.of(body, part).targets()) for part in request.via]
    refusal = _refuse(reasons, passed)
    if refusal is not None:
        yield TaskPlan(body, (), refusal[0], is_impossible=refusal[1])
        return
    notes = tuple(note for each in reasons for note in each.notes)
    open_goals = [goal for goal, own in zip(goals, reasons, strict=True) if not (own.impossible or own.unresolved)]
    if request.via or len(goals) > 1:
        reaches = [
            Reach(solver, goal, n_waypoints, notes, known=known, whole=request) for goal in order_goals(open_goals)
        ]
        yield from _plan_in_turns(reaches, solver.most_starts)
        return
    reach = Reach(solver, goals[0], n_waypoints, notes, known=known, whole=request)
    solutions: Iterator[tuple[str, Solved]] = islice(reach.list_solutions(), solver.most_starts)
    first = next(solutions)
    if first[1].is_feasible:  # most requests end here
        yield reach.make_plan(*first)
        solutions = (other for other in solutions if other[1].is_feasible or other[1].may_hold)
    else:
        solutions = chain([first], solutions)
    around = reach.leave_tight_ends() if solver.most_starts > 1 else None
    if around is None:
        yield from report_solutions(solutions, reach.make_plan)
        return
    if not first[1].is_feasible:
        yield reach.make_plan(*first)
    yield from report_solutions(islice(around.list_solutions(), solver.most_starts - 1), around.make_plan)


def _refuse(goals: Sequence[GoalReasons], passed: Sequence[GoalReasons]) -> tuple[tuple[str, ...], bool] | None:
    """Return the reasons why no goal, or a place on the way, can be reached, and whether they hold for every motion."""
    for k, place in enumerate(passed):
        if place.impossible or place.unresolved:
            lines = place.impossible or place.unresolved
            return tuple(f"goal.via[{k}]: {line}" for line in lines), bool(place.impossible)
    if not all(goal.impossible or goal.unresolved for goal in goals):
        return None
    is_impossible = all(goal.impossible for goal in goals)
    if len(goals) == 1:
        return goals[0].impossible or goals[0].unresolved, is_impossible
    named = (f"goal.any_of[{k}]: {line}" for k, goal in enumerate(goals) for line in goal.impossible or goal.unresolved)
    return tuple(named), is_impossible


def _plan_in_turns(reaches: Sequence[Reach], most: int) -> Iterator[TaskPlan]:
    """Yield plans of several reaches, one start of each after the other."""
    owners: dict[int, tuple[Reach, Solved]] = {}

    def take_turns() -> Iterator[tuple[str, Solved]]:
        searches = [(reach, reach.list_solutions()) for reach in reaches]
        while searches:
            for entry in list(searches):
                solution = next(entry[1], None)
                if solution is None:
                    searches.remove(entry)
                    continue
                owners[id(solution[1])] = entry[0], solution[1]
                yield solution

    def make_plan(name: str, solved: Solved) -> TaskPlan:
        return owners[id(solved)][0].make_plan(name, solved)

    yield from report_solutions(islice(take_turns(), most), make_plan)


@dataclass(frozen=True)
class Reach:
    """A reach, perhaps between short straight phases that lead off a start and to a goal that nearly touch something.

    Attributes:
        notes: on the goal.
        retreat: from the start to where the reach begins.
        approach: from where the reach ends to the goal, with its targets.
        known: waypoints of an earlier motion.
        whole: the request of the goal, with places on the way.
    """

    solver: PhaseSolver
    goal: Goal
    n_waypoints: int | None
    notes: tuple[str, ...] = ()
    retreat: PlannedPhase | None = None
    approach: PlannedPhase | None = None
    known: Path | None = None
    whole: GoalRequest | None = None

    def list_solutions(self) -> Iterator[tuple[str, Solved]]:
        """Yield solved starts by name, feasible or not."""
        if self.whole is not None and self.whole.via:
            yield from list_ways_through(self.solver, self.goal, self.whole)
            return
        ends = GoalEnds(self.solver, self.goal, None if self.known is None else self.known[-1])
        if ends.miss is not None:
            yield STEP, ends.miss
        yield from list_motions(
            MotionSearch(
                REACH,
                self.solver,
                self._solve,
                self.solver.body.nominal,
                ends,
                choose_policy(self.solver.body.robot),
                self._list_paths(ends),
                self.n_waypoints,
                drawn=self._reaching,
                restorable=0.0 if self.goal.is_complete else RESTORABLE,
            )
        )

    def leave_tight_ends(self) -> Reach | None:
        """Return the reach between configurations off a start and a goal that nearly touch; None where neither does."""
        body, goal = self.solver.body, self.goal
        if body.robot.is_floating or body.kept:
            return None
        retreat = self._lead_off(RETREAT, body.nominal)
        approach = self._lead_off(APPROACH, goal.apply_joints(body.nominal)) if goal.is_complete else None
        if retreat is None and approach is None:
            return None
        moved = body if retreat is None else replace(body, nominal=retreat.q[-1])
        inner = replace(goal, body=moved)
        if approach is not None:
            back = replace(approach, phase=TaskPhase(APPROACH, goal=goal.targets()), q=approach.q[::-1])
            approach, inner = back, replace(inner, joints=dict(enumerate(back.q[0].tolist())))
        return replace(self, solver=replace(self.solver, body=moved), goal=inner, retreat=retreat, approach=approach)

    def _lead_off(self, name: str, q: Float[np.ndarray, "n"]) -> PlannedPhase | None:
        """Return a straight phase to a configuration with more clearance; None where none is needed or found."""
        if self.solver.body.measure_nearest(q) >= TIGHT:
            return None
        off = find_clear_pose(self.solver, name, q, OFF_M)
        if off is None:
            return None
        phase = TaskPhase(name)
        solved = find_motion(replace(self._compiler.search_free(phase, q, off), policy=DIRECT))
        is_usable = solved.is_feasible or solved.may_hold
        return PlannedPhase(phase, solved.x, True, is_tight=True) if is_usable else None

    def make_plan(self, name: str, solved: Solved) -> TaskPlan:
        """Return a solution as the task's plan."""
        is_pose = len(solved.x) == 1
        body = self.solver.body
        q = np.concatenate([body.nominal[None], solved.x]) if is_pose else solved.x
        stuck = Stuck.at(STEP if is_pose else REACH, solved)
        goal = self.goal.targets()
        if self.whole is not None and self.whole.any_of:  # the one that the verifier takes the end for
            part = self.whole.alternatives[choose_alternative(body.robot, self.whole, q[-1])]
            goal = make_goal_targets(body.robot, part, q[-1])
        reach = TaskPhase(REACH, goal=() if self.approach is not None else goal)
        phase = replace(self._compiler.keep(reach, q), is_feasible=solved.is_feasible)
        if self.whole is not None and self.whole.via and solved.is_feasible:
            phase = pass_through(phase, self.solver, self.goal, self.whole)
        if self.retreat is not None:
            body = replace(body, nominal=self.retreat.q[0])
        phases = tuple(own for own in (self.retreat, phase, self.approach) if own is not None)
        return TaskPlan(body, phases, stuck=stuck, found_from=name, notes=self.notes)

    @property
    def _compiler(self) -> PhaseCompiler:
        """The solver of straight phases, and of the reach between ends that are known."""
        return PhaseCompiler(self.solver, hints=lambda phase: PhaseHints(free_waypoints=2, restorable=0.0))

    @cached_property
    def _reaching(self) -> Int[np.ndarray, "k"] | None:
        """Coordinates that lead to the goal's links; None where the goal is not given by poses alone."""
        body, request = self.solver.body, self.goal.request
        if not body.robot.is_floating or self.goal.joints or not request.poses:
            return None
        joints = [locate_frame(body.robot, pose.link)[0] for pose in request.poses]
        return np.flatnonzero(body.engine.topology.supports[joints].any(axis=0))

    def _list_paths(self, ends: GoalEnds) -> dict[Way, Callable[[], Iterable[tuple[str, Path]]]]:
        """Return the paths of the reach by way."""
        paths: dict[Way, Callable[[], Iterable[tuple[str, Path]]]] = {Way.LED: self._lead_links}
        if self.known is not None:
            paths[Way.KNOWN] = lambda: self._bend_known(ends)
        return paths

    def _bend_known(self, ends: GoalEnds) -> Iterator[tuple[str, Path]]:
        """Yield the earlier motion between the new start and the new end."""
        for end in ends.find(End.FIRST, 0):
            if self.known is not None:
                path = bend_path(self.known, self.solver.body.nominal, end)
                count = max(LEAST_WAYPOINTS, len(path)) if self.n_waypoints is None else self.n_waypoints
                yield Way.KNOWN.value, self.solver.body.project_onto_holds(resample_path(path, count))

    def _lead_links(self) -> Iterable[tuple[str, Path]]:
        """Yield the path along straight lines of the goal's links."""
        q = lead_path(self.goal, LEAST_WAYPOINTS if self.n_waypoints is None else self.n_waypoints)
        return () if q is None else (("straight lines of the goal's links", q),)

    def _solve(self, solver: PhaseSolver, path: Path) -> Solved:
        goal, last = self.goal, len(path) - 1
        fixed = {0: path[0], last: path[-1]} if goal.is_complete else {0: path[0]}
        return solver.solve_trajectory(REACH, path, fixed, constraints=goal.constraints(last), bounds=goal.fix_joints)
