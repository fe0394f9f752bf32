"""Solver of single phases: poses and trajectories of a whole body, and sampled paths."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance, BodyRef
from costs.collision import Contacts
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms.rolling import roll_path
from scopt import Constraint, Cost, Problem, Settings
from service.body.effort import Effort
from service.body.forces.loaded_regions import PlannedRegion
from service.body.holds import project_onto_holds
from service.body.monitor import Interrupted, Monitor
from service.body.paths import straight_path
from service.body.poses import PoseProblem
from service.body.sampling import (
    HeldProblem,
    SamplingProblem,
    Tree,
    free_coordinates,
    sample_path,
    shorten_polyline,
)
from service.body.task_plan import LEAST_CLEARANCE, Solved, TaskPlan, keeps_constraints
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.request.fields import HAND_FRICTION

CARRIER_POINTS = 17  # of the way of the limbs that carry the robot
MOST_SEEDS = 4  # of a pose, unless its problem says otherwise
MOST_STARTS = 1000  # of a step, unless the request limits them
Terms = Callable[[str, RobotModel, int], Sequence[Cost[MotionState] | Constraint[MotionState]]]
"""The caller's own terms, given a phase's name, the robot and the number of waypoints."""

Bounds = Callable[[Float[np.ndarray, "T n"], Float[np.ndarray, "T n"]], None]
"""Narrows lower and upper bounds in place."""

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""Calls a function for every item and returns the results in order, as ``map`` does."""


def no_terms(phase: str, robot: RobotModel, n_waypoints: int) -> Sequence[Cost[MotionState] | Constraint[MotionState]]:
    """Return no terms: the caller of a plan adds none."""
    return ()


