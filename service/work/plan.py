"""Planning in a worker: progress and answer are serialized messages of the wire, which the server passes on."""

from __future__ import annotations

import io
import tarfile
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from costs.stopping import Stopped, stops_when
from scopt import Clock, EffortClock
from scopt import Iteration as Trial
from scopt.settings import WALL_SHARE
from service.errors import RequestError
from service.executor import Control
from service.executor.job import JobCancelled
from service.planner import plan
from service.proto.planner.v1.planner_pb2 import Iteration, PlanProgress, PlanResponse
from service.request.schema import PlanRequest
from service.result.folder import VIEWER_NAME
from service.result.output import write_result
from service.result.result import PlanResult
from service.store import find_damaged_uploads
from service.store.seals import hash_file
from service.wire.results import result_to_message
from service.work.robots import RobotCache

REPORT_EVERY_S = 0.02  # shortest time between reported iterations, each of which is a message
MIN_TIME_S = 0.01
MAX_SCENE_BYTES = 256 * 2**20  # of scans that a worker caches
# Share of the time until the deadline that is reserved for curve, certificate and transport of the best attempt.
ANSWER_SHARE, MAX_ANSWER_TIME_S = 0.25, 2.0
WRITE_SLACK, MAX_RESERVED_SHARE = 1.5, 0.7  # for the files: of the longest recent time; of the time left
_WRITE_TIMES_S = deque([0.5], maxlen=8)  # of the files of recent results in this process

if TYPE_CHECKING:
    from perception import Cloud, Memory, Perceived

ROBOTS = RobotCache()  # of this process


@dataclass(frozen=True)
class PlanTask:
    """Task of ``run_plan``.

    Attributes:
        request: request whose paths can be opened by the worker.
        until: deadline of the answer, on the clock of ``Control.now`` [s]; None without one.
        with_files: whether the answer holds the result's files.
        with_waypoints: whether progress holds waypoints.
        original: request as the client sent it; None if it is the same.
        files: paths of the files that the scene names; uploads among them are compared with their hashes.
        notes: further notes of the result.
    """

    request: PlanRequest
    until: float | None = None
    with_files: bool = False
    with_waypoints: bool = False
    original: PlanRequest | None = None
    files: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlanAnswer:
    """Answer of ``run_plan``.

    Attributes:
        verdict: verdict of the plan.
        reply: a serialized ``MotionResult`` without the request's hash, which the server computes meanwhile.
        trajectory_sha256, certificate_sha256: hashes in the reply; empty without trajectory or certificate.
        archive: files of the result as a tar file; empty unless requested.
        page_sha256: hash of the viewer's page among them; empty without one.
        timings: seconds by step, and ``total``.
    """

    verdict: str
    reply: bytes
    trajectory_sha256: str
    certificate_sha256: str
    archive: bytes
    page_sha256: str
    timings: dict[str, float]


@dataclass(frozen=True)
class Refused:
    """A request that cannot be used.

    Attributes:
        problems: one line each.
        damaged: ids of its uploads whose content is not the one that was uploaded; then there are no problems.
    """

    problems: tuple[str, ...]
    damaged: tuple[str, ...] = ()


@contextmanager
def stops_with(control: Control) -> Iterator[None]:
    """Stop the body at its next poll once the job is cancelled.

    Raises:
        JobCancelled: the body was stopped.
    """
    try:
        with stops_when(control.should_stop):
            yield
    except Stopped:
        raise JobCancelled("stopped on request") from None


def run_plan(task: PlanTask, control: Control) -> PlanAnswer | Refused:
    """Plan a request; reports serialized ``PlanResponse``s with its progress."""
    request = task.request
    damaged = find_damaged_uploads(task.files)
    if damaged:
        return Refused((), damaged)
    reporter = _ProgressReporter(control, task.with_waypoints)
    try:
        with stops_with(control):
            robot = ROBOTS.get(request)
        limited, clock = request, None
        if task.until is not None:
            limited, clock = _limit_time(request, task.until - control.now(), task.with_files)
        result = plan(
            limited,
            on_progress=reporter.report_step,
            should_stop=control.should_stop,
            robot=robot,
            on_iteration=reporter.report_iteration,
            see=perceive_cached,
            clock=clock,
        )
    except RequestError as error:
        return Refused(error.problems)
    original = task.original or request
    notes = (*task.notes, *result.notes)
    if request.options.seed != original.options.seed:
        notes = (*notes, f"found with options.seed {request.options.seed}, tried besides {original.options.seed}")
    result = replace(result, request=original, notes=notes)
    message = result_to_message(result, request_sha256="")
    archive, page_sha256 = _make_archive(result) if task.with_files else (b"", "")
    return PlanAnswer(
        result.verdict.value,
        message.SerializeToString(),
        message.trajectory.sha256,
        message.certificate.sha256,
        archive,
        page_sha256,
        {**result.timings, "total": result.planning_time_s},
    )


