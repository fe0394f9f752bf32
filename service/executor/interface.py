"""The interface of all pools: an executor whose running jobs can be stopped and report progress."""

from __future__ import annotations

import enum
import time
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

T = TypeVar("T")

OnEvent = Callable[[Any], object]
"""Called with each event that a function reports, in a thread of the pool, so it must return quickly."""

MAX_ATTEMPTS = 3


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


class Job(Future[T]):
    """A submitted call.

    Done-callbacks run in a thread of the pool, or in the one that cancels a queued job: they must return quickly.

    Attributes:
        number: counts the pool's jobs from 1.
        deadline: on the clock of ``time.monotonic`` [s].
        submitted: when it was submitted, on the same clock [s].
        started: when it was last started [s]; None before.
        attempts: how often it was started.
        pid: of the worker that runs it, or ran it last.
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


class WorkerState(enum.Enum):
    """State of a worker."""

    STARTING = "starting"
    IDLE = "idle"
    BUSY = "busy"
    STOPPING = "stopping"


@dataclass(frozen=True)
class WorkerStats:
    """State of one worker.

    Attributes:
        pid: its process id; None until it is known.
        state: what it is doing.
        jobs_done: how many jobs it has finished.
        rss_bytes: resident memory, shared pages included; 0 where it is not known.
    """

    pid: int | None
    state: WorkerState
    jobs_done: int
    rss_bytes: int


@dataclass(frozen=True)
class PoolStats:
    """State of a pool.

    Attributes:
        workers: one entry per worker.
        restarts: how many workers were replaced because they died or were killed.
        queued: number of jobs that wait for a worker.
        running: number of jobs that run.
        done: number of jobs that have ended, cancelled ones included.
    """

    workers: tuple[WorkerStats, ...]
    restarts: int
    queued: int
    running: int
    done: int

    @property
    def ready(self) -> int:
        """Number of workers that are up: idle or busy."""
        return sum(worker.state in (WorkerState.IDLE, WorkerState.BUSY) for worker in self.workers)


class CancellableExecutor(Executor):
    """Executor that runs top-level functions in other processes, in order of submission."""

    @abstractmethod
    def submit(  # type: ignore[override]  # its own keywords are not the function's
        self,
        fn: Callable[..., T],
        /,
        *args: Any,
        on_event: OnEvent | None = None,
        deadline: float | None = None,
        max_attempts: int = MAX_ATTEMPTS,
        **kwargs: Any,
    ) -> Job[T]:
        """Run ``fn(*args, **kwargs)``; with ``control=Control`` as well if it has a parameter of that name.

        Args:
            fn: importable from a module by its name.
            args: picklable, as are ``kwargs`` and the result of ``fn``.
            on_event: called with each event that ``fn`` reports, again from the first when the job is started again.
            deadline: on the clock of ``time.monotonic`` [s]. A job still queued then fails without running; a
                running one is asked to stop and killed as if it were cancelled.
            max_attempts: how often the job is started, if its workers die, before it fails with ``WorkerDied``.
            kwargs: of ``fn``.

        Returns:
            The job, which ends exactly once: with ``fn``'s result or exception, or with ``JobCancelled``,
            ``DeadlineExceeded``, ``WorkerDied``, ``JobFailed``.

        Raises:
            PoolClosed: after ``shutdown`` or ``drain``.
            TypeError: ``fn`` or an argument cannot be pickled.
        """

    @abstractmethod
    def stats(self) -> PoolStats:
        """Return the state of workers and queue."""

    @abstractmethod
    def queue_position(self, job: Job[Any]) -> int | None:
        """Return 1 for the job that is next, None for a job that is not queued."""

    @abstractmethod
    def wait_ready(self, timeout: float | None = None) -> bool:
        """Wait until all workers are up; return whether they are."""

    @abstractmethod
    def resize(self, workers: int) -> None:
        """Change the number of workers; a surplus one ends after its job."""

    @abstractmethod
    def drain(self, timeout_s: float) -> bool:
        """Take no more jobs, wait for the accepted ones, and cancel those left after ``timeout_s``.

        Returns:
            Whether all ended without being cancelled here.
        """
