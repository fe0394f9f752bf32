"""Trust-region sequential convex optimisation with an l1 penalty.

Schulman et al., Motion planning with sequential convex optimization and convex collision checking, IJRR 2014,
Algorithm 1: the outer loop raises the penalty mu, the middle loop convexifies, the inner loop adapts the trust region.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic

import numpy as np
from jaxtyping import Bool, Float

from scopt.convex_model import ConvexModel, Subproblem, assemble, convexify
from scopt.correction import Correction
from scopt.errors import ProblemError
from scopt.problem import Penalty, Problem
from scopt.qp import ConicProgram, backend, solve_clarabel
from scopt.residual import StateT
from scopt.result import Iteration, Result, Status

SEARCHED_GAIN = 5.0  # times the gain at which a feasible solve ends
LEAST_PROGRESS = 0.9  # of the violation some steps ago
AT_THE_EDGE = 0.9  # a step of this share of the trust radius shows that the box held it

ALL_BUT_MET = 2e-3  # of a row whose penalty is written as an equality [unit of the row]

OnIteration = Callable[[Iteration, Float[np.ndarray, "T n"]], None]


@dataclass(frozen=True)
class Settings:
    """How the optimiser goes about it.

    Attributes:
        qp: back end by name (``piqp``, ``clarabel``, ``cvxpy``); ``qp_fallback`` is asked when it fails.
        accept_ratio: a step is taken when the exact merit falls by this fraction of what the model promised.
        shrink, expand: trust radius factors after a rejected and an accepted step.
        trust_radius: first box [variable units times ``Problem.step_scale``].
        min_trust_radius: below it the inner loop gives up.
        min_improvement, min_improvement_fraction: the middle loop ends when the model promises less than this,
            absolutely or as a fraction of the merit; ``min_improvement_feasible`` is the fraction that counts once the
            iterate is feasible.
        is_corrected: whether trial steps are corrected for the curvature of smooth constraints.
        acceptable_steps: trial steps after which an iterate whose violations are acceptable is left at that.
        patience: trial steps within which the largest violation (relative to its tolerance) must fall by a tenth; the
            solve is given up where it does not.
        penalty, penalty_factor, max_penalty_raises: mu of the first outer iteration, its growth, how often.
        max_iterations: trial steps in all.
        time_limit_s: wall time.
    """

    qp: str = "piqp"
    qp_fallback: str = "clarabel"
    accept_ratio: float = 0.25
    shrink: float = 0.3
    expand: float = 1.5
    trust_radius: float = 0.3
    min_trust_radius: float = 1e-4
    min_improvement: float = 1e-4
    min_improvement_fraction: float = 1e-3
    min_improvement_feasible: float = 0.02
    is_corrected: bool = True
    acceptable_steps: int = 4
    patience: float = float("inf")
    penalty: float = 10.0
    penalty_factor: float = 10.0
    max_penalty_raises: int = 5
    max_iterations: int = 100
    time_limit_s: float = float("inf")


@dataclass(frozen=True)
class _Iterate(Generic[StateT]):
    """An iterate with everything measured on it."""

    x: Float[np.ndarray, "T n"]
    state: StateT
    cost: dict[str, float]
    violation: dict[str, float]
    total_cost: float
    total_violation: float
    excess: float  # largest violation relative to its tolerance
    is_acceptable: bool

    @property
    def is_feasible(self) -> bool:
        return self.excess <= 1.0

    def merit(self, penalty: float) -> float:
        return self.total_cost + penalty * self.total_violation

    def is_better_than(self, other: _Iterate[StateT]) -> bool:
        if self.is_feasible and other.is_feasible:
            return self.total_cost < other.total_cost
        return self.excess < other.excess


@dataclass
class _Run(Generic[StateT]):
    """What changes while one problem is solved."""

    current: _Iterate[StateT]
    best: _Iterate[StateT]
    trust_radius: float
    penalty: float
    started: float
    history: list[Iteration] = field(default_factory=list)
    is_subproblem_failing: bool = False
    acceptable_steps: int = 0
    excess: list[float] = field(default_factory=list)


class _InterruptedError(Exception):
    """Leaves the nested loops with a status."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.value)
        self.status = status


