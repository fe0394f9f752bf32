"""The one entry that CLI and server share: a request in, a verdict with its motion and certificate out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from threadpoolctl import ThreadpoolController

from costs.robot import RobotModel
from costs.stopping import Stopped, stops_when
from scopt import Settings
from scopt import Status as SolveStatus
from service.body.monitor import Interrupted, Monitor, OnIteration, OnProgress
from service.body.phases import PhaseSolver, TaskPlan, Terms
from service.body.whole_body import Aims, WholeBody
from service.explain.conflict import Conflict
from service.explain.narrow import explain
from service.motion.execute import make_motion
from service.motion.repair import repaired
from service.motion.timing import TimingSettings
from service.request.schema import Options, PlanRequest, check_planned
from service.result.result import PlanResult, Verdict
from service.setup.prepare import PlanSetup, prepare
from service.tasks import plan_task
from service.verify import Basis, Certificate, Motion, Status, verify

if TYPE_CHECKING:
    from perception import Perceived

MAX_REPAIRS = 3
GRACE_S = 0.2  # after the time limit, for the motion of the best attempt; there is none where that takes longer
# Wall time spent on narrowing down why nothing was found: as long as the search took, within these.
EXPLAIN_LEAST_S, EXPLAIN_MOST_S = 10.0, 60.0
RANK = {Status.VIOLATED: 0, Status.FEASIBLE_AT_SAMPLES: 1, Status.CERTIFIED: 2}
VERDICT_OF_STATUS = {
    Status.CERTIFIED: Verdict.CERTIFIED,
    Status.FEASIBLE_AT_SAMPLES: Verdict.FEASIBLE_AT_SAMPLES,
    Status.VIOLATED: Verdict.NOT_FOUND,
}
VERDICT_OF_INTERRUPT = {
    SolveStatus.TIME_LIMIT: (Verdict.TIME_LIMIT, "the time limit of {limit:g} s was reached during '{step}'"),
    SolveStatus.CANCELLED: (Verdict.CANCELLED, "cancelled during '{step}'"),
}


def plan(
    request: PlanRequest,
    on_progress: OnProgress | None = None,
    should_stop: Callable[[], bool] | None = None,
    robot: RobotModel | None = None,
    terms: Terms | None = None,
    on_iteration: OnIteration | None = None,
    see: Callable[..., Perceived] | None = None,
) -> PlanResult:
    """Plan, time and certify what a request asks for.

    Args:
        request: what is asked.
        on_progress: told the step at work and the fraction done.
        should_stop: asked often; True ends the plan as CANCELLED.
        robot: the request's robot where it is at hand already (a server's, a benchmark's); else it is loaded.
        terms: costs and constraints of the caller's own for every phase, kept at its waypoints like any other; the
            certificate does not speak of them.
        on_iteration: told every trial of the optimiser and the waypoints it is at.
        see: ``perception.perceive``, or what remembers its results (a server's); by default every scan is seen anew.

    Returns:
        The verdict with the best motion found; only a request that cannot be used is an error.

    Raises:
        RequestError: one line per problem of the request or of a file it names.
        UnplannedTaskError: the task is one that nothing here can plan yet.
    """
    check_planned(request)
    # Small matrices all through: BLAS threads cost more than they bring, and another plan can use the core.
    with _one_thread():
        monitor = Monitor(request.options.time_limit_s, should_stop, on_progress, on_iteration)
        setup = prepare(request, lambda step: monitor.report(step, 0.02), robot, monitor.is_over, see)
        return _plan(setup, monitor, terms)


@contextmanager
def _one_thread() -> Iterator[None]:
    """BLAS with one thread; nothing to do where it has no more, as in a server's workers."""
    pools = _thread_pools()
    if all(library.num_threads == 1 for library in pools.lib_controllers if library.user_api == "blas"):
        yield
        return
    with pools.limit(limits=1, user_api="blas"):
        yield


@cache
def _thread_pools() -> ThreadpoolController:
    """The loaded libraries' thread pools; looking for them takes longer than many a plan."""
    return ThreadpoolController()


def _plan(setup: PlanSetup, monitor: Monitor, terms: Terms | None) -> PlanResult:
    request = setup.request
    monitor.timings.update(setup.timings)
    attempt = _Attempt()
    try:
        if setup.is_stopped:
            monitor.check()
            raise Interrupted(SolveStatus.CANCELLED)
        with stops_when(monitor.is_over):
            _run(setup, monitor, attempt, terms)
    except (Interrupted, Stopped) as interruption:
        status = interruption.status if isinstance(interruption, Interrupted) else monitor.why_stopped()
        verdict, text = VERDICT_OF_INTERRUPT[status]
        step = next(reversed(monitor.timings), "set-up")
        attempt.interrupted(verdict, text.format(limit=request.options.time_limit_s, step=step))
        if verdict is Verdict.TIME_LIMIT:
            _show_best(attempt, request.options, monitor)
    return attempt.result(setup, monitor)


@dataclass
class _Attempt:
    """What has been found so far; complete enough at any time to be handed over."""

    verdict: Verdict = Verdict.NOT_FOUND
    explanation: tuple[str, ...] = ()
    task: TaskPlan | None = None
    motion: Motion | None = None
    certificate: Certificate | None = None
    conflict: Conflict | None = None
    unverified: tuple[TaskPlan, Motion] | None = None

    def begin(self, task: TaskPlan) -> None:
        """Turn to another plan of the task; until something is verified it is the one to be handed over."""
        if self.certificate is None:
            self.task, self.explanation = task, task.reasons
            self.verdict = Verdict.INFEASIBLE if task.is_impossible else Verdict.NOT_FOUND

    def keep_better(self, task: TaskPlan, motion: Motion, certificate: Certificate) -> None:
        """Take a verified motion over unless an earlier one did better."""
        if self.certificate is not None and RANK[certificate.status] <= RANK[self.certificate.status]:
            return
        self.task, self.motion, self.certificate = task, motion, certificate
        if task.is_feasible:
            self.verdict = VERDICT_OF_STATUS[certificate.status]
            self.explanation = shortfalls(certificate)

    def interrupted(self, verdict: Verdict, reason: str) -> None:
        """End where time is up or nobody waits any longer."""
        known = () if self.task is None else self.task.reasons
        self.verdict, self.explanation = verdict, (reason, *known)

    def result(self, setup: PlanSetup, monitor: Monitor) -> PlanResult:
        task = self.task
        return PlanResult(
            request=setup.request,
            verdict=self.verdict,
            robot=setup.robot,
            scene=setup.scene if task is None else task.body.scene,
            start=setup.start,
            motion=self.motion,
            certificate=self.certificate,
            explanation=self.explanation,
            conflict=self.conflict,
            found_from="" if task is None else task.found_from,
            notes=(*setup.notes, *(() if task is None else task.notes)),
            planning_time_s=time.perf_counter() - monitor.started,
            timings=monitor.timings,
            figures={} if task is None or self.motion is None else task.measure(self.motion),
            detections=detections_of(setup),
            obstruction=self._obstruction(setup),
            cloud=setup.surroundings.points,
        )

    def _obstruction(self, setup: PlanSetup) -> dict[str, Any] | None:
        """The goal to look at where there is no motion, unless time was up."""
        if self.motion is not None or self.verdict not in (Verdict.INFEASIBLE, Verdict.NOT_FOUND):
            return None
        from service.result.obstruction import obstruction_of  # few results need it

        return obstruction_of(setup)


def _show_best(attempt: _Attempt, options: Options, monitor: Monitor) -> None:
    """Hand over the best motion when time is up, without a certificate: none is begun any more."""
    if attempt.motion is None and attempt.unverified is not None:
        attempt.task, attempt.motion = attempt.unverified
    if attempt.motion is None and attempt.task is not None and attempt.task.phases:
        with suppress(Stopped), stops_when(lambda: monitor.remaining_s() < -GRACE_S):
            attempt.motion = _motion(attempt.task, options)


def _run(setup: PlanSetup, monitor: Monitor, attempt: _Attempt, terms: Terms | None) -> None:
    """Solve the task, make the motion, certify it."""
    options = setup.request.options
    aims = Aims(options.margin_m, options.balance_margin_m)
    body = replace(WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, aims), kept=setup.kept)
    solver = PhaseSolver(body, monitor, Settings(qp=options.qp), most_starts=options.starts, seed=options.seed)
    if terms is not None:
        solver = replace(solver, terms=terms)
    for task in plan_task(setup, solver):
        attempt.begin(task)
        if task.phases:
            _certify(task, options, monitor, attempt)
        if attempt.verdict is Verdict.CERTIFIED:
            return
        if attempt.certificate is not None and task.is_feasible and attempt.certificate.fails_by_description():
            return  # no other motion would do better
    _explain(attempt, solver)


