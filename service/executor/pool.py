"""The caller's side that all pools have in common: accepts jobs and passes requests to the supervisor thread."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from service.executor.errors import PoolClosed
from service.executor.interface import (
    MAX_ATTEMPTS,
    CancellableExecutor,
    Job,
    OnEvent,
    PoolStats,
    WorkerState,
    WorkerStats,
)
from service.executor.job_queue import JobQueue, JobRecord
from service.executor.supervisor import Supervisor

T = TypeVar("T")


class Pool(CancellableExecutor):
    """An executor whose jobs are queued and run by a supervisor's workers."""

    def __init__(self, queue: JobQueue, supervisor: Supervisor[Any]) -> None:
        self._queue = queue
        self._supervisor = supervisor
        self._lock = threading.Lock()
        self._is_closed = False
        self._n_submitted = 0

    def submit(  # type: ignore[override]
        self,
        fn: Callable[..., T],
        /,
        *args: Any,
        on_event: OnEvent | None = None,
        deadline: float | None = None,
        max_attempts: int = MAX_ATTEMPTS,
        **kwargs: Any,
    ) -> Job[T]:
        payload = _pickle_call(fn, args, kwargs)
        with self._lock:
            if self._is_closed:
                raise PoolClosed("the pool is closed and takes no more jobs")
            self._n_submitted += 1
            job: Job[T] = Job(self._n_submitted, deadline, self._request_stop)
            self._queue.put(JobRecord(job, payload, on_event, max_attempts))
        if not self._supervisor.wake():
            raise PoolClosed("the pool failed; see its log")
        return job

    def stats(self) -> PoolStats:
        workers = tuple(WorkerStats(w.pid, w.state, w.jobs_done, w.rss_bytes) for w in self._supervisor.workers)
        return PoolStats(
            workers=workers,
            restarts=self._supervisor.restarts,
            queued=self._queue.n_queued,
            running=sum(worker.state is WorkerState.BUSY for worker in workers),
            done=self._queue.n_done,
        )

    def queue_position(self, job: Job[Any]) -> int | None:
        return self._queue.position(job)

    def wait_ready(self, timeout: float | None = None) -> bool:
        return self._supervisor.wait_ready(timeout)

    def resize(self, workers: int) -> None:
        check_workers(workers)
        self._supervisor.target = workers
        self._supervisor.wake()

    def drain(self, timeout_s: float) -> bool:
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
            for record in self._queue.list_queued():
                record.job.cancel()
        self._supervisor.close(wait)

    def _refuse_jobs(self) -> None:
        with self._lock:
            self._is_closed = True

    def _request_stop(self, job: Job[Any]) -> None:
        record = self._queue.find(job.number)
        if record is None:
            return
        if job.cancelled():  # it never started
            if self._queue.withdraw(record):  # else the supervisor is taking it
                job.set_running_or_notify_cancel()  # `concurrent.futures.wait` looks for this
                self._queue.close(record)
            self._supervisor.wake()
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


def check_callable(fn: Callable[..., Any] | None) -> None:
    """Refuse a function that workers cannot import.

    Raises:
        TypeError: it is of the main script, which workers do not import.
    """
    if getattr(fn, "__module__", None) == "__main__":
        name = getattr(fn, "__qualname__", fn)
        raise TypeError(f"{name} is a function of the main script; workers know only functions of modules")


def check_workers(workers: int) -> None:
    """Refuse a pool without workers.

    Raises:
        ValueError: ``workers`` is less than 1.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1; got {workers}")