@dataclass(frozen=True)
class PhaseSolver:
    """Solves poses and trajectories of one body under one monitor.

    Attributes:
        body: the robot in its scene.
        monitor: of the plan.
        settings: of the optimiser.
        overrides: ``(body, other body, margin)`` for pairs with another required clearance [m].
        most_starts: limit of starts per step.
        seed: of random draws.
        terms: the caller's own, added to every pose and trajectory.
        map: calls a function for every one of many independent poses, in order; an executor's does so side by side.
        hand_friction: least and largest coefficient between hands and what they move.
    """

    body: WholeBody
    monitor: Monitor
    settings: Settings
    overrides: tuple[tuple[BodyRef, BodyRef, float], ...] = ()
    most_starts: int = MOST_STARTS
    seed: int = 0
    terms: Terms = no_terms
    map: Map = map
    hand_friction: tuple[float, float] = HAND_FRICTION

    @property
    def most_seeds(self) -> int:
        """Largest number of seeds of a pose, unless its problem says otherwise."""
        return min(MOST_SEEDS, self.most_starts)

    def pose_problem(
        self,
        name: str,
        constraints: Sequence[Constraint[MotionState]] = (),
        allowances: Sequence[Allowance] = (),
        fixed: Mapping[int, float] | None = None,
        regions: Sequence[PlannedRegion] = (),
        effort: Effort = Effort.POSE,
        fraction: float | None = None,
        ends: Sequence[Float[np.ndarray, "n"]] | None = None,
    ) -> PoseProblem[Solved]:
        """Return the problem of a configuration near the nominal posture.

        Args:
            name: of the step.
            constraints: of the task, at waypoint 0.
            allowances: pairs that may touch.
            fixed: value by coordinate index.
            regions: where the loaded feet hold the robot, instead of their hull.
            effort: of the optimiser.
            fraction: of the plan that is done, for its progress.
            ends: configurations whose distances limit the required clearance; by default the nominal one.
        """
        lower, upper = self.body.bounds(1, {})
        for index, value in (fixed or {}).items():
            lower[0, index] = upper[0, index] = value
        ends = [self.body.nominal] if ends is None else ends
        checker = self.body.make_checker(allowances, ends, self.overrides)
        terms = self._add_own_terms(name, 1, (), constraints)
        problem = self.body.make_problem(lower, upper, checker, *terms, regions=regions)
        solver = self.with_effort(effort)
        solve = lambda guess: solver._solve(name, problem, guess[None])  # noqa: E731
        return PoseProblem(name, solve, self.monitor, fraction, self.most_seeds)

    def solve_trajectory(
        self,
        name: str,
        start: Float[np.ndarray, "T n"],
        fixed: Mapping[int, Float[np.ndarray, "n"]],
        costs: Sequence[Cost[MotionState]] = (),
        constraints: Sequence[Constraint[MotionState]] = (),
        allowances: Sequence[Allowance] = (),
        bounds: Bounds | None = None,
        balanced: Sequence[int] | None = None,
        regions: Sequence[PlannedRegion] = (),
    ) -> Solved:
        """Solve for a trajectory.

        Args:
            name: of the phase.
            start: path to start from.
            fixed: configuration by waypoint.
            costs, constraints: of the task.
            allowances: pairs that may touch.
            bounds: may narrow the bounds.
            balanced: waypoints with a balance constraint; all if not given.
            regions: where the loaded feet hold the robot, instead of their hull.
        """
        if self.body.robot.rolls:
            start = roll_path(start)
        lower, upper = self.body.bounds(len(start), fixed)
        if bounds is not None:
            bounds(lower, upper)
        checker = self.body.make_checker(allowances, list(fixed.values()), self.overrides)
        terms = self._add_own_terms(name, len(lower), costs, constraints)
        problem = self.body.place_kept(start).make_problem(lower, upper, checker, *terms, balanced, regions)
        return self._solve(name, problem, start)

    def is_feasible(self, q: Float[np.ndarray, "T n"], constraints: Sequence[Constraint[MotionState]] = ()) -> bool:
        """Return whether a trajectory keeps all constraints between its ends as it is."""
        lower, upper = self.body.bounds(len(q), {0: q[0], len(q) - 1: q[-1]})
        checker = self.body.make_checker((), [q[0], q[-1]])
        problem = self.body.place_kept(q).make_problem(lower, upper, checker, (), constraints)
        return keeps_constraints(problem, q)

    def restore_feasibility(self, step: str, solved: Solved) -> Solved:
        """Solve an infeasible step on for required constraints only; return it as it is if that fails."""
        problem = keep_required(solved.problem)
        optimiser = self.monitor.make_optimiser(Effort.RESTORE.apply(self.settings))
        result = optimiser.solve(problem, solved.x, should_stop=self.monitor.should_stop)
        self.monitor.record(step, result)
        restored = Solved(result, problem, solved.body)
        return restored if restored.is_feasible else solved

    def sample(
        self,
        start: Float[np.ndarray, "n"],
        end: Float[np.ndarray, "n"],
        tree: Tree,
        movable: Int[np.ndarray, "k"] | None = None,
    ) -> Float[np.ndarray, "K n"] | None:
        """Sample a path around the obstacles; None where there is none, or where nothing may be drawn.

        On planted links the limbs that carry nothing are drawn while the others go straight on their contacts; with
        ``tree.keeps_holds`` the base is drawn as well, and what carries follows.

        Args:
            start, end: configurations.
            tree: seed and effort.
            movable: coordinates that may leave the straight way, of those that carry nothing; all of them by default.
        """
        body = self.body
        if tree.keeps_holds:
            checker = body.make_search_checker([start, end])
            return self._sample(HeldProblem.between(body, checker, start, end), tree)
        free = free_coordinates(body)
        if movable is not None:
            free = np.intersect1d(movable, free)
        if not len(free) or (body.robot.is_floating and body.keeps_poses):
            return None
        carrier = None
        if body.robot.is_floating:
            carrier = straight_path(start, end, CARRIER_POINTS)
            carrier[1:-1] = project_onto_holds(body.engine, carrier[1:-1], body.holds())
        elif np.abs(np.delete(end - start, free)).max(initial=0.0) > 1e-6:
            return None
        checker = body.make_search_checker([start, end])
        return self._sample(SamplingProblem(body, checker, start, end, free, carrier), tree)

    def _sample(self, problem: SamplingProblem, tree: Tree) -> Float[np.ndarray, "K n"] | None:
        path = sample_path(problem, replace(tree, seed=tree.seed + self.seed), self.monitor.is_over)
        self.monitor.check()
        return path

    def shorten_path(
        self, q: Float[np.ndarray, "T n"], seed: int, *, keeps_holds: bool = False
    ) -> Float[np.ndarray, "K n"]:
        """Return the corners of a shorter polyline with the same ends: shortcuts that are clear replace parts of it.

        Args:
            q: waypoints.
            seed: of the draws.
            keeps_holds: see ``Tree``.
        """
        body, free = self.body, free_coordinates(self.body)
        if keeps_holds:
            held = HeldProblem.between(body, body.make_search_checker([q[0], q[-1]]), q[0], q[-1])
            path = held.shorten(q, np.random.default_rng(seed + self.seed))
            self.monitor.check()
            return path
        problem = SamplingProblem(body, body.make_search_checker([q[0], q[-1]]), q[0], q[-1], free)
        others = np.setdiff1d(np.arange(q.shape[1]), free)
        if not len(free) or np.abs(np.diff(q, axis=0))[:, others].max(initial=0.0) > 1e-6:
            return q
        corners = shorten_polyline(problem, q[:, free], np.random.default_rng(seed + self.seed))
        self.monitor.check()
        return problem.place(corners)

    def with_effort(self, effort: Effort) -> PhaseSolver:
        """Return the solver with another effort of the optimiser."""
        return replace(self, settings=effort.apply(self.settings))

    def with_settings(self, **changes: Any) -> PhaseSolver:
        """Return the solver with other settings of the optimiser."""
        return replace(self, settings=replace(self.settings, **changes))

    def _add_own_terms(
        self,
        name: str,
        n_waypoints: int,
        costs: Sequence[Cost[MotionState]],
        constraints: Sequence[Constraint[MotionState]],
    ) -> tuple[Sequence[Cost[MotionState]], Sequence[Constraint[MotionState]]]:
        """Return a step's costs and constraints with the caller's own.

        Raises:
            TypeError: one of the caller's terms is neither.
        """
        own = self.terms(name, self.body.robot, n_waypoints)
        for term in own:
            if not isinstance(term, Cost | Constraint):
                raise TypeError(f"a term must be a scopt.Cost or a scopt.Constraint, got {type(term).__name__}")
        own_costs = [term for term in own if isinstance(term, Cost)]
        own_constraints = [term for term in own if isinstance(term, Constraint)]
        return (*costs, *own_costs), (*constraints, *own_constraints)

    def _solve(self, name: str, problem: Problem[MotionState], start: Float[np.ndarray, "T n"]) -> Solved:
        """Solve a problem from a start."""
        self.monitor.check()
        callback = self.monitor.make_callback(name, self.body.robot.joint_names)
        optimiser = self.monitor.make_optimiser(self.settings)
        result = optimiser.solve(problem, start, callback, self.monitor.should_stop)
        self.monitor.record(name, result)
        return Solved(result, problem, self.body)


