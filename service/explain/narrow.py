"""Why nothing was found: the demands that stand against each other at the best local minimum, few enough to read.

The demands are ranked by the multipliers of the l1 penalty where the violation is least, then thinned by a deletion
filter (Chinneck, Feasibility and Infeasibility in Optimization, 2008, sec. 6.2): each is left out in turn, the least
loaded first, and stays out where the rest still cannot be kept, neither from that place nor from where nothing pulls.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from costs.state import MotionState
from scopt import Problem, Settings, SolverError, Status, TrustRegionSQP
from scopt.multipliers import compute_multipliers
from service.body.phases import Solved, straight_path
from service.body.restore import EFFORT, keep_required
from service.body.whole_body import WholeBody
from service.explain.conflict import Conflict, DemandKind, Search
from service.explain.groups import Group, Place, group_demands

MOST_DEMANDS = 12  # the most loaded ones are looked at
TRIAL_STEPS = 16  # to do without a demand: what helps takes some ten steps
NEAR = 1e-2  # box in which multipliers are taken [rad, m]


@dataclass
class _Run:
    """Solves variations of one problem from one place, within a time limit.

    Attributes:
        settings: of a brief solve.
        body: whose motion it is.
        should_stop: asked often.
        deadline: of ``time.perf_counter``.
        n_solves: problems solved so far.
        last: (T, n) where the last of them ended, which has the least merit, not the least of the worst violation.
    """

    settings: Settings
    body: WholeBody
    should_stop: Callable[[], bool] | None
    deadline: float
    n_solves: int = 0
    last: Float[np.ndarray, "T n"] = field(default_factory=lambda: np.zeros((0, 0)))

    def solve(self, problem: Problem[MotionState], x: Float[np.ndarray, "T n"]) -> Solved | None:
        """The problem solved from ``x``; None when time is up."""
        left = self.deadline - time.perf_counter()
        if left <= 0.0:
            return None
        self.n_solves += 1
        self.last = x

        def remember(_: object, at: Float[np.ndarray, "T n"]) -> None:
            self.last = at

        solver = TrustRegionSQP(replace(self.settings, time_limit_s=left))
        result = solver.solve(problem, x, remember, self.should_stop)
        if result.status in (Status.TIME_LIMIT, Status.CANCELLED):
            return None
        return Solved(result, problem, self.body)

    def solve_from(self, problem: Problem[MotionState], starts: Sequence[Float[np.ndarray, "T n"]]) -> Solved | None:
        """The problem solved from the first start that leads to a solution, else from the last; None: time is up."""
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
) -> Conflict | None:
    """The demands that stand against each other at the best attempt; None where none has a notable multiplier.

    Args:
        step: of the plan that found no solution.
        solved: the best attempt at it.
        n_attempts: made at it.
        settings: of the optimiser.
        time_limit_s: wall time; what is found out by then is told.
        should_stop: asked often; True ends it early.
    """
    brief = replace(settings, **EFFORT)
    began = time.perf_counter()
    run = _Run(brief, solved.body, should_stop, began + time_limit_s)
    problem = keep_required(solved.problem)
    least = run.solve(problem, solved.x)
    run.settings = replace(brief, max_iterations=TRIAL_STEPS)
    x = solved.x if least is None else run.last
    ranked = _ranked(solved.body, problem, x)
    if not ranked:
        return None
    if least is None:
        kept, search = ranked, Search.CUT_SHORT
    elif least.is_feasible:
        kept, search = ranked, Search.GIVES_WAY
    else:
        kept, search = _reduced(run, problem, x, ranked)
    standing_on = tuple(foot.link for foot in solved.body.planted)
    spent = time.perf_counter() - began if search is Search.CUT_SHORT else None
    return Conflict(step, n_attempts, standing_on, tuple(group.demand for group in kept), search, run.n_solves, spent)


def _ranked(body: WholeBody, problem: Problem[MotionState], x: Float[np.ndarray, "T n"]) -> list[Group]:
    try:
        found = compute_multipliers(problem, x, mu=1.0, radius=NEAR)
    except SolverError:
        return []
    return group_demands(Place(body, problem, x, problem.state(x), found))[:MOST_DEMANDS]


def _reduced(
    run: _Run, problem: Problem[MotionState], x: Float[np.ndarray, "T n"], ranked: Sequence[Group]
) -> tuple[list[Group], Search]:
    """The demands that are left by the deletion filter, and how far it came."""
    solutions: dict[tuple[DemandKind, str], Float[np.ndarray, "T n"]] = {}
    left_out: list[Group] = []
    alone: set[tuple[DemandKind, str]] = set()  # those without which, and nothing else, all was kept
    starts = (x, _plain(run.body, problem, x))
    for group in reversed(ranked):
        trial = run.solve_from(_without(problem, [*left_out, group]), starts)
        if trial is None:
            return [_as_tried(g, alone) for g in ranked if g not in left_out], Search.CUT_SHORT
        if trial.is_feasible:
            solutions[group.key] = trial.x
            alone |= {group.key} if not left_out else set()
        else:
            left_out.append(group)
    kept = [group for group in ranked if group not in left_out]
    if not kept:
        return list(ranked), Search.NO_HELP
    decided: list[Group] = []
    for group in kept:
        # With nothing else left out, the filter has tried just that.
        starts = (solutions[group.key], starts[-1])
        trial = run.solve_from(group.give_up(problem), starts) if left_out else None
        if left_out and trial is None:
            return [*decided, *(_as_tried(g, alone) for g in kept[len(decided) :])], Search.CUT_SHORT
        decided.append(_decided(group, trial is None or trial.is_feasible))
    return decided, Search.REDUCED


def _as_tried(group: Group, alone: Collection[tuple[DemandKind, str]]) -> Group:
    """The demand as decisive if it was left out alone and all else was kept, as untried otherwise."""
    return _decided(group, True) if group.key in alone else group


def _decided(group: Group, is_decisive: bool) -> Group:
    return replace(group, demand=replace(group.demand, is_decisive=is_decisive))


def _plain(body: WholeBody, problem: Problem[MotionState], x: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Where nothing pulls: the nominal posture, or the straight line between the ends of a trajectory."""
    line = body.nominal[None] if len(x) == 1 else straight_path(x[0], x[-1], len(x))
    return np.asarray(np.clip(line, problem.lower, problem.upper))


def _without(problem: Problem[MotionState], left_out: Sequence[Group]) -> Problem[MotionState]:
    for group in left_out:
        problem = group.give_up(problem)
    return problem
