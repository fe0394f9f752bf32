"""The planner: one request in, one verdict with its motion and certificate out.

PlanRequest -> setup.prepare -> PlanSetup      robot at its start in its world, checked
            -> tasks.plan_task -> TaskPlan     phases solved by the optimiser, several alternatives on demand
            -> motion.make_motion -> Motion    smooth curve and time law
            -> verify -> Certificate           proof or refutation; motion.repair_plan adds waypoints where it fails
            -> explain -> Conflict             only where no motion was certified
            -> result.Attempt -> PlanResult
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from threadpoolctl import ThreadpoolController

from costs.robot import RobotModel
from costs.static_region import StaticRegionError
from costs.stopping import Stopped, stops_when
from scopt import Clock, EffortClock, Settings
from scopt import Status as SolveStatus
from service.body.aims import Aims
from service.body.monitor import Interrupted, Monitor, OnIteration, OnProgress
from service.body.phases import Map, PhaseSolver, Terms, no_terms
from service.body.task_plan import TaskPlan
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.errors import RequestError
from service.motion.execute import make_motion, repair_plan
from service.motion.expected_sag import expect_sag
from service.motion.jams import list_jam_notes
from service.motion.timing import TimingSettings
from service.request.schema import Options, PlanRequest
from service.result.attempt import Attempt
from service.result.result import PlanResult, Verdict
from service.setup.earlier import begin_with
from service.setup.prepare import PlanSetup, prepare
from service.tasks import plan_task
from service.verify import Approach, Motion, Status, VerifySettings, verify

if TYPE_CHECKING:
    from perception import Perceived
    from service.setup.world import Surroundings

MAX_REPAIRS = 3
GRACE_S = 0.2  # allowed after the time limit to make the motion of the best attempt
# An explanation may take as long as the search took, within these limits.
EXPLAIN_LEAST_S, EXPLAIN_MOST_S = 10.0, 60.0
# Of a motion that the optimiser calls infeasible: one that keeps clear is proven with few, long intervals, and one that
# grazes something would take them all before the search goes on.
CANDIDATE = VerifySettings(max_halvings=6, max_intervals=6_000)
VERDICT_OF_INTERRUPT = {
    SolveStatus.TIME_LIMIT: (Verdict.TIME_LIMIT, "the {limit} was reached during '{step}'"),
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
    around: Surroundings | None = None,
    map: Map = map,
    clock: Clock | None = None,
    start_from: PlanResult | Float[np.ndarray, "T n"] | None = None,
) -> PlanResult:
    """Plan, time and certify the motion that a request describes.

    Args:
        request: the request.
        on_progress: called with the name of the current step and the fraction of the plan that is done.
        should_stop: polled often; once it returns True the plan ends as CANCELLED.
        robot: the request's robot if it is loaded already (a server's, a benchmark's).
        terms: the caller's own costs and constraints for every phase; the certificate does not cover them.
        on_iteration: called after every trial step of the optimiser.
        see: ``perception.perceive``, or a function that caches its results (a server's).
        around: what the request's scan shows, if it is known already (from an earlier plan's result).
        map: calls a function for every one of many independent poses (``task.egress``) and returns the results in
            order, such as that of a ``concurrent.futures.ProcessPoolExecutor`` or of Ray's ``ActorPool``.
        clock: measures the time limit; by default wall time for ``options.time_limit_s`` and effort
            (``scopt.EffortClock``) for the limit of a request that states none.
        start_from: an earlier result whose motion led from near the start to near the goal of a reach, or waypoints of
            the robot's coordinates: the search begins with them, bent to the new ends. A note says where they are no
            help.

    Returns:
        The verdict with the best motion found. A plan that fails is a result, not an error.

    Raises:
        RequestError: one line per problem of the request or of a file it names.
    """
    with _single_blas_thread():
        started = time.perf_counter()
        if clock is None:
            clock = EffortClock() if request.options.time_limit_s is None else time.monotonic
        monitor = Monitor(request.limit_s, should_stop, on_progress, on_iteration, clock)
        on_step = lambda step: monitor.report(step, 0.02)  # noqa: E731
        setup = prepare(request, on_step, robot, monitor.is_over, see, around=around, finds_package=True)
        if start_from is not None:
            setup = begin_with(setup, start_from.waypoints if isinstance(start_from, PlanResult) else start_from)
        monitor.timings.update(setup.timings)
        attempt = Attempt()
        try:
            if setup.is_stopped:
                raise Interrupted(monitor.stop_reason())
            with stops_when(monitor.is_over):
                solver = replace(_make_solver(setup, monitor, terms), map=map)
                if not _search(setup, solver, attempt):
                    _explain(attempt, solver)
        except (Interrupted, Stopped) as interruption:
            status = interruption.status if isinstance(interruption, Interrupted) else monitor.stop_reason()
            _record_interruption(attempt, status, request, monitor)
        result = _expect_sag(attempt.to_result(setup, monitor.timings))
        return replace(result, planning_time_s=time.perf_counter() - started, tried=tuple(monitor.tried))


def _expect_sag(result: PlanResult) -> PlanResult:
    """Return the result of a complete plan with the sag of its centre of mass and hands on the request's servos."""
    if result.motion is None or result.verdict not in (Verdict.CERTIFIED, Verdict.FEASIBLE_AT_SAMPLES):
        return result
    servo, notes = expect_sag(result.motion, result.robot, result.request, result.certificate)
    return replace(
        result, servo=servo, notes=(*result.notes, *notes, *list_jam_notes(result.motion), *_note_missed_margin(result))
    )


