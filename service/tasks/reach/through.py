"""Reaches that pass places on their way without a stop: leg by leg first, then all of it as one motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from service.body.ladder import MotionSearch, Path, find_motion
from service.body.phases import PhaseSolver
from service.body.starts import choose_policy
from service.body.task_plan import PlannedPhase, Solved
from service.body.whole_body import WholeBody
from service.demands.passes import find_row, make_passes
from service.demands.phase import EndTarget
from service.request.tasks.reach import GoalRequest
from service.tasks.reach.goal import Goal
from service.tasks.reach.goal_poses import STEP, GoalEnds

REACH = "reach"


def list_ways_through(solver: PhaseSolver, goal: Goal, whole: GoalRequest) -> Iterator[tuple[str, Solved]]:
    """Yield what leads through all places, and else the leg that is missing, by name."""
    at, path, marks = solver.body.nominal, [solver.body.nominal[None]], []
    name, places = "through the places on the way", [Goal.of(solver.body, part) for part in whole.via]
    for k, place in enumerate((*places, goal)):
        body = _stand_at(solver.body, at)
        leg, own = replace(solver, body=body), replace(place, body=body)
        ends = GoalEnds(leg, own)
        if ends.miss is not None:
            yield f"{STEP} of via[{k}]" if k < len(places) else STEP, ends.miss
            return
        solved = find_motion(
            MotionSearch(REACH, leg, _solve_leg(own), at, ends, choose_policy(body.robot), restorable=0.0)
        )
        if not solved.is_feasible:
            yield f"leg {k + 1} of {len(places) + 1}", solved
            return
        path.append(solved.x[1:])
        at = solved.x[-1]
        marks.append(sum(len(part) for part in path) - 1)
    with solver.monitor.step(REACH, 0.6):
        yield name, _solve_through(solver, goal, whole, np.concatenate(path), marks[:-1])


def _stand_at(body: WholeBody, q: Float[np.ndarray, "n"]) -> WholeBody:
    """Return the body at the beginning of a leg, with what is kept along the whole motion."""
    return replace(body, nominal=q, kept=tuple(kept for kept in body.kept if kept.is_whole))


def _solve_leg(goal: Goal):  # type: ignore[no-untyped-def]
    def solve(solver: PhaseSolver, path: Path) -> Solved:
        last = len(path) - 1
        fixed = {0: path[0], last: path[-1]} if goal.is_complete else {0: path[0]}
        return solver.solve_trajectory(REACH, path, fixed, constraints=goal.constraints(last), bounds=goal.fix_joints)

    return solve


def _solve_through(solver: PhaseSolver, goal: Goal, whole: GoalRequest, path: Path, marks: list[int]) -> Solved:
    """Solve the whole motion with each place at its waypoint."""
    last = len(path) - 1
    places = [Goal.of(solver.body, part) for part in whole.via]
    constraints = goal.constraints(last)
    for k, (place, mark) in enumerate(zip(places, marks, strict=True)):
        constraints += place.constraints(mark, f" (via[{k}])")

    def narrow(lower: Float[np.ndarray, "T n"], upper: Float[np.ndarray, "T n"]) -> None:
        goal.fix_joints(lower, upper)
        for place, mark in zip(places, marks, strict=True):
            place.fix_joints(lower[: mark + 1], upper[: mark + 1])

    fixed = {0: path[0], last: path[-1]} if goal.is_complete else {0: path[0]}
    return solver.solve_trajectory(REACH, path, fixed, constraints=constraints, bounds=narrow)


def pass_through(phase: PlannedPhase, solver: PhaseSolver, goal: Goal, whole: GoalRequest) -> PlannedPhase:
    """Return a phase that says where it passes the places."""
    own = {field: getattr(phase, field) for field in phase.__dataclass_fields__}
    return _Passing(**own, solver=solver, goal=goal, whole=whole).place()


@dataclass(frozen=True)
class _Passing(PlannedPhase):
    """Phase that passes places on its way.

    Attributes:
        solver, goal, whole: of the reach.
    """

    solver: PhaseSolver | None = None
    goal: Goal | None = None
    whole: GoalRequest | None = None

    def solve_again(self, q: Float[np.ndarray, "T n"]) -> PlannedPhase | None:
        """Solve the phase from a denser trajectory, each place at the waypoint that is nearest to it."""
        assert self.solver is not None
        assert self.goal is not None
        assert self.whole is not None
        solved = _solve_through(self.solver, self.goal, self.whole, q, self._find_marks(q))
        return replace(self, q=solved.x, is_feasible=solved.is_feasible, kept=None).place()

    def place(self) -> _Passing:
        """Return the phase with the targets of its places at its waypoints."""
        marks = self._find_marks(self.q)

        def make(s: Float[np.ndarray, "T"]) -> tuple[EndTarget, ...]:
            assert self.solver is not None
            assert self.whole is not None
            return make_passes(
                self.solver.body.robot, self.whole, [float(s[k]) for k in marks], [self.q[k] for k in marks]
            )

        return replace(self, at_waypoints=make)

    def _find_marks(self, q: Float[np.ndarray, "T n"]) -> list[int]:
        """Return the waypoints at which the places are passed."""
        assert self.solver is not None
        assert self.whole is not None
        marks: list[int] = []
        for part in self.whole.via:
            first = marks[-1] + 1 if marks else 1
            marks.append(find_row(self.solver.body.robot, part, q, first))
        return marks
