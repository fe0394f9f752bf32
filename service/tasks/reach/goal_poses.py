"""Configurations at the goal of a reach: from the robot's postures, and from random ones that are led there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, count, islice

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from service.body.effort import Effort
from service.body.holds import find_prescribed
from service.body.inverse_kinematics import REACHED, draw_configurations, solve_holds
from service.body.phases import PhaseSolver
from service.body.poses import Poses, Seed, name_seeds, posture_guesses, random_guesses
from service.body.starts import End
from service.body.task_plan import Solved
from service.body.whole_body import WholeBody
from service.tasks.reach.goal import Goal, make_line_holds

STEP = "goal pose"
IK_DRAWS = 16  # batches of random configurations after which a goal counts as out of reach
FIRST_DRAWS, FIRST_ENDS = 2, 3  # of random ends where no posture leads to the goal
BATCH = 48  # random configurations that are led to the goal at once
OVERLAPPING_TRIED = 6  # of those in collision, by batch
RANDOM_GUESSES = 8  # about the nominal posture; about half of them lead to a pose
BRING_STEPS = 12  # of the nominal posture to the goal
BROUGHT = 1e-3  # largest residual of a posture that was brought to the goal [m, rad]
SAME_END = 0.05  # largest difference of equal ends [rad, m]


@dataclass
class GoalEnds:
    """Configurations at the goal of a reach, found on demand.

    Attributes:
        solver: of the robot.
        goal: the goal.
        known: (n,) end of an earlier motion, from which the first is searched; None without one.
        touches: pairs that may touch there.
    """

    solver: PhaseSolver
    goal: Goal
    known: Float[np.ndarray, "n"] | None = None
    touches: Sequence[Allowance] = ()
    _open: Iterator[Float[np.ndarray, "n"]] = field(init=False, repr=False)
    _first: Float[np.ndarray, "n"] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._open = self._find_near()
        self._first = next(self._open, None)

    @cached_property
    def _poses(self) -> Poses[Solved]:
        problem = self.solver.pose_problem(
            STEP,
            self.goal.constraints(0),
            self.touches,
            fixed=self.goal.joints,
            effort=Effort.GOAL_POSE,
            fraction=0.1,
        )
        return Poses(replace(problem, most=None), SAME_END)

    @cached_property
    def miss(self) -> Solved | None:
        """The best attempt where no configuration at the goal was found."""
        return None if self._first is not None else self._poses.best

    def find(self, end: End, number: int) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield configurations at the goal, those of a kind."""
        if end is End.FIRST and self._first is not None:
            found = self._poses.found if number and not self.goal.is_complete else [self._first]
            yield found[number % len(found)]
        elif end is End.OTHERS:
            yield from self._open
        elif end is End.NEAR and not self.goal.is_complete:
            body = self.solver.body
            guesses = random_guesses(body, RANDOM_GUESSES, self.solver.seed)
            yield from self._solve(name_seeds("random about the start", guesses))
        elif end is End.DRAWN and not self.goal.is_complete:
            yield from self._solve(self._draw(1, number))

    def _find_near(self) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield configurations from the robot's postures; random ones where these lead to none."""
        body, goal = self.solver.body, self.goal
        if goal.is_complete:
            yield goal.apply_joints(body.nominal)
            return
        near: Iterator[Seed] = iter(())
        if self.known is not None:
            near = bring_to_goal(body, goal, self.known)
        yield from self._solve(chain(near, bring_to_goal(body, goal), posture_guesses(body)))
        if not self._poses.found:
            yield from islice(self._solve(self._draw(FIRST_DRAWS, 0)), FIRST_ENDS)
        best = self._poses.best
        if not self._poses.found and best is not None:
            with self.solver.monitor.step(STEP, 0.1):
                restored = self.solver.restore_feasibility(STEP, best)
            self._poses.best = restored
            if restored.is_feasible:
                self._poses.found.append(restored.q)
                yield restored.q

    def find_all(self) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield different configurations at the goal, those from the robot's postures first.

        Raises:
            Interrupted: the time is up, or the plan was cancelled.
        """
        if self._first is not None:
            yield self._first
        yield from self._open
        yield from self._solve(self._draw(IK_DRAWS, 0))

    def _solve(self, seeds: Iterator[Seed]) -> Iterator[Float[np.ndarray, "n"]]:
        placed = ((name, self.goal.apply_joints(q)) for name, q in seeds)
        for pose in self._poses.find(placed):
            yield pose.q

    def _draw(self, draws: int, seed: int) -> Iterator[Seed]:
        """Yield random configurations that damped least squares lead to the goal, all of a batch at once.

        Clear ones come first, then the nearest to the nominal posture; those near a known one are left out.
        """
        body, goal = self.solver.body, self.goal
        fixed = find_prescribed(body.robot)
        fixed[list(goal.joints)] = True
        holds = (*body.holds(), *make_line_holds(goal, 1.0))
        rng = np.random.default_rng([self.solver.seed, seed])
        checker = body.make_pose_checker([])
        for _ in range(draws):
            with self.solver.monitor.step(STEP, 0.1):
                guesses = np.stack([goal.apply_joints(q) for q in draw_configurations(body, BATCH, rng)])
                error = np.zeros(BATCH)
                if holds:
                    guesses, error = solve_holds(body, guesses, holds, fixed)
                arrived = guesses[error < REACHED]
                is_clear = np.array([checker.are_clear(q[None]) for q in arrived], dtype=bool)
            far = np.abs(arrived - body.nominal).max(axis=1, initial=0.0)
            tried = count()
            for row in np.lexsort((far, ~is_clear)).tolist():
                if self._poses.is_new(arrived[row]) and (is_clear[row] or next(tried) < OVERLAPPING_TRIED):
                    yield "random within the limits", arrived[row]


def order_goals(goals: Sequence[Goal]) -> list[Goal]:
    """Return goals with the nearest to the nominal posture first: by the farthest joint to where each is led to.

    Goals that are not reached in a few steps come last.
    """

    def measure(goal: Goal) -> float:
        body = goal.body
        if goal.is_complete:
            return float(np.abs(goal.apply_joints(body.nominal) - body.nominal).max())
        brought = next(bring_to_goal(body, goal), None)
        return np.inf if brought is None else float(np.abs(brought[1] - body.nominal).max())

    return sorted(goals, key=measure)


def bring_to_goal(body: WholeBody, goal: Goal, q: Float[np.ndarray, "n"] | None = None) -> Iterator[Seed]:
    """Yield a configuration, by default the nominal one, with the goal's links at their goals and the robot balanced.

    Nothing is yielded where that is not reached.

    Obstacles are left to the optimiser, which then needs half of the steps.
    """
    fixed = find_prescribed(body.robot)
    fixed[list(goal.joints)] = True
    holds = (*body.holds(), *make_line_holds(goal, 1.0), *body.hold_in_balance())
    if not holds:
        return
    first = goal.apply_joints(body.nominal if q is None else q)
    guess, error = solve_holds(body, first[None], holds, fixed, BRING_STEPS)
    if error[0] < BROUGHT:
        yield "brought to the goal", guess[0]
