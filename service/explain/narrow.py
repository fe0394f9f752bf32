"""The conflicting demands at the best local minimum, reduced to few enough to read.

The demands are ranked by the multipliers of the l1 penalty where the violation is least, then thinned by a deletion
filter (Chinneck, Feasibility and Infeasibility in Optimization, 2008, sec. 6.2): each is left out in turn, the least
loaded first, and stays out where the rest still cannot be met, neither from the minimum nor from an unloaded start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from costs.state import MotionState
from scopt import Clock, EffortClock, Problem, Settings, SolverError, Status, TrustRegionSQP
from scopt.multipliers import compute_multipliers
from service.body.effort import Effort
from service.body.paths import straight_path
from service.body.phases import keep_required
from service.body.task_plan import Solved
from service.body.whole_body import WholeBody
from service.explain.conflict import Conflict, DemandKind, FilterOutcome
from service.explain.groups import LocalMinimum, RemovableDemand, group_demands

MOST_DEMANDS = 12  # of the filter, the most loaded ones
TRIAL_STEPS = 16  # of a solve without a demand; a solution takes some ten
NEAR = 1e-2  # box in which multipliers are taken [rad, m]


@dataclass
class _TrialSolver:
    """Solver of variations of a problem within a time limit.

    Attributes:
        settings: of a brief solve.
        body: the robot in its scene.
        should_stop: polled often.
        deadline: of the clock.
        clock: measures the time limit.
        n_solves: problems solved so far.
        last: (T, n) last iterate, of the least merit, not of the least worst violation.
    """

    settings: Settings
    body: WholeBody
    should_stop: Callable[[], bool] | None
    deadline: float
    clock: Clock
    n_solves: int = 0
    last: Float[np.ndarray, "T n"] = field(default_factory=lambda: np.zeros((0, 0)))

    def solve(self, problem: Problem[MotionState], x: Float[np.ndarray, "T n"]) -> Solved | None:
        """Solve the problem from ``x``; None when time is up."""
        left = self.deadline - self.clock()
        if left <= 0.0:
            return None
        self.n_solves += 1
        self.last = x

        def remember(_: object, at: Float[np.ndarray, "T n"]) -> None:
            self.last = at

        solver = TrustRegionSQP(replace(self.settings, time_limit_s=left), self.clock)
        result = solver.solve(problem, x, remember, self.should_stop)
        if result.status in (Status.TIME_LIMIT, Status.CANCELLED):
            return None
        return Solved(result, problem, self.body)

    def solve_from(self, problem: Problem[MotionState], starts: Sequence[Float[np.ndarray, "T n"]]) -> Solved | None:
        """Solve from one start after another until one is feasible, else return the last; None when time is up."""
        solved = None
        for start in starts:
            solved = self.solve(problem, start)
            if solved is None or solved.is_feasible:
                break
        return solved


def explain(
    step: str,
    solved: Solved,
    n_attempts: int,
    settings: Settings,
    time_limit_s: float,
    should_stop: Callable[[], bool] | None = None,
    clock: Clock | None = None,
) -> Conflict | None:
    """Return the conflicting demands at the best attempt; None where none has a notable multiplier.

    Args:
        step: of the plan, without a solution.
        solved: the best attempt at it.
        n_attempts: number of attempts at it.
        settings: of the optimiser.
        time_limit_s: on the clock; the conflict is then as far reduced as the time allowed.
        should_stop: polled often; True ends it early.
        clock: measures the time limit, by default as effort.
    """
    brief = Effort.RESTORE.apply(settings)
    clock = EffortClock() if clock is None else clock
    began = clock()
    run = _TrialSolver(brief, solved.body, should_stop, began + time_limit_s, clock)
    problem = keep_required(solved.problem)
    least = run.solve(problem, solved.x)
    run.settings = replace(brief, max_iterations=TRIAL_STEPS)
    x = solved.x if least is None else run.last
    ranked = _rank_demands(solved.body, problem, x)
    if not ranked:
        return None
    if least is None:
        kept, search = ranked, FilterOutcome.CUT_SHORT
    elif least.is_feasible:
        kept, search = ranked, FilterOutcome.GIVES_WAY
    else:
        kept, search = _filter_demands(run, problem, x, ranked)
    standing_on = tuple(foot.link for foot in solved.body.planted)
    spent = clock() - began if search is FilterOutcome.CUT_SHORT else None
    return Conflict(step, n_attempts, standing_on, tuple(group.demand for group in kept), search, run.n_solves, spent)


def _rank_demands(body: WholeBody, problem: Problem[MotionState], x: Float[np.ndarray, "T n"]) -> list[RemovableDemand]:
    try:
        multipliers = compute_multipliers(problem, x, mu=1.0, radius=NEAR)
    except SolverError:
        return []
    return group_demands(LocalMinimum(body, problem, x, problem.state(x), multipliers))[:MOST_DEMANDS]


def _filter_demands(
    run: _TrialSolver, problem: Problem[MotionState], x: Float[np.ndarray, "T n"], ranked: Sequence[RemovableDemand]
) -> tuple[list[RemovableDemand], FilterOutcome]:
    """Return the demands that the deletion filter keeps, and its outcome."""
    solutions: dict[tuple[DemandKind, str], Float[np.ndarray, "T n"]] = {}
    left_out: list[RemovableDemand] = []
    alone: set[tuple[DemandKind, str]] = set()  # demands whose removal alone was enough
    starts = (x, _make_unloaded_start(run.body, problem, x))
    for group in reversed(ranked):
        trial = run.solve_from(_remove_demands(problem, [*left_out, group]), starts)
        if trial is None:
            return [_mark_tried(g, alone) for g in ranked if g not in left_out], FilterOutcome.CUT_SHORT
        if trial.is_feasible:
            solutions[group.key] = trial.x
            alone |= {group.key} if not left_out else set()
        else:
            left_out.append(group)
    kept = [group for group in ranked if group not in left_out]
    if not kept:
        return list(ranked), FilterOutcome.NO_HELP
    decided: list[RemovableDemand] = []
    for group in kept:
        # With nothing else left out, the filter has tried just that.
        starts = (solutions[group.key], starts[-1])
        trial = run.solve_from(group.remove(problem), starts) if left_out else None
        if left_out and trial is None:
            return [*decided, *(_mark_tried(g, alone) for g in kept[len(decided) :])], FilterOutcome.CUT_SHORT
        decided.append(_mark_decisive(group, trial is None or trial.is_feasible))
    return decided, FilterOutcome.REDUCED


def _mark_tried(group: RemovableDemand, alone: Collection[tuple[DemandKind, str]]) -> RemovableDemand:
    """Mark the demand as decisive if its removal alone was enough."""
    return _mark_decisive(group, True) if group.key in alone else group


def _mark_decisive(group: RemovableDemand, is_decisive: bool) -> RemovableDemand:
    return replace(group, demand=replace(group.demand, is_decisive=is_decisive))


def _make_unloaded_start(
    body: WholeBody, problem: Problem[MotionState], x: Float[np.ndarray, "T n"]
) -> Float[np.ndarray, "T n"]:
    """Return the nominal posture, or the straight line between the ends of a trajectory."""
    line = body.nominal[None] if len(x) == 1 else straight_path(x[0], x[-1], len(x))
    return np.asarray(np.clip(line, problem.lower, problem.upper))


def _remove_demands(problem: Problem[MotionState], left_out: Sequence[RemovableDemand]) -> Problem[MotionState]:
    for group in left_out:
        problem = group.remove(problem)
    return problem
