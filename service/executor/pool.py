"""What pools share: the caller's side, which takes jobs and asks a supervisor to look after them."""

from __future__ import annotations

import pickle
import threading
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

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

T = TypeVar("T")


class Supervision(Protocol):
    """A thread that has workers answer a backlog's tasks; what other threads may ask of it.

    Attributes:
        target: how many workers there shall be.
        restarts: how many died or were killed.
    """

    target: int
    restarts: int

    def wake(self) -> bool:
        """Have the thread look after everything now; False when it has ended."""
        ...

    def cancel(self, task: Task) -> None:
        """Have a job stopped that runs, or was begun and waits."""
        ...

    def close(self, wait: bool) -> None:
        """End once all jobs are answered."""
        ...

    def wait_ready(self, timeout: float | None) -> bool:
        """Wait until all workers are up."""
        ...


class Pool(CancellableExecutor):
    """Jobs in a backlog that a supervisor looks after."""

    def __init__(self, backlog: Backlog, supervisor: Supervision) -> None:
        self._backlog = backlog
        self._supervisor = supervisor
        self._lock = threading.Lock()
        self._is_closed = False
        self._submitted = 0

    @abstractmethod
    def _workers(self) -> tuple[WorkerStats, ...]:
        """The workers as they are now."""

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
        workers = self._workers()
        return PoolStats(
            workers=workers,
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
        check_workers(workers)
        self._supervisor.target = workers
        self._supervisor.wake()

    def drain(self, timeout_s: float) -> bool:
        self._refuse_more()
        ended_by_themselves = self._backlog.wait_empty(timeout_s)
        if not ended_by_themselves:
            for task in reversed(self._backlog.all_open()):  # else what waits would begin
                task.job.cancel()
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
        message = f"function and arguments must be picklable, the function by its name in a module: {error}"
        raise TypeError(message) from error


def check_callable(fn: Callable[..., Any] | None) -> None:
    """
    Raises:
        TypeError: it is of the main script, which workers do not import.
    """
    if getattr(fn, "__module__", None) == "__main__":
        name = getattr(fn, "__qualname__", fn)
        raise TypeError(f"{name} is a function of the main script; workers know only functions of modules")


def check_workers(workers: int) -> None:
    """
    Raises:
        ValueError: there would be none.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1; got {workers}")