class TrustRegionSQP:
    """The optimiser; holds settings only, so one instance may solve many problems."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings if settings is not None else Settings()
        self._solve_qp = backend(self.settings.qp)
        self._solve_qp_fallback = backend(self.settings.qp_fallback)

    def solve(
        self,
        problem: Problem[StateT],
        x0: Float[np.ndarray, "T n"],
        on_iteration: OnIteration | None = None,
        should_stop: Callable[[], bool] | None = None,
    ) -> Result:
        """Minimise from ``x0``.

        Args:
            problem: what to solve.
            x0: (T, n) start; clipped into the bounds.
            on_iteration: called after every trial step with its record and the current iterate.
            should_stop: asked before every trial step; True ends the solve as CANCELLED.

        Raises:
            ProblemError: ``x0`` has the wrong shape or holds NaN, or a term has no finite value there.
        """
        if x0.shape != problem.lower.shape or not np.isfinite(x0).all():
            raise ProblemError(f"x0 must be finite with shape {problem.lower.shape}, got shape {x0.shape}")
        started = time.perf_counter()
        first = _evaluate(problem, np.clip(x0, problem.lower, problem.upper))
        without_value = [name for name, size in (first.cost | first.violation).items() if not np.isfinite(size)]
        if without_value:
            raise ProblemError(f"'{without_value[0]}' has no finite value at x0")
        run = _Run(first, first, self.settings.trust_radius, self.settings.penalty, started)
        try:
            status = self._raise_penalty(problem, run, on_iteration, should_stop)
        except _InterruptedError as interruption:
            status = interruption.status
        return _result(run, status)

    def _raise_penalty(
        self,
        problem: Problem[StateT],
        run: _Run[StateT],
        on_iteration: OnIteration | None,
        should_stop: Callable[[], bool] | None,
    ) -> Status:
        """The outer loop."""
        for raised in range(self.settings.max_penalty_raises + 1):
            self._minimize_merit(problem, run, on_iteration, should_stop)
            if run.current.is_feasible:
                return Status.CONVERGED
            if raised < self.settings.max_penalty_raises:
                run.penalty *= self.settings.penalty_factor
                run.trust_radius = max(run.trust_radius, 0.1 * self.settings.trust_radius)
        return Status.STALLED

    def _minimize_merit(
        self,
        problem: Problem[StateT],
        run: _Run[StateT],
        on_iteration: OnIteration | None,
        should_stop: Callable[[], bool] | None,
    ) -> None:
        """The middle loop: convexify until the model promises no more."""
        is_free = (problem.upper > problem.lower).ravel()
        while True:
            before = time.perf_counter()
            model = convexify(problem, run.current.state, run.penalty)
            subproblem = assemble(model, is_free, _hard_rows(problem, model) if self.settings.is_corrected else None)
            convexify_s = time.perf_counter() - before
            if not self._improve(problem, run, model, subproblem, convexify_s, on_iteration, should_stop):
                return

    def _improve(
        self,
        problem: Problem[StateT],
        run: _Run[StateT],
        model: ConvexModel,
        subproblem: Subproblem,
        convexify_s: float,
        on_iteration: OnIteration | None,
        should_stop: Callable[[], bool] | None,
    ) -> bool:
        """The inner loop: try steps in a shrinking box; whether one was taken."""
        settings = self.settings
        correction = Correction.of(problem, run.current.x, model) if settings.is_corrected else None
        while run.trust_radius >= settings.min_trust_radius:
            self._check_interrupts(run, should_stop)
            before = time.perf_counter()
            dx = self._solve_in_box(problem, run, subproblem)
            solved = time.perf_counter()
            run.is_subproblem_failing = dx is None
            if dx is None:
                run.trust_radius *= settings.shrink
                continue
            merit, model_merit = run.current.merit(run.penalty), model.merit(dx)
            if merit - model_merit < self._worthwhile(run, merit):
                return False
            trial = _step(problem, run.current, dx if correction is None else correction(dx))
            is_accepted = self._is_good(run, model_merit, trial)
            timings = (convexify_s, solved - before, time.perf_counter() - solved)
            convexify_s = 0.0
            self._record(run, trial, model_merit, is_accepted, timings, on_iteration)
            travel = self._travel(problem, dx)
            if is_accepted:
                run.trust_radius *= settings.expand if travel > AT_THE_EDGE * run.trust_radius else 1.0
                return True
            # A box that the step did not fill would give the same step again.
            run.trust_radius = settings.shrink * min(run.trust_radius, travel)
            # Once feasible, a small gain is not worth the search for the right box.
            little = SEARCHED_GAIN * settings.min_improvement_feasible * abs(merit)
            if run.current.is_feasible and merit - model_merit < little:
                return False
            if run.current.is_acceptable and not run.current.is_feasible:
                raise _InterruptedError(Status.ACCEPTABLE)
        return False

    def _travel(self, problem: Problem[StateT], dx: Float[np.ndarray, "N"]) -> float:
        """The trust radius that a step just needs."""
        steps = np.abs(dx.reshape(problem.lower.shape))
        return float((steps if problem.step_scale is None else steps / problem.step_scale).max(initial=0.0))

    def _worthwhile(self, run: _Run[StateT], merit: float) -> float:
        """Promised improvements below this end the middle loop."""
        settings = self.settings
        is_feasible = run.current.is_feasible
        fraction = settings.min_improvement_feasible if is_feasible else settings.min_improvement_fraction
        return max(settings.min_improvement, fraction * abs(merit))

    def _is_good(self, run: _Run[StateT], model_merit: float, trial: _Iterate[StateT]) -> bool:
        """Whether the exact merit fell by enough of what the model promised."""
        merit = run.current.merit(run.penalty)
        return merit - trial.merit(run.penalty) >= self.settings.accept_ratio * (merit - model_merit)

    def _record(
        self,
        run: _Run[StateT],
        trial: _Iterate[StateT],
        model_merit: float,
        is_accepted: bool,
        timings: tuple[float, float, float],
        on_iteration: OnIteration | None,
    ) -> None:
        """Write a trial into the history and move to it if it was accepted."""
        merit = run.current.merit(run.penalty)
        if trial.is_better_than(run.best):
            run.best = trial
        if is_accepted:
            run.current = trial
        run.excess.append(run.current.excess)
        is_waiting = run.current.is_acceptable and not run.current.is_feasible
        run.acceptable_steps = run.acceptable_steps + 1 if is_waiting else 0
        record = Iteration(
            index=len(run.history),
            penalty=run.penalty,
            trust_radius=run.trust_radius,
            merit=merit,
            trial_merit=trial.merit(run.penalty),
            model_merit=model_merit,
            is_accepted=is_accepted,
            cost=run.current.cost,
            violation=run.current.violation,
            convexify_s=timings[0],
            solve_s=timings[1],
            evaluate_s=timings[2],
        )
        run.history.append(record)
        if on_iteration is not None:
            on_iteration(record, run.current.x)

    def _solve_in_box(
        self, problem: Problem[StateT], run: _Run[StateT], subproblem: Subproblem
    ) -> Float[np.ndarray, "N"] | None:
        """The model's minimiser within bounds and trust box, or None when no back end finds it."""
        scale = np.ones(problem.lower.shape[1]) if problem.step_scale is None else problem.step_scale
        box = run.trust_radius * scale
        x = run.current.x
        lower = np.maximum(problem.lower - x, -box).ravel()
        upper = np.minimum(problem.upper - x, box).ravel()
        program = subproblem.within(lower, upper)
        if not program.c.size:  # every variable is fixed; back ends crash on a program without variables
            return np.asarray(np.clip(subproblem.step(program.c), lower, upper))
        if isinstance(program, ConicProgram):  # convex expressions, which are beyond a QP back end
            solution = solve_clarabel(program)
            return np.asarray(np.clip(subproblem.step(solution.x), lower, upper)) if solution.is_usable else None
        solution = self._solve_qp(program)
        if not solution.is_usable and subproblem.softened is not None:
            return self._solve_in_box(problem, run, subproblem.softened())
        if not solution.is_usable:
            solution = self._solve_qp_fallback(program)
        if not solution.is_usable:
            return None
        return np.asarray(np.clip(subproblem.step(solution.x), lower, upper))

    def _check_interrupts(self, run: _Run[StateT], should_stop: Callable[[], bool] | None) -> None:
        if should_stop is not None and should_stop():
            raise _InterruptedError(Status.CANCELLED)
        if time.perf_counter() - run.started > self.settings.time_limit_s:
            raise _InterruptedError(Status.TIME_LIMIT)
        if run.acceptable_steps >= self.settings.acceptable_steps:
            raise _InterruptedError(Status.ACCEPTABLE)
        if len(run.excess) > self.settings.patience and not run.current.is_feasible:
            earlier = run.excess[-1 - int(self.settings.patience)]
            if run.current.excess > LEAST_PROGRESS * earlier:
                raise _InterruptedError(Status.STALLED)
        if len(run.history) >= self.settings.max_iterations:
            raise _InterruptedError(Status.ITERATION_LIMIT)


