"""An executor whose running jobs can be stopped and report progress: what all pools have in common."""

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
"""Gets what a function reports while it runs; called from a thread of the pool, so it must be quick."""

MAX_ATTEMPTS = 3


class Control(Protocol):
    """What a function gets that has a parameter named ``control``."""

    def should_stop(self) -> bool:
        """Whether the job was cancelled or its deadline has passed; cheap, to be asked every iteration.

        A function that is told so returns what it has, or raises ``JobCancelled``. Nothing is raised in one that does
        not look; its worker is killed after ``grace_s``.
        """
        ...

    def report(self, event: Any) -> None:
        """Hand a small picklable thing to the caller's ``on_event``, in order, before the result."""
        ...

    def now(self) -> float:
        """The time on the caller's clock of ``time.monotonic`` [s].

        That of another machine is told with the job, and is behind by as long as the job took to get here.
        """
        ...


class Job(Future[T]):
    """A submitted call.

    Done-callbacks run in a thread of the pool, or in the one that cancels a queued job: they must be quick.

    Attributes:
        number: counts the pool's jobs from 1.
        deadline: on the clock of ``time.monotonic`` [s].
        submitted: when it was, on the same clock [s].
        started: when it was last begun [s]; None while it never was.
        attempts: how often it was begun.
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
        """Queued: it never runs (``cancelled()``, ``CancelledError``). Running: it is asked to stop, then killed.

        A running function that stops by itself gives the job its result or exception; one that is killed leaves
        ``JobCancelled``, which is a ``CancelledError`` too.

        Returns:
            Whether there was anything left to cancel.
        """
        if super().cancel():
            self._request_stop(self)
            return True
        if self.done():
            return self.cancelled()
        self._request_stop(self)
        return True


class WorkerState(enum.Enum):
    """What a worker is doing."""

    STARTING = "starting"
    IDLE = "idle"
    BUSY = "busy"
    STOPPING = "stopping"


@dataclass(frozen=True)
class WorkerStats:
    """One worker.

    Attributes:
        pid: None until it is known.
        state: what it is doing.
        jobs_done: how many it has answered.
        rss_bytes: resident memory, shared pages included; 0 where it is not known.
    """

    pid: int | None
    state: WorkerState
    jobs_done: int
    rss_bytes: int


@dataclass(frozen=True)
class PoolStats:
    """A pool as it is now.

    Attributes:
        workers: one entry each.
        restarts: how many workers were replaced because they died or were killed.
        queued: jobs that wait.
        running: jobs that run.
        done: jobs that were answered, cancelled ones included.
    """

    workers: tuple[WorkerStats, ...]
    restarts: int
    queued: int
    running: int
    done: int

    @property
    def ready(self) -> int:
        """Workers that are up: idle or busy."""
        return sum(worker.state in (WorkerState.IDLE, WorkerState.BUSY) for worker in self.workers)


class CancellableExecutor(Executor):
    """Runs top-level functions in other processes, first come first served."""

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
            args: picklable, as are ``kwargs`` and what ``fn`` returns.
            on_event: gets what ``fn`` reports; all over again where a job is begun anew after a worker's death.
            deadline: on the clock of ``time.monotonic`` [s]. A job that is queued by then fails without running; one
                that runs is asked to stop and killed as if it were cancelled.
            max_attempts: how often the job is begun before a worker's death is its answer.
            kwargs: of ``fn``.

        Returns:
            The job, done exactly once: with ``fn``'s result or exception, or with ``JobCancelled``,
            ``DeadlineExceeded``, ``WorkerDied``, ``JobFailed``.

        Raises:
            PoolClosed: after ``shutdown`` or ``drain``.
            TypeError: ``fn`` or an argument cannot be pickled.
        """

    @abstractmethod
    def stats(self) -> PoolStats:
        """Workers and queue as they are now."""

    @abstractmethod
    def place(self, job: Job[Any]) -> int | None:
        """1 for the job that is next, None for one that does not wait."""

    @abstractmethod
    def wait_ready(self, timeout: float | None = None) -> bool:
        """Wait until all workers are up; whether they are."""

    @abstractmethod
    def resize(self, workers: int) -> None:
        """Have that many workers from now on; one too many ends after its job."""

    @abstractmethod
    def drain(self, timeout_s: float) -> bool:
        """Take no more jobs, wait for those that are there, cancel what is left after ``timeout_s``.

        Returns:
            Whether all ended by themselves.
        """
