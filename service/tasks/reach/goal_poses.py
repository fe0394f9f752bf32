"""Configurations at the goal of a reach: from the robot's postures, and from random ones that are led there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from service.body.holds import find_prescribed
from service.body.inverse_kinematics import REACHED, draw_configurations, solve_holds
from service.body.phases import PhaseSolver, posture_guesses
from service.body.task_plan import Solved
from service.body.whole_body import WholeBody
from service.tasks.reach.goal import Goal, make_line_holds

POSE: dict[str, float] = {"patience": 12, "min_improvement_feasible": 0.3}
IK_DRAWS = 16  # batches of random configurations after which a goal counts as out of reach
BATCH = 48  # random configurations that are led to the goal at once
OVERLAPPING_TRIED = 6  # of those in collision, by batch
BRING_STEPS = 12  # of the nominal posture to the goal
BROUGHT = 1e-3  # largest residual of a posture that was brought to the goal [m, rad]
SAME_END = 0.05  # largest difference of equal ends [rad, m]


def find_goal_configurations(solver: PhaseSolver, goal: Goal) -> Iterator[Float[np.ndarray, "n"]]:
    """Yield different feasible configurations at a goal, those from the robot's postures first.

    Raises:
        Interrupted: the time is up, or the plan was cancelled.
    """
    ends: list[np.ndarray] = []
    for _, guess in posture_guesses(solver.body):
        solved = solve_at_goal(solver, goal, guess)
        if solved.is_feasible and is_new_end(solved.x[0], ends):
            ends.append(solved.x[0])
            yield solved.x[0]
    yield from find_random_ends(solver, goal, ends, IK_DRAWS)


def find_random_ends(
    solver: PhaseSolver, goal: Goal, ends: list[Float[np.ndarray, "n"]], draws: int, seed: int = 0
) -> Iterator[Float[np.ndarray, "n"]]:
    """Yield feasible configurations at a goal other than ``ends``, to which they are appended.

    Random configurations are led to the goal by damped least squares, all at once; those that arrive go through the
    optimiser, clear ones first, then the nearest to the nominal posture.

    Args:
        draws: number of batches.
        seed: of the draws, beside the solver's.
    """
    body = solver.body
    fixed = find_prescribed(body.robot)
    fixed[list(goal.joints)] = True
    holds = (*body.holds(), *make_line_holds(goal, 1.0))
    rng = np.random.default_rng([solver.seed, seed])
    checker = body.make_pose_checker([])
    for _ in range(draws):
        with solver.monitor.step("goal pose", 0.1):
            guesses = np.stack([goal.apply_joints(q) for q in draw_configurations(body, BATCH, rng)])
            error = np.zeros(BATCH)
            if holds:
                guesses, error = solve_holds(body, guesses, holds, fixed)
            arrived = guesses[error < REACHED]
            is_clear = np.array([checker.are_clear(q[None]) for q in arrived], dtype=bool)
        far = np.abs(arrived - body.nominal).max(axis=1, initial=0.0)
        order = np.lexsort((far, ~is_clear))
        n_tried = 0
        for row in order.tolist():
            if not is_new_end(arrived[row], ends) or (not is_clear[row] and n_tried >= OVERLAPPING_TRIED):
                continue
            n_tried += not is_clear[row]
            solved = solve_at_goal(solver, goal, arrived[row])
            if solved.is_feasible and is_new_end(solved.x[0], ends):
                ends.append(solved.x[0])
                yield solved.x[0]


def bring_to_goal(body: WholeBody, goal: Goal) -> Iterator[Float[np.ndarray, "n"]]:
    """Yield the nominal posture with the goal's links at their goals and the robot balanced, if that is reached.

    Obstacles are left to the optimiser, which then needs half of the steps.
    """
    fixed = find_prescribed(body.robot)
    fixed[list(goal.joints)] = True
    holds = (*body.holds(), *make_line_holds(goal, 1.0), *body.hold_in_balance())
    if not holds:
        return
    guess, error = solve_holds(body, goal.apply_joints(body.nominal)[None], holds, fixed, BRING_STEPS)
    if error[0] < BROUGHT:
        yield guess[0]


def solve_at_goal(solver: PhaseSolver, goal: Goal, guess: Float[np.ndarray, "n"]) -> Solved:
    """Solve for a configuration at a goal from a guess."""
    brief = solver.with_settings(**POSE)
    with solver.monitor.step("goal pose", 0.1):
        return brief.solve_pose("goal pose", [goal.apply_joints(guess)], goal.constraints(0), fixed=goal.joints)


def is_new_end(q: Float[np.ndarray, "n"], ends: Sequence[Float[np.ndarray, "n"]]) -> bool:
    return all(np.abs(q - other).max() > SAME_END for other in ends)