def perceive_cached(cloud: Cloud, **settings: Any) -> Perceived:
    """Call ``perception.perceive`` with a cache of this process, since the same scan is often planned in again."""
    return _scene_cache().perceive(cloud, **settings)


@cache
def _scene_cache() -> Memory:
    from perception import Memory  # slow to import, and not needed by the server itself

    return Memory(MAX_SCENE_BYTES)


def warm_up() -> None:
    """Load the modules and the robot that many requests need, beyond those imported before the workers are forked."""
    with suppress(ModuleNotFoundError):  # where there is none, no path is sampled
        import ompl.base
        import ompl.geometric  # noqa: F401

    from service.request.file import parse_request

    ROBOTS.get(parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}}))


class _ProgressReporter:
    """Reports a plan's progress as messages."""

    def __init__(self, control: Control, with_waypoints: bool) -> None:
        self._control = control
        self._with_waypoints = with_waypoints
        self._step, self._fraction = "", 0.0
        self._last_report = 0.0

    def report_step(self, name: str, fraction: float) -> None:
        """Report the begin of a step."""
        self._step, self._fraction = name, max(fraction, self._fraction)
        self._send(PlanProgress(step=name, fraction=self._fraction))

    def report_iteration(self, step: str, names: tuple[str, ...], trial: Trial, x: Float[np.ndarray, "T n"]) -> None:
        """Report a trial step of the optimiser."""
        now = time.monotonic()
        if now - self._last_report < REPORT_EVERY_S:
            return
        self._last_report = now
        iteration = Iteration(
            index=trial.index,
            merit=trial.merit,
            mu=trial.penalty,
            trust_radius=trial.trust_radius,
            violations=trial.violation,
            is_accepted=trial.is_accepted,
        )
        if self._with_waypoints:
            iteration.joint_names.extend(names)
            iteration.waypoints.extend(x.ravel())
        self._send(PlanProgress(step=step, fraction=self._fraction, iteration=iteration))

    def _send(self, progress: PlanProgress) -> None:
        self._control.report(PlanResponse(progress=progress).SerializeToString())


def _limit_time(request: PlanRequest, left: float, with_files: bool = False) -> tuple[PlanRequest, Clock | None]:
    """Return the request and the clock with which the answer is there before the deadline.

    Args:
        request: a stated time limit is reduced to what is left; so is the default one if less is left than it.
        left: time left [s].
        with_files: whether the answer holds the result's files.
    """
    reserved = min(ANSWER_SHARE * left, MAX_ANSWER_TIME_S)
    if with_files:
        reserved = min(reserved + WRITE_SLACK * max(_WRITE_TIMES_S), MAX_RESERVED_SHARE * left)
    left = max(left - reserved, MIN_TIME_S)
    if left < request.limit_s:
        return replace(request, options=replace(request.options, time_limit_s=round(left, 3))), None
    if request.options.time_limit_s is not None:
        return request, None
    return request, EffortClock(max(WALL_SHARE, request.limit_s / left))


def _make_archive(result: PlanResult) -> tuple[bytes, str]:
    """Return the files of a result folder as one tar file, and the hash of its page."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="scopt-") as scratch:
        folder = Path(scratch) / "result"
        write_result(result, folder)
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w") as archive:
            for path in sorted(folder.rglob("*")):
                if path.is_file():
                    archive.add(path, path.relative_to(folder).as_posix())
        _WRITE_TIMES_S.append(time.monotonic() - started)
        page = folder / VIEWER_NAME
        return buffer.getvalue(), hash_file(page) if page.is_file() else ""
