"""Planning in a worker: a request in, progress on the way, the answer as bytes of the wire."""

from __future__ import annotations

import io
import tarfile
import tempfile
import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from scopt import Iteration as Trial
from service.errors import RequestError, UnplannedTaskError
from service.executor import Control
from service.planner import plan
from service.proto.planner.v1.planner_pb2 import Iteration, PlanProgress
from service.request.schema import PlanRequest
from service.result.output import write_result
from service.result.result import PlanResult
from service.wire.results import result_to_message
from service.work.robots import WarmRobots
from service.work.stopping import stops_with

REPORT_EVERY_S = 0.02  # iterations are told no more often than this: nobody sees more, and every one is a message
LEAST_TIME_S = 0.01
MOST_SCENE_BYTES = 256 * 2**20  # of scans that a worker remembers
# Of what is left until the deadline, kept for the curve and the certificate of the best attempt, and the way back.
ANSWER_SHARE, MOST_ANSWER_TIME_S = 0.25, 2.0

if TYPE_CHECKING:
    from perception import Cloud, Memory, Perceived

_ROBOTS = WarmRobots()  # of this process


@dataclass(frozen=True)
class PlanTask:
    """What a worker gets.

    Attributes:
        request: what is asked; every path in it can be opened here.
        until: when the answer must be there, on the clock of ``Control.now`` [s]; None: whenever.
        with_files: whether the result's files are wanted.
        with_waypoints: whether progress tells waypoints.
        original: as the client said it, whose hash is the request's; None where it is the same.
        sha256: that hash where it is known already; empty where not.
    """

    request: PlanRequest
    until: float | None = None
    with_files: bool = False
    with_waypoints: bool = False
    original: PlanRequest | None = None
    sha256: str = ""


@dataclass(frozen=True)
class PlanAnswer:
    """What a worker gives back.

    Attributes:
        verdict: how the plan ended.
        reply: a serialized ``MotionResult``.
        trajectory_sha256, certificate_sha256: of what it holds; empty where there is none.
        archive: the files of the result as a tar file; empty where they were not asked for.
        timings: seconds by step, and ``total``.
    """

    verdict: str
    reply: bytes
    trajectory_sha256: str
    certificate_sha256: str
    archive: bytes
    timings: dict[str, float]


@dataclass(frozen=True)
class Refused:
    """A request that cannot be used: one line per problem, and whether it is only that nothing plans its task yet."""

    problems: tuple[str, ...]
    is_unplanned: bool = False


def run_plan(task: PlanTask, control: Control) -> PlanAnswer | Refused:
    """Plan a request; what it reports are bytes of ``PlanProgress``."""
    request = task.request
    teller = _Teller(control, task.with_waypoints)
    try:
        with stops_with(control):
            robot = _ROBOTS.get(request)
        result = plan(
            request if task.until is None else _in_time(request, task.until - control.now()),
            on_progress=teller.step,
            should_stop=control.should_stop,
            robot=robot,
            on_iteration=teller.iteration,
            see=see,
        )
    except RequestError as error:
        return Refused(error.problems, isinstance(error, UnplannedTaskError))
    original = task.original or request
    notes = result.notes
    if request.options.seed != original.options.seed:
        notes = (*notes, f"found with options.seed {request.options.seed}, tried besides {original.options.seed}")
    result = replace(result, request=original, notes=notes)
    message = result_to_message(result, task.sha256)
    return PlanAnswer(
        result.verdict.value,
        message.SerializeToString(),
        message.trajectory.sha256,
        message.certificate.sha256,
        _archive(result) if task.with_files else b"",
        {**result.timings, "total": result.planning_time_s},
    )


def see(cloud: Cloud, **settings: Any) -> Perceived:
    """``perception.perceive``, whose results this process remembers: the same scan is often planned in again."""
    return _scenes().perceive(cloud, **settings)


@cache
def _scenes() -> Memory:
    from perception import Memory  # takes a while, and the server itself sees nothing

    return Memory(MOST_SCENE_BYTES)


def warm_robots() -> WarmRobots:
    """The robots that this process keeps."""
    return _ROBOTS


def warm_up(names: tuple[str, ...] = ("atlas",)) -> None:
    """Load what many requests need and the modules imported for all workers at once do not bring."""
    import ompl.base
    import ompl.geometric  # noqa: F401

    from service.request.file import parse_request

    for name in names:
        request = parse_request({"robot": {"name": name}, "goal": {"posture": "stand"}})
        _ROBOTS.get(request)


class _Teller:
    """Turns what a plan says of itself into messages."""

    def __init__(self, control: Control, with_waypoints: bool) -> None:
        self._control = control
        self._with_waypoints = with_waypoints
        self._step, self._fraction = "", 0.0
        self._told = 0.0

    def step(self, name: str, fraction: float) -> None:
        """Another step begins."""
        self._step, self._fraction = name, max(fraction, self._fraction)
        self._control.report(PlanProgress(step=name, fraction=self._fraction).SerializeToString())

    def iteration(self, step: str, names: tuple[str, ...], trial: Trial, x: Float[np.ndarray, "T n"]) -> None:
        """The optimiser has tried a step."""
        now = time.monotonic()
        if now - self._told < REPORT_EVERY_S:
            return
        self._told = now
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
        progress = PlanProgress(step=step, fraction=self._fraction, iteration=iteration)
        self._control.report(progress.SerializeToString())


def _in_time(request: PlanRequest, left: float) -> PlanRequest:
    """The request with no more time than there is [s]."""
    left = max(left - min(ANSWER_SHARE * left, MOST_ANSWER_TIME_S), LEAST_TIME_S)
    if left >= request.options.time_limit_s:
        return request
    return replace(request, options=replace(request.options, time_limit_s=left))


def _archive(result: PlanResult) -> bytes:
    """The files of a result folder as one tar file."""
    with tempfile.TemporaryDirectory(prefix="scopt-") as scratch:
        folder = Path(scratch) / "result"
        write_result(result, folder)
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w") as archive:
            for path in sorted(folder.rglob("*")):
                if path.is_file():
                    archive.add(path, path.relative_to(folder).as_posix())
        return buffer.getvalue()
