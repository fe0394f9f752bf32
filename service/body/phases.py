"""Solving single phases: poses and trajectories of a whole body, with what each phase promises."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.collision import Contacts
from costs.robot import BASE_NAMES, RobotModel
from costs.state import MotionState
from scopt import Constraint, Cost, Problem, Result, Settings, TrustRegionSQP
from service.body.holds import Hold
from service.body.monitor import Monitor
from service.body.sampling import SamplingProblem, Tree, free_coordinates, resample_path, sample_path
from service.body.whole_body import CLEARANCE_TERMS, CLEARANCE_TOLERANCE, WholeBody
from service.verify import Motion, Target

MOST_REASONS = 5
MOST_STARTS = 4
JOINT_SPREAD, BASE_SPREAD = 0.5, 0.1  # of random guesses, standard deviations [rad, m]
LEAST_CLEARANCE = 3e-3  # of swept hulls between waypoints: room for the curve that leaves them [m]
# A pose that can be had takes some ten steps.
POSE_EFFORT: dict[str, Any] = {"max_iterations": 40, "max_penalty_raises": 3}

Targets = Callable[[float], tuple[Target, ...]]
"""What a phase must reach or follow, given the path parameter of its end."""

Terms = Callable[[str, RobotModel, int], Sequence[Cost[MotionState] | Constraint[MotionState]]]
"""Terms of the caller's own, given the name of a phase, the robot and how many waypoints there are."""

WaypointTargets = Callable[[Float[np.ndarray, "T"]], tuple[Target, ...]]
"""What a phase must reach at its waypoints, given the path parameter of each."""

Bounds = Callable[[Float[np.ndarray, "T n"], Float[np.ndarray, "T n"]], None]
"""Narrows lower and upper bounds in place."""


@dataclass(frozen=True)
class PlannedPhase:
    """A phase of the motion as the optimiser left it, and what the verifier shall hold it to.

    Attributes:
        name: as the user sees it.
        q: (T, n) waypoints.
        is_feasible: whether the optimiser kept every constraint.
        holds: what stays put between the waypoints besides the planted links.
        allowances: pairs that may touch besides planted links and floor.
        targets: given the path parameter of the phase's end, what it must reach or follow.
        at_waypoints: given the path parameters of all its waypoints, what it must reach there.
        is_settling: whether it begins outside the balance margin.
        resolve: solves the phase anew from a denser trajectory between the same ends; None if it cannot.
    """

    name: str
    q: Float[np.ndarray, "T n"]
    is_feasible: bool
    holds: tuple[Hold, ...] = ()
    allowances: tuple[Allowance, ...] = ()
    targets: Targets = lambda s_last: ()
    at_waypoints: WaypointTargets = lambda s: ()
    is_settling: bool = False
    resolve: Callable[[Float[np.ndarray, "T n"]], Solved] | None = None

    def solve_again(self, q: Float[np.ndarray, "T n"]) -> PlannedPhase | None:
        """The phase from a denser trajectory between the same ends; None if it cannot be solved again."""
        if self.resolve is None:
            return None
        solved = self.resolve(q)
        return replace(self, q=solved.x, is_feasible=solved.is_feasible)

    def for_robot(self, robot: RobotModel) -> PlannedPhase:
        """The phase of a robot that has got further coordinates, which stay at zero."""
        q = np.zeros((len(self.q), robot.n))
        q[:, : self.q.shape[1]] = self.q
        return replace(self, q=q)