def _hard_rows(problem: Problem[Any], model: ConvexModel) -> Bool[np.ndarray, "A"] | None:
    """Absolute rows of smooth constraints that are all but met: the correction keeps them there."""
    if model.exact:
        return None
    is_hard = np.zeros(len(model.absolute.weight), dtype=bool)
    for constraint in problem.constraints:
        kind, rows = model.constraint_rows[constraint.name]
        if constraint.residual.is_smooth and kind is Penalty.ABS:
            is_hard[rows] = bool((np.abs(model.absolute.rows.value[rows]) < ALL_BUT_MET).all())
    return is_hard


def _step(problem: Problem[StateT], current: _Iterate[StateT], dx: Float[np.ndarray, "N"]) -> _Iterate[StateT]:
    """The iterate after a step, clipped into the bounds."""
    return _evaluate(problem, np.clip(current.x + dx.reshape(current.x.shape), problem.lower, problem.upper))


def _evaluate(problem: Problem[StateT], x: Float[np.ndarray, "T n"]) -> _Iterate[StateT]:
    """Measure every term at ``x``."""
    state = problem.state(x)
    cost = {term.name: term.measure(term.residual.value(state)) for term in problem.costs}
    violation: dict[str, float] = {}
    total_violation = excess = 0.0
    is_acceptable = True
    for constraint in problem.constraints:
        rows = constraint.violation(constraint.residual.value(state))
        largest = float(rows.max(initial=0.0))
        violation[constraint.name] = largest
        total_violation += constraint.scale * float(rows.sum())
        excess = max(excess, largest / constraint.tolerance)
        is_acceptable = is_acceptable and largest <= max(constraint.tolerance, constraint.acceptable)
    total_cost = sum(cost.values())
    if not np.isfinite(total_cost + total_violation):
        excess = np.inf  # max() above lets NaN pass: a step into where a term has no value is never the best
    return _Iterate(x, state, cost, violation, total_cost, total_violation, excess, is_acceptable)


def _result(run: _Run[Any], status: Status) -> Result:
    if status is Status.STALLED and run.is_subproblem_failing:
        status = Status.SUBPROBLEM_FAILED
    best = run.best
    worst = max(best.violation, key=lambda name: best.violation[name], default="")
    message = f"{status.value} after {len(run.history)} steps"
    if not best.is_feasible:
        message += f"; largest violation {best.violation[worst]:.3g} in '{worst}'"
    return Result(
        x=best.x,
        status=status,
        is_feasible=best.is_feasible,
        cost=best.cost,
        violation=best.violation,
        penalty=run.penalty,
        history=tuple(run.history),
        solve_time_s=time.perf_counter() - run.started,
        message=message,
    )