def _note_missed_margin(result: PlanResult) -> Iterator[str]:
    """Yield a sentence where a motion is clearly nearer to an obstacle than a margin that the request widened."""
    options, certificate = result.request.options, result.certificate
    pair = None if certificate is None else certificate.min_clearance_pair
    if certificate is None or pair is None or options.margin_m <= Options().margin_m:
        return
    if {piece.name for piece in result.scene.pieces}.isdisjoint(pair):
        return
    if certificate.min_clearance_m < options.margin_m - CLEARANCE_TOLERANCE:
        yield (
            f"options.margin_m aims at {1e3 * options.margin_m:g} mm, and {pair[0]} comes within "
            f"{1e3 * certificate.min_clearance_m:.0f} mm of {pair[1]}; "
            "options.clearance_m or options.padding demand a distance"
        )


def _make_solver(setup: PlanSetup, monitor: Monitor, terms: Terms | None) -> PhaseSolver:
    """Return the solver of the phases: the robot planted at its start, with the request's margins and settings."""
    options = setup.request.options
    aims = Aims.of(options, setup.robot, setup.scene)
    try:
        body = replace(WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, aims), kept=setup.kept)
    except StaticRegionError as error:
        raise RequestError(f"start is out of balance: {error}") from None
    solver = PhaseSolver(
        body,
        monitor,
        Settings(qp=options.qp),
        most_starts=options.starts,
        seed=options.seed,
        hand_friction=options.hand_friction,
    )
    return solver if terms is None else replace(solver, terms=terms)


def _search(setup: PlanSetup, solver: PhaseSolver, attempt: Attempt) -> bool:
    """Certify one plan of the task after another; return whether the last is final.

    Where links meet that the robot's files leave out, the search begins anew with these kept apart.
    """
    for task in plan_task(setup, solver):
        attempt.begin(task)
        if task.phases:
            _certify(task, setup, solver, attempt)
        body = solver.body
        if attempt.verdict is not Verdict.CERTIFIED and not attempt.meeting <= body.kept_apart:
            apart = body.keep_apart(attempt.meeting)
            if apart.kept_apart != body.kept_apart:
                return _search(setup, replace(solver, body=apart), attempt)
        if attempt.is_final(task):
            return True
    return False