@dataclass(frozen=True)
class TaskPlan:
    """What a task's planner hands over.

    Attributes:
        body: the robot (perhaps with a mechanism) in its scene.
        phases: in order; the last one may be infeasible, then ``stuck`` or ``obstacle`` say what stands in the way.
        obstacle: sentences; empty when every phase is feasible.
        stuck: the step that has no solution; None when every phase is feasible.
        found_from: the start that led to it, in words; empty where a task has but one.
        measure: numbers the task reports, measured on the finished motion.
        notes: what was chosen.
        is_impossible: whether ``obstacle`` holds for every motion, not only for those that were tried.
    """

    body: WholeBody
    phases: tuple[PlannedPhase, ...]
    obstacle: tuple[str, ...] = ()
    stuck: Stuck | None = None
    found_from: str = ""
    measure: Callable[[Motion], Mapping[str, float]] = lambda motion: {}
    notes: tuple[str, ...] = ()
    is_impossible: bool = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """What stands in the way, in sentences; empty when every phase is feasible."""
        return (*(() if self.stuck is None else self.stuck.shortcomings), *self.obstacle)

    @property
    def is_feasible(self) -> bool:
        """Whether every phase was solved."""
        return not self.reasons and bool(self.phases) and all(phase.is_feasible for phase in self.phases)


@dataclass(frozen=True)
class Solved:
    """A solved problem, feasible or not.

    Attributes:
        result: of the optimiser.
        problem: what was solved.
        body: whose motion it is.
    """

    result: Result
    problem: Problem[MotionState]
    body: WholeBody

    @property
    def x(self) -> Float[np.ndarray, "T n"]:
        """The best waypoints."""
        return self.result.x

    @cached_property
    def is_feasible(self) -> bool:
        """Whether every constraint is kept; of the clearance margin, which is an aim, only what keeps links apart."""
        if self.result.is_feasible:
            return True
        state = self.problem.state(self.x)
        contacts = state.contacts
        asked = np.minimum(contacts.margin - CLEARANCE_TOLERANCE, LEAST_CLEARANCE)
        return bool(np.all(contacts.distance >= asked)) and all(
            float(term.measure_violation(term.residual.value(state)).max(initial=0.0)) <= term.tolerance
            for term in self.problem.constraints
            if term.name not in CLEARANCE_TERMS
        )

    @property
    def shortfall(self) -> float:
        """Largest violation relative to its tolerance."""
        violation = self.result.violation
        return max((violation[c.name] / c.tolerance for c in self.problem.constraints), default=0.0)

    def shortcomings(self, name: str) -> tuple[str, ...]:
        """What stands in the way at the best waypoints, the worst first, in words."""
        state = self.problem.state(self.x)
        lines: list[tuple[float, str]] = []
        for constraint in self.problem.constraints:
            short = constraint.measure_violation(constraint.residual.value(state))
            worst = float(short.max(initial=0.0))
            if worst <= constraint.tolerance:
                continue
            if constraint.name not in CLEARANCE_TERMS:
                text = f"{name}: '{constraint.name}' is off by {worst:.3g} {constraint.unit}".rstrip()
                lines.append((worst / constraint.tolerance, text))
        lines += [(depth / CLEARANCE_TOLERANCE, f"{name}: {text}") for depth, text in self._near_misses(state.contacts)]
        lines.sort(key=lambda line: -line[0])
        return tuple(text for _, text in lines[:MOST_REASONS]) or (f"{name}: {self.result.message}",)

    def _near_misses(self, contacts: Contacts) -> list[tuple[float, str]]:
        """Each pair that is too near, at its worst: by how much, and in words."""
        worst: dict[tuple[str, str], tuple[float, str]] = {}
        bodies, pieces = self.body.robot.bodies, self.body.scene.pieces
        for row in range(len(contacts)):
            short = float(contacts.margin[row] - contacts.distance[row])
            if short <= CLEARANCE_TOLERANCE:
                continue
            first = bodies[contacts.body[row]].name
            other = int(contacts.other[row])
            second = bodies[other].name if contacts.is_self[row] else pieces[other].name
            distance = 1e3 * float(contacts.distance[row])
            where = f"between waypoints {contacts.first[row]} and {contacts.second[row]}"
            if contacts.first[row] == contacts.second[row]:
                where = "there"
            how = f"is {-distance:.0f} mm inside" if distance < 0.0 else f"comes within {distance:.0f} mm of"
            text = f"{first} {how} {second} {where} ({1e3 * float(contacts.margin[row]):.0f} mm are aimed at)"
            worst[first, second] = max(worst.get((first, second), (0.0, "")), (short, text))
        return list(worst.values())


