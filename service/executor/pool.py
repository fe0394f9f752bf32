"""The callers' side of all pools: an executor whose running jobs can be stopped and report progress."""

from __future__ import annotations

import asyncio
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

from service.executor.job import NOBODY, Job, JobRecord, OnEvent, Place, PoolClosed
from service.executor.job_queue import JobQueue
from service.executor.supervisor import Supervisor, check_callable, check_workers
from service.executor.worker_handle import WorkerState

T = TypeVar("T")
MAX_ATTEMPTS = 3


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
        restarts: how many workers were replaced because they died or were killed, but for those of jobs that were
            asked to stop.
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


class Pool(Executor):
    """Executor that runs top-level functions in other processes, each owner's in order of submission."""

    def __init__(self, queue: JobQueue, supervisor: Supervisor[Any]) -> None:
        self._queue = queue
        self._supervisor = supervisor
        self._lock = threading.Lock()
        self._is_closed = False
        self._n_submitted = 0

    def submit(  # type: ignore[override]  # its own keywords are not the function's
        self,
        fn: Callable[..., T],
        /,
        *args: Any,
        on_event: OnEvent | None = None,
        deadline: float | None = None,
        max_attempts: int = MAX_ATTEMPTS,
        place: Place = NOBODY,
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
            place: whose job it is and how it waits; owners share the workers equally.
            kwargs: of ``fn``.

        Returns:
            The job, which ends exactly once: with ``fn``'s result or exception, or with ``JobCancelled``,
            ``DeadlineExceeded``, ``WorkerDied``, ``JobFailed``.

        Raises:
            PoolClosed: after ``shutdown`` or ``drain``.
            TypeError: ``fn`` or an argument cannot be pickled.
        """
        payload = _pickle_call(fn, args, kwargs)
        with self._lock:
            if self._is_closed:
                raise PoolClosed("the pool is closed and takes no more jobs")
            self._n_submitted += 1
            job: Job[T] = Job(self._n_submitted, deadline, self._request_stop)
            record = JobRecord(job, payload, on_event, max_attempts, place=place)
            self._queue.put(record)
        if not self._supervisor.accept(record):
            raise PoolClosed("the pool failed; see its log")
        return job

    def stats(self) -> PoolStats:
        """Return the state of workers and queue."""
        workers = tuple(WorkerStats(w.pid, w.state, w.jobs_done, w.rss_bytes) for w in self._supervisor.workers)
        return PoolStats(
            workers=workers,
            restarts=self._supervisor.restarts,
            queued=self._queue.n_queued,
            running=sum(worker.state is WorkerState.BUSY for worker in workers),
            done=self._queue.n_done,
        )

    def queue_position(self, job: Job[Any]) -> int | None:
        """Return 1 for the job that is next, None for a job that is not queued."""
        return self._queue.position(job)

    def wait_ready(self, timeout: float | None = None) -> bool:
        """Wait until all workers are up; return whether they are."""
        return self._supervisor.wait_ready(timeout)

    def read_in(self, loop: asyncio.AbstractEventLoop) -> AbstractContextManager[None]:
        """Have a running event loop read what workers send, in the body of the returned context.

        Jobs then end, and report their events, in that loop's thread: no other thread has to be woken. Where the pool
        cannot do this, they end in a thread of the pool as before.
        """
        return self._supervisor.read_in(loop)

    def resize(self, workers: int) -> None:
        """Change the number of workers; a surplus one ends after its job."""
        check_workers(workers)
        self._supervisor.resize(workers)

    def drain(self, timeout_s: float) -> bool:
        """Take no more jobs, wait for the accepted ones, and cancel those left after ``timeout_s``.

        Returns:
            Whether all ended without being cancelled here.
        """
        self._refuse_jobs()
        all_ended = self._queue.wait_empty(timeout_s)
        if not all_ended:
            for record in reversed(self._queue.list_open()):  # else queued jobs would start
                record.job.cancel()
            self._queue.wait_empty(None)
        return all_ended

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs, and end the workers once all jobs have ended.

        Args:
            wait: return only then.
            cancel_futures: cancel the queued jobs; running ones go on.
        """
        self._refuse_jobs()
        if cancel_futures:
            for record in self._queue.list_open(only_queued=True):
                record.job.cancel()
        self._supervisor.close(wait)

    def _refuse_jobs(self) -> None:
        with self._lock:
            self._is_closed = True

    def _request_stop(self, job: Job[Any]) -> None:
        record = self._queue.find(job.number)
        if record is None:
            self._supervisor.wake()  # it was queued, and may have been the last one
        else:
            self._supervisor.cancel(record)


def _pickle_call(fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> bytes:
    """Pickle a call.

    Raises:
        TypeError: it cannot be pickled.
    """
    check_callable(fn)
    try:
        return pickle.dumps((fn, args, kwargs), pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        message = f"function and arguments must be picklable, the function by its name in a module: {error}"
        raise TypeError(message) from error
