"""An executor of worker processes on this machine."""

from __future__ import annotations

import logging
import pickle
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from service.executor import linux
from service.executor.backlog import Backlog, Task
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
from service.executor.supervisor import Settings, Supervisor

T = TypeVar("T")

_LOG = logging.getLogger("service.executor")


class LocalPool(CancellableExecutor):
    """Long-lived worker processes, forked from one that has imported what they need.

    The workers, and whatever they start, end with this process, however it ends. The functions they run are looked up
    by name in modules; the main script is not imported again, so its own functions cannot be run.
    """

    def __init__(
        self,
        workers: int,
        *,
        warm_up: Callable[[], object] | None = None,
        preload: tuple[str, ...] = (),
        grace_s: float = 0.25,
        max_bytes: int | None = None,
        recycle_after: int | None = None,
        start_timeout_s: float = 120.0,
    ) -> None:
        """Start workers; ``wait_ready`` waits for them.

        Args:
            workers: how many.
            warm_up: top-level function, called once in each worker before it takes jobs.
            preload: modules that are imported once and shared by all workers; where one starts threads, every worker
                imports them for itself.
            grace_s: from asking a job to stop to killing its worker [s].
            max_bytes: address space of a worker; None for no limit.
            recycle_after: jobs after which a worker is replaced; None for never.
            start_timeout_s: in which modules are imported, and in which a worker becomes ready [s].
        """
        _check_workers(workers)
        check_callable(warm_up)
        self._backlog = Backlog()
        self._lock = threading.Lock()
        self._is_closed = False
        self._submitted = 0
        settings = Settings(warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s)
        self._supervisor = Supervisor(workers, settings, self._backlog)

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
        payload = pickled_call(fn, args, kwargs)
        with self._lock:
            if self._is_closed:
                raise PoolClosed("the pool is closed and takes no more jobs")
            self._submitted += 1
            job: Job[T] = Job(self._submitted, deadline, self._request_stop)
            self._backlog.put(Task(job, payload, on_event, max_attempts))
        if not self._supervisor.wake():
            raise PoolClosed("the pool failed; its log says why")
        return job

    def stats(self) -> PoolStats:
        workers = list(self._supervisor.workers.values())
        return PoolStats(
            workers=tuple(
                WorkerStats(w.pid, w.state, w.jobs_done, 0 if w.pid is None else linux.rss_bytes(w.pid))
                for w in workers
            ),
            restarts=self._supervisor.restarts,
            queued=self._backlog.queued,
            running=sum(worker.state is WorkerState.BUSY for worker in workers),
            done=self._backlog.done,
        )

    def place(self, job: Job[Any]) -> int | None:
        return self._backlog.place(job)

    def wait_ready(self, timeout: float | None = None) -> bool:
        return self._supervisor.wait_ready(timeout)

    def resize(self, workers: int) -> None:
        _check_workers(workers)
        self._supervisor.target = workers
        self._supervisor.wake()

    def drain(self, timeout_s: float) -> bool:
        self._refuse_more()
        ended_by_themselves = self._backlog.wait_empty(timeout_s)
        if not ended_by_themselves:
            self._cancel_all()
            self._backlog.wait_empty(None)
        return ended_by_themselves

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs and end the workers once those that are there are answered.

        Args:
            wait: until that is so.
            cancel_futures: cancel the jobs that wait; those that run go on.
        """
        self._refuse_more()
        if cancel_futures:
            for task in self._backlog.all_queued():
                task.job.cancel()
        self._supervisor.close(wait)

    def _refuse_more(self) -> None:
        with self._lock:
            self._is_closed = True

    def _cancel_all(self) -> None:
        for task in self._backlog.all_open():
            task.job.cancel()

    def _request_stop(self, job: Job[Any]) -> None:
        task = self._backlog.find(job.number)
        if task is None:
            return
        if job.cancelled():  # it never began
            if self._backlog.withdraw(task):  # else the supervisor has it in hand
                job.set_running_or_notify_cancel()  # those who wait for several jobs look for this
                self._backlog.answered(task)
            self._supervisor.wake()
        else:
            self._supervisor.cancel(task)


def pickled_call(fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> bytes:
    """A call as bytes.

    Raises:
        TypeError: it cannot be pickled.
    """
    check_callable(fn)
    try:
        return pickle.dumps((fn, args, kwargs), pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise TypeError(
            f"function and arguments must be picklable, the function by its name in a module: {error}"
        ) from error


def check_callable(fn: Callable[..., Any] | None) -> None:
    """
    Raises:
        TypeError: it is of the main script, which workers do not import.
    """
    if getattr(fn, "__module__", None) == "__main__":
        name = getattr(fn, "__qualname__", fn)
        raise TypeError(f"{name} is a function of the main script; workers know only functions of modules")


def _check_workers(workers: int) -> None:
    if workers < 1:
        raise ValueError(f"workers must be at least 1; got {workers}")