@dataclass(frozen=True)
class Stuck:
    """A step that has no solution.

    Attributes:
        step: its name.
        best: the best attempt at it.
    """

    step: str
    best: Solved

    @staticmethod
    def at(step: str, solved: Solved) -> Stuck | None:
        """None when the step is solved."""
        return None if solved.is_feasible else Stuck(step, solved)

    @property
    def shortcomings(self) -> tuple[str, ...]:
        """What the best attempt falls short of, in sentences."""
        return self.best.shortcomings(self.step)


@dataclass(frozen=True)
class PhaseSolver:
    """Solves poses and trajectories of one body under one monitor.

    Attributes:
        body: the robot in its scene.
        monitor: of the plan.
        settings: of the optimiser.
        overrides: ``(one, other, margin)`` for pairs that are asked for another clearance [m].
        most_starts: starts of a reach that are tried at most.
        seed: of random draws.
        terms: of the caller's own, added to every pose and trajectory.
    """

    body: WholeBody
    monitor: Monitor
    settings: Settings
    overrides: tuple[tuple[BodyRef, BodyRef, float], ...] = ()
    most_starts: int = MOST_STARTS
    seed: int = 0
    terms: Terms = lambda phase, robot, n_waypoints: ()

    def pose(
        self,
        name: str,
        guesses: Sequence[Float[np.ndarray, "n"]],
        constraints: Sequence[Constraint[MotionState]],
        allowances: Sequence[Allowance] = (),
        fixed: Mapping[int, float] | None = None,
    ) -> Solved:
        """A single configuration near the nominal posture; the first guess that leads to a feasible one wins.

        Args:
            name: of the step.
            guesses: (n,) starts.
            constraints: of the task, at waypoint 0.
            allowances: pairs that may touch.
            fixed: value by coordinate index.
        """
        lower, upper = self.body.bounds(1, {})
        for index, value in (fixed or {}).items():
            lower[0, index] = upper[0, index] = value
        checker = self.body.checker(allowances, [self.body.nominal], self.overrides)
        problem = self.body.problem(lower, upper, checker, *self._with_own(name, 1, (), constraints))
        return self.with_settings(**POSE_EFFORT)._first_feasible(name, problem, [guess[None] for guess in guesses])

    def trajectory(
        self,
        name: str,
        starts: Sequence[Float[np.ndarray, "T n"]],
        fixed: Mapping[int, Float[np.ndarray, "n"]],
        costs: Sequence[Cost[MotionState]] = (),
        constraints: Sequence[Constraint[MotionState]] = (),
        allowances: Sequence[Allowance] = (),
        bounds: Bounds | None = None,
        balanced: Sequence[int] | None = None,
    ) -> Solved:
        """A trajectory; the first start that leads to a feasible one wins, else the best is returned.

        Args:
            name: of the phase.
            starts: (T, n) starting trajectories.
            fixed: configuration by waypoint.
            costs, constraints: of the task.
            allowances: pairs that may touch.
            bounds: may narrow the bounds in place.
            balanced: waypoints at which balance is asked; all if not given.
        """
        lower, upper = self.body.bounds(len(starts[0]), fixed)
        if bounds is not None:
            bounds(lower, upper)
        checker = self.body.checker(allowances, list(fixed.values()), self.overrides)
        terms = self._with_own(name, len(lower), costs, constraints)
        problem = self.body.problem(lower, upper, checker, *terms, balanced)
        return self._first_feasible(name, problem, starts)

    def sample_start(
        self, start: Float[np.ndarray, "n"], end: Float[np.ndarray, "n"], n_waypoints: int, tree: Tree
    ) -> Float[np.ndarray, "T n"] | None:
        """A start around the obstacles from a sampling planner; None where base or standing legs must move."""
        free = free_coordinates(self.body)
        others = np.setdiff1d(np.arange(len(start)), free)
        if not len(free) or np.abs(end - start)[others].max(initial=0.0) > 1e-6:
            return None
        problem = SamplingProblem(self.body, self.body.pose_checker([start, end]), start, end, free)
        corners = sample_path(problem, tree, self.monitor.is_over)
        self.monitor.check()
        return None if corners is None else resample_path(corners, max(n_waypoints, 2 * len(corners)))

    def with_settings(self, **changes: Any) -> PhaseSolver:
        """The same solver with other settings of the optimiser."""
        return replace(self, settings=replace(self.settings, **changes))

    def _with_own(
        self,
        name: str,
        n_waypoints: int,
        costs: Sequence[Cost[MotionState]],
        constraints: Sequence[Constraint[MotionState]],
    ) -> tuple[Sequence[Cost[MotionState]], Sequence[Constraint[MotionState]]]:
        """Costs and constraints of a step together with the caller's own.

        Raises:
            TypeError: the caller's are neither.
        """
        own = self.terms(name, self.body.robot, n_waypoints)
        for term in own:
            if not isinstance(term, Cost | Constraint):
                raise TypeError(f"a term must be a scopt.Cost or a scopt.Constraint, got {type(term).__name__}")
        own_costs = [term for term in own if isinstance(term, Cost)]
        own_constraints = [term for term in own if isinstance(term, Constraint)]
        return (*costs, *own_costs), (*constraints, *own_constraints)

    def _first_feasible(
        self, name: str, problem: Problem[MotionState], starts: Sequence[Float[np.ndarray, "T n"]]
    ) -> Solved:
        best: Solved | None = None
        for start in starts[:MOST_STARTS]:
            self.monitor.check()
            solver = TrustRegionSQP(self.monitor.settings(self.settings))
            tell = self.monitor.iterations_of(name, self.body.robot.joint_names)
            result = solver.solve(problem, start, tell, self.monitor.should_stop)
            self.monitor.note(name, result)
            solved = Solved(result, problem, self.body)
            if solved.is_feasible:
                return solved
            if best is None or solved.shortfall < best.shortfall:
                best = solved
        if best is None:
            raise ValueError("at least one start is needed")
        return best


