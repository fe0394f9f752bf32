"""Trust-region sequential convex optimisation with an l1 penalty.

Schulman et al., Motion planning with sequential convex optimization and convex collision checking, IJRR 2014,
Algorithm 1: the outer loop raises the penalty mu, the middle loop convexifies, the inner loop adapts the trust region.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Generic

import numpy as np
from jaxtyping import Bool, Float

from scopt.convex_model import ConvexModel, Subproblem, assemble, convexify, drop_idle_rows
from scopt.correction import Correction
from scopt.hessian import HessianSum
from scopt.iterate import Iterate, measure, measure_start
from scopt.penalty_schedule import PenaltySchedule
from scopt.problem import Penalty, Problem
from scopt.qp import ConicProgram, select_backend, solve_clarabel
from scopt.residual import StateT
from scopt.result import Iteration, Result, Status
from scopt.settings import Clock, Settings
from scopt.termination import Termination
from scopt.trust_region import TrustRegion

ALL_BUT_MET = 2e-3  # of a row whose penalty is written as an equality [unit of the row]

OnIteration = Callable[[Iteration, Float[np.ndarray, "T n"]], None]


class TrustRegionSQP:
    """The optimiser; holds settings and rules only, so one instance may solve many problems.

    Attributes:
        settings, clock: given at construction; the clock measures ``Settings.time_limit_s``.
        trust_region, penalty_schedule, termination: rules made of them.
    """

    def __init__(self, settings: Settings | None = None, clock: Clock = time.monotonic) -> None:
        self.clock = clock
        s = self.settings = settings if settings is not None else Settings()
        self.trust_region = TrustRegion(s.trust_radius, s.min_trust_radius, s.accept_ratio, s.shrink, s.expand)
        self.penalty_schedule = PenaltySchedule(s.penalty, s.penalty_factor, s.max_penalty_raises)
        self.termination = Termination(
            s.min_improvement,
            s.min_improvement_fraction,
            s.min_improvement_feasible,
            s.acceptable_steps,
            s.patience,
            s.max_iterations,
            s.time_limit_s,
        )
        self._solve_qp = select_backend(s.qp)
        self._solve_qp_fallback = select_backend(s.qp_fallback)

    def solve(
        self,
        problem: Problem[StateT],
        x0: Float[np.ndarray, "T n"],
        on_iteration: OnIteration | None = None,
        should_stop: Callable[[], bool] | None = None,
    ) -> Result:
        """Minimise from ``x0``.

        Args:
            x0: (T, n) start; clipped into the bounds.
            on_iteration: called after every trial step with its record and the current iterate.
            should_stop: called before every model and trial step; True ends the solve as CANCELLED.

        Raises:
            ProblemError: ``x0`` has the wrong shape or holds NaN, or a term has no finite value there.
        """
        began = self.clock()
        course = _Course(time.perf_counter(), measure_start(problem, x0), on_iteration)
        region, schedule, termination = self.trust_region, self.penalty_schedule, self.termination
        radius, level, progress = region.init(), schedule.init(), termination.init()
        current = course.best
        hessians = HessianSum((problem.upper > problem.lower).ravel())

        def find_end() -> Status | None:
            is_cancelled = should_stop is not None and should_stop()
            return termination.terminate(progress, current, self.clock() - began, is_cancelled=is_cancelled)

        while True:  # penalty iterations
            while True:  # convexify iterations
                status = find_end()
                if status is not None:
                    return course.finish(status, level.mu)
                local = self._convexify(problem, current, level.mu, hessians, radius)
                is_accepted = False
                while not region.terminate(radius):  # trust region iterations
                    status = find_end()
                    if status is not None:
                        return course.finish(status, level.mu)

                    step = self._minimize_in_box(problem, current, local, radius)
                    course.is_subproblem_failing = step is None
                    if step is None:
                        radius = region.step(radius, radius, is_accepted=False)
                        continue
                    if termination.is_negligible(step.promised, local.merit, current):
                        break

                    trial = _evaluate(problem, current, local, step)
                    is_accepted = region.accept(step.promised, local.merit - trial.merit)
                    current = trial.iterate if is_accepted else current
                    progress = termination.step(progress, current)
                    course.record(local, radius, step, trial, current)
                    local = replace(local, convexify_s=0.0)  # counted once

                    radius = region.step(radius, step.travel, is_accepted=is_accepted)
                    if is_accepted:
                        break
                    status = termination.terminate_rejected(current)
                    if status is not None:
                        return course.finish(status, level.mu)
                    if termination.is_not_worth_searching(step.promised, local.merit, current):
                        break
                if not is_accepted:
                    break
            status = schedule.terminate(level, is_feasible=current.is_feasible)
            if status is not None:
                return course.finish(status, level.mu)
            level, radius = schedule.step(level), region.reopen(radius)

    def _convexify(
        self, problem: Problem[StateT], current: Iterate[StateT], mu: float, hessians: HessianSum, radius: float
    ) -> _Local:
        """Model the merit around an iterate, for steps in a box of a radius or in smaller ones."""
        began = time.perf_counter()
        model = convexify(problem, current.state, mu, hessians)
        is_corrected = self.settings.is_corrected
        asked = drop_idle_rows(model, *_bound_steps(problem, current, radius))
        subproblem = assemble(asked, hessians.is_free, _find_hard_rows(problem, model) if is_corrected else None)
        took_s = time.perf_counter() - began
        correction = Correction.of(problem, current.x, model) if is_corrected else None
        return _Local(mu, current.merit(mu), model, subproblem, correction, took_s)

    def _minimize_in_box(
        self, problem: Problem[StateT], current: Iterate[StateT], local: _Local, radius: float
    ) -> _Step | None:
        """Minimise the model within bounds and trust box; None when no back end finds the minimum."""
        began = time.perf_counter()
        lower, upper = _bound_steps(problem, current, radius)
        dx = self._solve_subproblem(local.subproblem, lower, upper)
        if dx is None:
            return None
        dx = np.asarray(np.clip(dx, lower, upper))
        solve_s = time.perf_counter() - began
        model_merit = local.model.merit(dx)
        travel = float(np.abs(dx.reshape(problem.lower.shape) / _scale_steps(problem)).max(initial=0.0))
        return _Step(dx, travel, model_merit, local.merit - model_merit, solve_s)

    def _solve_subproblem(
        self, subproblem: Subproblem, lower: Float[np.ndarray, "N"], upper: Float[np.ndarray, "N"]
    ) -> Float[np.ndarray, "N"] | None:
        """Solve within step bounds: with the back end, with penalties in place of equalities, with the fall-back."""
        program = subproblem.bound_steps(lower, upper)
        if not program.c.size:  # every variable is fixed; back ends crash on a program without variables
            return subproblem.extract_step(program.c)
        if isinstance(program, ConicProgram):  # convex expressions, which are beyond a QP back end
            solution = solve_clarabel(program)
            return subproblem.extract_step(solution.x) if solution.is_usable else None
        solution = self._solve_qp(program)
        if not solution.is_usable and subproblem.soften is not None:
            return self._solve_subproblem(subproblem.soften(), lower, upper)
        if not solution.is_usable:
            solution = self._solve_qp_fallback(program)
        return subproblem.extract_step(solution.x) if solution.is_usable else None


@dataclass(frozen=True)
class _Local:
    """Model of the merit around one iterate.

    Attributes:
        mu: penalty.
        merit: exact merit at the iterate.
        model: convex model of the merit.
        subproblem: its quadratic program.
        correction: of steps from the iterate; None where they stay as they are.
        convexify_s: wall time [s].
    """

    mu: float
    merit: float
    model: ConvexModel
    subproblem: Subproblem
    correction: Correction | None
    convexify_s: float


@dataclass(frozen=True)
class _Step:
    """Minimiser of the model within a box.

    Attributes:
        dx: (N,) step.
        travel: least trust radius of a box that holds it.
        model_merit: modelled merit after it.
        promised: fall of the merit in the model.
        solve_s: wall time [s].
    """

    dx: Float[np.ndarray, "N"]
    travel: float
    model_merit: float
    promised: float
    solve_s: float


@dataclass(frozen=True)
class _Trial(Generic[StateT]):
    """Iterate after a step.

    Attributes:
        iterate: iterate with its measured terms.
        merit: exact merit there.
        evaluate_s: wall time [s].
    """

    iterate: Iterate[StateT]
    merit: float
    evaluate_s: float


@dataclass
class _Course(Generic[StateT]):
    """Record of one solve.

    Attributes:
        started: of ``time.perf_counter``.
        best: cheapest feasible iterate, else the one with the least excess.
        on_iteration: called with every record.
        history: one record per trial step.
        is_subproblem_failing: whether no back end solved the last subproblem.
    """

    started: float
    best: Iterate[StateT]
    on_iteration: OnIteration | None
    history: list[Iteration] = field(default_factory=list)
    is_subproblem_failing: bool = False

    def record(
        self, local: _Local, radius: float, step: _Step, trial: _Trial[StateT], current: Iterate[StateT]
    ) -> None:
        """Add a trial step that leaves the solve at ``current``: at the trial's iterate if it was accepted."""
        if trial.iterate.is_better_than(self.best):
            self.best = trial.iterate
        iteration = Iteration(
            index=len(self.history),
            penalty=local.mu,
            trust_radius=radius,
            merit=local.merit,
            trial_merit=trial.merit,
            model_merit=step.model_merit,
            is_accepted=current is trial.iterate,
            cost=current.cost,
            violation=current.violation,
            convexify_s=local.convexify_s,
            solve_s=step.solve_s,
            evaluate_s=trial.evaluate_s,
        )
        self.history.append(iteration)
        if self.on_iteration is not None:
            self.on_iteration(iteration, current.x)

    def finish(self, status: Status, mu: float) -> Result:
        """Return the result of a solve that ends with a status and a penalty."""
        if status is Status.STALLED and self.is_subproblem_failing:
            status = Status.SUBPROBLEM_FAILED
        best = self.best
        message = f"{status.value} after {len(self.history)} steps"
        if not best.is_feasible:
            worst = max(best.violation, key=lambda name: best.violation[name], default="")
            message += f"; largest violation {best.violation[worst]:.3g} in '{worst}'"
        return Result(
            x=best.x,
            status=status,
            is_feasible=best.is_feasible,
            cost=best.cost,
            violation=best.violation,
            penalty=mu,
            history=tuple(self.history),
            solve_time_s=time.perf_counter() - self.started,
            message=message,
        )