def _explain(attempt: _Attempt, solver: PhaseSolver) -> None:
    """Narrow down what stands in the way where a step had no solution, as far as the time allows."""
    task, monitor = attempt.task, solver.monitor
    stuck = None if task is None else task.stuck
    searched = time.perf_counter() - monitor.started
    left = min(max(EXPLAIN_LEAST_S, searched), EXPLAIN_MOST_S, monitor.remaining_s())
    if task is None or stuck is None or left <= 0.0:
        return
    with monitor.step("explain", 0.95):
        count = monitor.attempts(stuck.step)
        with suppress(Stopped):  # the time that is left was for this
            attempt.conflict = explain(stuck.step, stuck.best, count, solver.settings, left, monitor.should_stop)
    monitor.check_stop()  # half an explanation is none
    if attempt.conflict is not None:
        attempt.explanation = (*attempt.conflict.sentences(), *task.obstacle)


def _certify(task: TaskPlan, options: Options, monitor: Monitor, attempt: _Attempt) -> None:
    """Make the task's motion, certify it, and mend it where that fails."""
    mended: TaskPlan | None = task
    for _ in range(MAX_REPAIRS + 1):
        if mended is None:
            return
        with monitor.step("curve and timing", 0.75):
            motion = _motion(mended, options)
        attempt.unverified = mended, motion
        with monitor.step("certificate", 0.85):
            certificate = verify(motion)
        attempt.keep_better(mended, motion, certificate)
        if not mended.is_feasible or certificate.status is Status.CERTIFIED:
            return
        mended = repaired(mended, motion, certificate, monitor)


def _motion(task: TaskPlan, options: Options) -> Motion:
    timing = TimingSettings(options.velocity_scale, options.acceleration_scale) if options.timed else None
    return make_motion(task, timing)


def shortfalls(certificate: Certificate) -> tuple[str, ...]:
    """What does not hold or, where all of it does, what could not be proven, with the time at which it was seen."""
    checks = certificate.failed() or tuple(c for c in certificate.checks if c.basis is Basis.UNPROVEN)
    times = (None if check.where is None else check.where.time_s for check in checks)
    return tuple(
        check.text if time_s is None else f"{check.text} (at {time_s:.2f} s)"
        for check, time_s in zip(checks, times, strict=True)
    )


def detections_of(setup: PlanSetup) -> tuple[Mapping[str, Any], ...]:
    """What perception recognised, as JSON-ready data."""
    return tuple({"kind": "valve", **asdict(valve)} for valve in setup.surroundings.valves)
