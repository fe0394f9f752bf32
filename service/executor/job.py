"""One job: what its caller and its function see of it, and how it ends, exactly once."""

from __future__ import annotations

import enum
import logging
import pickle
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

LOG = logging.getLogger("service.executor")
T = TypeVar("T")

OnEvent = Callable[[Any], object]
"""Called with each event that a function reports, in a thread of the pool, so it must return quickly."""


class ExecutorError(Exception):
    """Base of all errors of executors: how a job ends whose function neither returned nor raised."""


class PoolClosed(ExecutorError, RuntimeError):  # noqa: N818 - named for the state
    """The executor takes no more jobs."""


class JobCancelled(ExecutorError, CancelledError):  # noqa: N818
    """The job was cancelled while it ran: its function raised this, or its worker was killed."""


class DeadlineExceeded(ExecutorError):  # noqa: N818
    """The deadline passed before the job started, or while it ran and it returned no result."""


class JobFailed(ExecutorError):  # noqa: N818
    """The function raised or returned something that cannot be pickled; the text describes it."""


class WorkerDied(ExecutorError):  # noqa: N818
    """Each worker that ran the job died, or no worker could be started.

    Attributes:
        cause: what ended the last worker: a signal's name, ``exit 3``, ``lost``.
        attempts: how often the job was started.
        last_output: the end of the last worker's standard error.
    """

    def __init__(self, cause: str, attempts: int, last_output: str = "") -> None:
        super().__init__(cause, attempts, last_output)
        self.cause, self.attempts, self.last_output = cause, attempts, last_output

    def __str__(self) -> str:
        times = f"{self.attempts} time{'' if self.attempts == 1 else 's'}"
        output = f"; its last output: {self.last_output}" if self.last_output else ""
        return f"worker ended ({self.cause}), job started {times}{output}"


class Control(Protocol):
    """The argument of a function that has a parameter named ``control``."""

    def should_stop(self) -> bool:
        """Return whether the job was cancelled or its deadline has passed; cheap enough for every iteration.

        The function then returns what it has, or raises ``JobCancelled``. No exception is raised in a function that
        does not call this; its worker is killed after ``grace_s``.
        """
        ...

    def report(self, event: Any) -> None:
        """Send a small picklable event to the caller's ``on_event``; events arrive in order and before the result."""
        ...

    def now(self) -> float:
        """Return the time on the caller's clock of ``time.monotonic`` [s].

        A worker on another machine gets that clock with the job; its time is late by the job's way there.
        """
        ...


class Lane(enum.IntEnum):
    """Kind of order; a job of a lower number goes first."""

    LIGHT = 0  # short; also runs on workers that take nothing else
    INTERACTIVE = 1
    BATCH = 2


@dataclass(frozen=True)
class Place:
    """Whose job it is and how it waits.

    Attributes:
        owner: owners of a lane share the workers equally; jobs of one owner keep their order.
        lane: lane of the job.
    """

    owner: str = ""
    lane: Lane = Lane.INTERACTIVE


NOBODY = Place()  # of jobs that are all alike


class Job(Future[T]):
    """A submitted call.

    Done-callbacks run in a thread of the pool, or in the one that cancels a queued job: they must return quickly.

    Attributes:
        number: counts the pool's jobs from 1.
        deadline: on the clock of ``time.monotonic`` [s].
        submitted: when it was submitted, on the same clock [s].
        started: when it was last started [s]; None before.
        attempts: how often it was started.
        pid: of the worker that runs it, or ran it last; None while it waits for one.
    """

    def __init__(self, number: int, deadline: float | None, request_stop: Callable[[Job[Any]], None]) -> None:
        super().__init__()
        self.number = number
        self.deadline = deadline
        self.submitted = time.monotonic()
        self.started: float | None = None
        self.attempts = 0
        self.pid: int | None = None
        self._request_stop = request_stop

    def cancel(self) -> bool:
        """Cancel the job: a queued one never runs, a running one is asked to stop, then killed.

        A job cancelled while queued is ``cancelled()``. A running function that stops by itself gives the job its
        result or exception; one that is killed gives it ``JobCancelled``, which is a ``CancelledError`` too.

        Returns:
            False when the job had ended already.
        """
        if super().cancel():
            self._request_stop(self)
            return True
        if self.done():
            return self.cancelled()
        self._request_stop(self)
        return True