def report_solutions(
    solutions: Iterable[tuple[str, Solved]], make_plan: Callable[[str, Solved], TaskPlan]
) -> Iterator[TaskPlan]:
    """Yield a plan for every solution that may be certified; for the best attempt if none is, also when interrupted.

    Args:
        solutions: name of the start and its solution, solved on demand.
        make_plan: of both.
    """
    best: tuple[str, Solved] | None = None
    is_solved = False
    reported: list[Solved] = []
    interruption: Interrupted | None = None
    try:
        for name, solved in solutions:
            if solved.is_feasible:
                is_solved = True
                yield make_plan(name, solved)
                continue
            if best is None or solved.shortfall < best[1].shortfall:
                best = name, solved
            if solved.may_hold and not any(solved is other for other in reported):
                reported.append(solved)
                yield make_plan(name, solved)
    except Interrupted as error:
        interruption = error
    if not is_solved and best is not None and not any(best[1] is other for other in reported):
        yield make_plan(*best)
    if interruption is not None:
        raise interruption


def keep_required(problem: Problem[MotionState]) -> Problem[MotionState]:
    """Return the problem without costs, with clearances reduced to what keeps links apart."""
    least = LEAST_CLEARANCE + CLEARANCE_TOLERANCE

    def keep_apart(contacts: Contacts) -> Contacts:
        return replace(contacts, margin=np.minimum(contacts.margin, least))

    return change_contacts(replace(problem, costs=()), keep_apart)


def change_contacts(problem: Problem[MotionState], change: Callable[[Contacts], Contacts]) -> Problem[MotionState]:
    """Return the problem with the contacts of every state changed."""

    def state(x: Float[np.ndarray, "T n"]) -> MotionState:
        full = problem.state(x)
        return replace(full, contacts=change(full.contacts))

    return replace(problem, state=state)