def posture_guesses(body: WholeBody) -> list[tuple[str, Float[np.ndarray, "n"]]]:
    """Configurations worth starting from by name: the nominal one, then the robot's postures where it stands."""
    found = [("nominal", body.nominal.copy())]
    for name, posture in sorted(body.robot.postures.items()):
        guess = posture.copy()
        if body.robot.is_floating:
            guess[: len(BASE_NAMES)] = body.nominal[: len(BASE_NAMES)]
        if not np.array_equal(guess, body.nominal):
            found.append((name, guess))
    return found


def random_guesses(body: WholeBody, count: int, seed: int) -> list[Float[np.ndarray, "n"]]:
    """Configurations about the nominal one, within the limits."""
    robot, rng = body.robot, np.random.default_rng(seed)
    spread = np.full(robot.n, JOINT_SPREAD)
    if robot.is_floating:
        spread[: len(BASE_NAMES)] = BASE_SPREAD
    steps = spread * rng.normal(size=(count, robot.n))
    return list(np.clip(body.nominal + steps, robot.lower, robot.upper))


def straight_path(
    first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], n_waypoints: int
) -> Float[np.ndarray, "T n"]:
    """Waypoints on the straight line between two configurations."""
    return np.asarray(first + (last - first) * np.linspace(0.0, 1.0, n_waypoints)[:, None])


def path_via(
    first: Float[np.ndarray, "n"],
    middle: Float[np.ndarray, "n"],
    last: Float[np.ndarray, "n"],
    n_waypoints: int,
) -> Float[np.ndarray, "T n"]:
    """Waypoints on two straight lines through a configuration between."""
    half = n_waypoints // 2
    return np.concatenate(
        [straight_path(first, middle, half + 1)[:-1], straight_path(middle, last, n_waypoints - half)]
    )
