"""A task's phases as planned: waypoints, the verifier's targets, and the violations of a step without a solution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.collision import Contacts
from costs.curve import Curve, TimeLaw
from costs.robot.carried import MovableObject
from costs.state import MotionState
from scopt import Problem, Result
from service.body.forces.loaded_regions import PlannedRegion
from service.body.holds import Hold
from service.body.whole_body import CLEARANCE_TERMS, CLEARANCE_TOLERANCE, WholeBody
from service.demands.phase import TaskPhase
from service.demands.rest.earlier_motion import EarlierMotion
from service.verify import Motion, Target

MOST_REASONS = 5
FORGIVEN = 5.0  # times its tolerance: rows of a foot are kept to a fifth of what the verifier allows its corners
WAY_POSES = 4  # looked at per step of a motion that the optimiser calls infeasible
LEAST_CLEARANCE = 3e-3  # of swept hulls between waypoints: room for the curve that leaves them [m]

WaypointTargets = Callable[[Float[np.ndarray, "T"]], tuple[Target, ...]]
"""A phase's targets at its waypoints, given the path parameter of each."""


@dataclass(frozen=True)
class KeptCurve:
    """Curve of a phase that is known already and kept as it is, at rest at both ends.

    Attributes:
        curve: through the phase's waypoints, from any path parameter on.
        law: its time law; None for one that is still to be found.
        is_settled: whether this law keeps the limits of forces on this curve.
    """

    curve: Curve
    law: TimeLaw | None = None
    is_settled: bool = False

    @staticmethod
    def of(earlier: EarlierMotion, phase: str) -> KeptCurve | None:
        """Return a phase of an earlier motion, with its part of the time law where that leads from rest to rest."""
        curve = earlier.curves.get(phase)
        if curve is None:
            return None
        law = None if earlier.law is None else earlier.law.cut(float(curve.knots[0]), float(curve.knots[-1]))
        return KeptCurve(curve, law, is_settled=law is not None)


@dataclass(frozen=True)
class PlannedPhase:
    """A phase of a task with its motion.

    Attributes:
        phase: what the task demands of it.
        q: (T, n) waypoints.
        is_feasible: whether every constraint is kept.
        holds: residuals kept at zero between the waypoints besides the planted links'.
        at_waypoints: targets made from the path parameters of all its waypoints, or None.
        is_settling: whether it begins outside the balance margin.
        is_tight: whether the robot nearly touches at one of its ends, so that the samples are close together.
        resolve: solves the phase anew from a denser trajectory between the same ends; None if it cannot.
        regions: where the loaded feet hold the robot, by stretches of the waypoints that it was solved with.
        values: (T, k) of the mechanism's joints at those waypoints, its last coordinates.
        body: the robot on this phase's contacts, where they are not those of the whole motion.
        kept: its curve, if that is known already: its knots are the waypoints.
        limits: frame and largest speed of its origin [m/s], of frames that move at a given speed.
        duration_s: of the phase, where it is to take longer than the fastest law; None for that.
        drift: largest residual of its own holds between waypoints, where it is smaller than that of its body [m, rad].
    """

    phase: TaskPhase
    q: Float[np.ndarray, "T n"]
    is_feasible: bool
    holds: tuple[Hold, ...] = ()
    at_waypoints: WaypointTargets | None = None
    is_settling: bool = False
    is_tight: bool = False
    resolve: Callable[[Float[np.ndarray, "T n"]], Solved] | None = None
    regions: tuple[PlannedRegion, ...] = ()
    values: Float[np.ndarray, "T k"] | None = None
    body: WholeBody | None = None
    kept: KeptCurve | None = None
    limits: tuple[tuple[str, float], ...] = ()
    duration_s: float | None = None
    drift: float = np.inf

    @property
    def name(self) -> str:
        """As the user sees it."""
        return self.phase.name

    @property
    def flows(self) -> bool:
        """Whether the motion goes on into the next phase without a rest."""
        return self.phase.flows

    def solve_again(self, q: Float[np.ndarray, "T n"]) -> PlannedPhase | None:
        """Solve the phase from a denser trajectory between the same ends; None if it cannot be solved again."""
        if self.resolve is None:
            return None
        solved = self.resolve(q)
        return replace(self, q=solved.x, is_feasible=solved.is_feasible, kept=None)

    def for_body(self, body: WholeBody) -> PlannedPhase:
        """Return the phase for a body with further coordinates, which stay at their nominal values."""
        q = np.tile(body.nominal, (len(self.q), 1))
        q[:, : self.q.shape[1]] = self.q
        return replace(self, q=q, kept=None)