def _certify(task: TaskPlan, setup: PlanSetup, solver: PhaseSolver, attempt: Attempt) -> None:
    """Make the task's motion, verify it, and repair it where a check fails.

    A motion that the optimiser calls infeasible counts as solved if it does the whole task and its certificate holds,
    unless the caller's own terms are in it, which no certificate covers.
    """
    monitor = solver.monitor
    repaired: TaskPlan | None = task
    for _ in range(MAX_REPAIRS + 1):
        if repaired is None:
            return
        with monitor.step("curve and timing", 0.75):
            motion = _make_motion(repaired, setup.request)
        attempt.unverified = repaired, motion
        with monitor.step("certificate", 0.85):
            is_solved = repaired.is_feasible
            settings = VerifySettings() if is_solved else CANDIDATE
            certificate = verify(motion, settings)
            if not is_solved and solver.terms is no_terms and certificate.status is not Status.VIOLATED:
                from service.replay.whole import certify_whole  # loads what every kind of task demands

                whole = certify_whole(setup, motion, settings)
                if whole is not None and whole.status is not Status.VIOLATED:
                    repaired, certificate = repaired.as_solved(), whole
        attempt.keep_better(repaired, motion, certificate)
        if not is_solved or certificate.status is Status.CERTIFIED:
            return
        repaired = repair_plan(repaired, motion, certificate, monitor)


def _make_motion(task: TaskPlan, request: PlanRequest) -> Motion:
    options, resume = request.options, request.resume
    timing = TimingSettings(options.speed_share, options.acceleration_share)
    if options.pace is not None:
        timing = TimingSettings.at_pace(options.pace)
    start_rates, end_rates = request.end_rates
    timing = replace(
        timing,
        jerk_scale=options.jerk_scale,
        tool_speed_m_s=options.tool_speed_m_s,
        approach=Approach.of(request.hand_servo),
        start_rates=start_rates,
        end_rates=end_rates,
    )
    motion = make_motion(task, timing if options.timed else None)
    return motion if resume is None else replace(motion, continues=resume.plan)


def _explain(attempt: Attempt, solver: PhaseSolver) -> None:
    """Find the constraints that conflict at the step that has no solution, as far as the time allows."""
    task, monitor = attempt.task, solver.monitor
    stuck = None if task is None else task.stuck
    left = min(max(EXPLAIN_LEAST_S, monitor.elapsed_s()), EXPLAIN_MOST_S, monitor.remaining_s())
    if stuck is None or left <= 0.0:
        return
    from service.explain.narrow import explain  # only where no motion was certified

    with monitor.step("explain", 0.95):
        count = monitor.count_attempts(stuck.step)
        conflict = None
        with suppress(Stopped):  # out of the explanation's own time
            conflict = explain(stuck.step, stuck.best, count, solver.settings, left, monitor.should_stop, monitor.clock)
    monitor.check_stop()  # a cancelled explanation is incomplete
    if conflict is not None:
        attempt.explain(conflict)


def _record_interruption(attempt: Attempt, status: SolveStatus, request: PlanRequest, monitor: Monitor) -> None:
    """Set the verdict of an interrupted plan; when time is up, return the best motion without a certificate."""
    verdict, text = VERDICT_OF_INTERRUPT[status]
    step = next(reversed(monitor.timings), "set-up")
    delay = monitor.describe_delay() if verdict is Verdict.TIME_LIMIT else ()
    attempt.interrupt(verdict, text.format(limit=_describe_limit(request), step=step), delay)
    if verdict is Verdict.TIME_LIMIT:
        with suppress(Stopped), stops_when(lambda: monitor.remaining_s() < -GRACE_S):
            attempt.take_unverified(lambda task: _make_motion(task, request))


def _describe_limit(request: PlanRequest) -> str:
    if request.options.time_limit_s is not None:
        return f"time limit of {request.limit_s:g} s"
    return f"default limit of {request.limit_s:g} s of processor time"


@contextmanager
def _single_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread: the matrices are small, and other plans can use the other cores."""
    pools = _thread_pools()
    if all(library.num_threads == 1 for library in pools.lib_controllers if library.user_api == "blas"):
        yield  # as in a server's workers
        return
    with pools.limit(limits=1, user_api="blas"):
        yield


@cache
def _thread_pools() -> ThreadpoolController:
    """Return the loaded libraries' thread pools; the search for them takes longer than many plans."""
    return ThreadpoolController()