def _scale_steps(problem: Problem[Any]) -> Float[np.ndarray, "n"]:
    """Return the largest step of each variable relative to the radius."""
    return np.ones(problem.lower.shape[1]) if problem.step_scale is None else problem.step_scale


def _bound_steps(
    problem: Problem[Any], current: Iterate[Any], radius: float
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return the least and the largest step of each variable in the box of a radius."""
    most = radius * _scale_steps(problem)
    lower = np.maximum(problem.lower - current.x, -most).ravel()
    return lower, np.minimum(problem.upper - current.x, most).ravel()


def _evaluate(problem: Problem[StateT], current: Iterate[StateT], local: _Local, step: _Step) -> _Trial[StateT]:
    """Measure the iterate after a step, which is corrected first."""
    began = time.perf_counter()
    dx = step.dx if local.correction is None else local.correction(step.dx)
    iterate = measure(problem, current.x + dx.reshape(current.x.shape))
    return _Trial(iterate, iterate.merit(local.mu), time.perf_counter() - began)


def _find_hard_rows(problem: Problem[Any], model: ConvexModel) -> Bool[np.ndarray, "A"] | None:
    """Find the absolute rows of smooth constraints that are all but met: the correction keeps them there."""
    if model.exact:
        return None
    is_hard = np.zeros(len(model.absolute.weight), dtype=bool)
    for constraint in problem.constraints:
        kind, rows = model.constraint_rows[constraint.name]
        if constraint.residual.is_smooth and kind is Penalty.ABS:
            is_hard[rows] = bool((np.abs(model.absolute.rows.value[rows]) < ALL_BUT_MET).all())
    return is_hard