@dataclass(frozen=True)
class TaskPlan:
    """The result of a task's planner.

    Attributes:
        body: the robot (perhaps with a mechanism) in its scene.
        phases: in order; the last may be infeasible, then ``stuck`` or ``obstacle`` gives the reason.
        obstacle: sentences; empty when every phase is feasible.
        stuck: the step that has no solution; None when every phase is feasible.
        found_from: the start of the optimiser that led to it, in words; empty where a task has a single start.
        measure: figures of the task, measured on the finished motion.
        notes: choices that were made.
        is_impossible: whether ``obstacle`` holds for every motion, not only for those that were tried.
        pose_graph: poses from which the sequence was chosen (JSON-ready), or None.
        objects: that hands carry; ``body`` is without them.
    """

    body: WholeBody
    phases: tuple[PlannedPhase, ...]
    obstacle: tuple[str, ...] = ()
    stuck: Stuck | None = None
    found_from: str = ""
    measure: Callable[[Motion], Mapping[str, float]] = lambda motion: {}
    notes: tuple[str, ...] = ()
    is_impossible: bool = False
    pose_graph: Mapping[str, Any] | None = None
    objects: tuple[MovableObject, ...] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Sentences why the task is not solved; empty when every phase is feasible."""
        return (*(() if self.stuck is None else self.stuck.best.describe_violations(self.stuck.step)), *self.obstacle)

    @property
    def is_feasible(self) -> bool:
        """Whether every phase was solved."""
        return not self.reasons and bool(self.phases) and all(phase.is_feasible for phase in self.phases)

    @property
    def shortfall(self) -> float:
        """Largest violation at the step without a solution relative to its tolerance; infinite where none is known."""
        if self.is_feasible:
            return 0.0
        return float("inf") if self.stuck is None else self.stuck.best.shortfall

    def as_solved(self) -> TaskPlan:
        """Return the plan as one that does the whole task, for a motion of which the verifier shows it."""
        phases = tuple(replace(phase, is_feasible=True) for phase in self.phases)
        return replace(self, phases=phases, obstacle=(), stuck=None)


def keeps_constraints(problem: Problem[MotionState], x: Float[np.ndarray, "T n"]) -> bool:
    """Return whether waypoints keep every constraint; of the clearance margin only ``LEAST_CLEARANCE``."""
    state = problem.state(x)
    contacts = state.contacts
    required = np.minimum(contacts.margin - CLEARANCE_TOLERANCE, LEAST_CLEARANCE)
    return bool(np.all(contacts.distance >= required)) and all(
        float(term.measure_violation(term.residual.value(state)).max(initial=0.0)) <= term.tolerance
        for term in problem.constraints
        if term.name not in CLEARANCE_TERMS
    )


@dataclass(frozen=True)
class Solved:
    """A problem with the optimiser's result, feasible or not."""

    result: Result
    problem: Problem[MotionState]
    body: WholeBody

    @property
    def x(self) -> Float[np.ndarray, "T n"]:
        """The best waypoints."""
        return self.result.x

    @property
    def q(self) -> Float[np.ndarray, "n"]:
        """The first of them; of a pose the only one."""
        return np.asarray(self.result.x[0])

    @cached_property
    def is_feasible(self) -> bool:
        """Whether every constraint is kept; of the clearance margin only ``LEAST_CLEARANCE`` is required."""
        return self.result.is_feasible or keeps_constraints(self.problem, self.x)

    @cached_property
    def may_hold(self) -> bool:
        """Whether the motion may be sound although the optimiser misses an aim, so that the verifier has to decide.

        The verifier looks at the curve, the optimiser at hulls of whole steps and at margins.  A motion is hopeless if
        another constraint than clearance is missed by more than ``FORGIVEN``, or if links meet at a pose between the
        waypoints.
        """
        violation = self.result.violation
        others = (term for term in self.problem.constraints if term.name not in CLEARANCE_TERMS)
        if len(self.x) < 2 or any(violation[term.name] > FORGIVEN * term.tolerance for term in others):
            return False
        shares = np.arange(WAY_POSES)[:, None] / WAY_POSES
        ways = self.x[:-1, None] + shares * np.diff(self.x, axis=0)[:, None]
        return self.body.are_apart(np.concatenate([*ways, self.x[-1:]]))

    @property
    def shortfall(self) -> float:
        """Largest violation relative to its tolerance."""
        violation = self.result.violation
        return max((violation[c.name] / c.tolerance for c in self.problem.constraints), default=0.0)

    def describe_violations(self, step: str) -> tuple[str, ...]:
        """Return the violations at the best waypoints as sentences, the worst first."""
        state = self.problem.state(self.x)
        lines: list[tuple[float, str]] = []
        for constraint in self.problem.constraints:
            worst = float(constraint.measure_violation(constraint.residual.value(state)).max(initial=0.0))
            if worst > constraint.tolerance and constraint.name not in CLEARANCE_TERMS:
                text = f"{step}: '{constraint.name}' is off by {worst:.3g} {constraint.unit}".rstrip()
                lines.append((worst / constraint.tolerance, text))
        lines += [(depth / CLEARANCE_TOLERANCE, f"{step}: {text}") for depth, text in self._near_misses(state.contacts)]
        lines.sort(key=lambda line: -line[0])
        return tuple(text for _, text in lines[:MOST_REASONS]) or (f"{step}: {self.result.message}",)

    def _near_misses(self, contacts: Contacts) -> list[tuple[float, str]]:
        """Return each pair that is too near, at its worst: missing clearance [m] and a clause."""
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
    """A step that has no solution, with the best attempt at it.

    Attributes:
        step: its name.
        best: the best attempt.
        order: names of all phases of the task in their order, where the task knows them.
    """

    step: str
    best: Solved
    order: tuple[str, ...] = ()

    @staticmethod
    def at(step: str, solved: Solved) -> Stuck | None:
        """Return None when the step is solved."""
        return None if solved.is_feasible else Stuck(step, solved)