class StopReason(enum.Enum):
    """Why a job is asked to stop."""

    CANCELLED = "cancelled"
    DEADLINE = "the deadline passed"

    def make_error(self, text: str) -> ExecutorError:
        """Return the exception that ends the job; ``text`` says what it was doing."""
        kind = JobCancelled if self is StopReason.CANCELLED else DeadlineExceeded
        return kind(f"{self.value}{text}")


@dataclass(eq=False)
class JobRecord:
    """A job with what the pool needs to run it; its methods are for the supervisor's thread.

    Attributes:
        job: the caller's side of it.
        payload: the pickled call.
        on_event: called with each event that the function reports.
        max_attempts: how often the job may be started.
        stop_reason: why it was asked to stop; None while it was not.
        place: whose job it is and how it waits.
    """

    job: Job[Any]
    payload: bytes
    on_event: OnEvent | None
    max_attempts: int
    stop_reason: StopReason | None = None
    place: Place = NOBODY

    def claim(self) -> bool:
        """Mark the job as running, so that ``cancel`` no longer ends it directly; False when it was cancelled."""
        return self.job.attempts > 0 or self.job.set_running_or_notify_cancel()

    def note_start(self, pid: int | None) -> None:
        """Note that a worker starts the job now."""
        self.job.started, self.job.pid, self.job.attempts = time.monotonic(), pid, self.job.attempts + 1

    def deliver_event(self, payload: bytes) -> None:
        """Pass a pickled event to the caller; errors in that are logged, and the job goes on."""
        if self.on_event is None:
            return
        try:
            self.on_event(pickle.loads(payload))
        except Exception:
            LOG.exception("an event of job %d could not be delivered", self.job.number)

    def set_returned(self, payload: bytes) -> None:
        """End the job with a pickled result."""
        try:
            result = pickle.loads(payload)
        except Exception as error:
            self.fail(_describe_unreadable(error))
        else:
            self.job.set_result(result)

    def set_raised(self, payload: bytes) -> None:
        """End the job with an exception pickled by ``worker.pickle_exception``."""
        try:
            error, summary, trace = pickle.loads(payload)
        except Exception as unread:
            self.fail(_describe_unreadable(unread))
            return
        if isinstance(error, JobCancelled):
            error = None if self.stop_reason is None else self.stop_reason.make_error("; it stopped by itself")
        raised: Exception = JobFailed(summary) if error is None else error
        raised.__cause__ = RemoteTraceback(trace)
        self.fail(raised)

    def set_killed(self) -> None:
        """End the job, whose worker was killed because it did not stop."""
        if self.stop_reason is None:  # a worker's message alone ends no job without a result
            self.fail(ExecutorError("ended although it was not asked to stop"))
        else:
            self.fail(self.stop_reason.make_error("; it did not stop by itself and was ended"))

    def set_dropped(self, reason: StopReason) -> None:
        """End the job, which was queued."""
        if reason is StopReason.CANCELLED:
            self.fail(reason.make_error(" while it waited for another worker"))
        else:
            self.fail(reason.make_error(f" while it waited, started {self.job.attempts} times"))

    def fail(self, error: Exception) -> None:
        """End the job with an exception, unless it has ended."""
        if not self.job.done():
            self.job.set_exception(error)


class RemoteTraceback(Exception):  # noqa: N818
    """The traceback of an exception that was raised in a worker."""

    def __init__(self, trace: str) -> None:
        super().__init__(trace)
        self.trace = trace

    def __str__(self) -> str:
        return f"\n{self.trace}"


def _describe_unreadable(error: Exception) -> JobFailed:
    return JobFailed(f"its result cannot be unpickled here: {type(error).__name__}: {error}")
