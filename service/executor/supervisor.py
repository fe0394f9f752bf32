"""The thread that looks after a pool's workers: hands them jobs, stops and kills them, replaces the dead.

It runs an event loop, and what changes a worker or a running job happens in it. Two things also happen in a thread of
the caller, while the event loop waits, since to wake another thread takes longer than to do them: a job that finds an
idle worker is sent by the thread that submits it, and an event loop of the caller may read what workers send.
"""

from __future__ import annotations

import asyncio
import selectors
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from service.executor.job import LOG, ExecutorError, JobRecord, Lane, StopReason, WorkerDied
from service.executor.job_queue import JobQueue
from service.executor.worker_handle import WorkerHandle, WorkerState

FIRST_WAIT_S, _LONGEST_WAIT_S = 0.1, 5.0  # after a failed start, twice as long after each in a row
_HOPELESS = 3  # failures in a row


@dataclass(frozen=True)
class PoolSettings:
    """Settings of a pool, as its constructor documents them.

    Raises:
        ValueError: there are no workers.
        TypeError: workers do not know ``warm_up``.
    """

    workers: int
    warm_up: Callable[[], object] | None
    preload: tuple[str, ...]
    grace_s: float
    max_bytes: int | None
    recycle_after: int | None
    start_timeout_s: float
    light_workers: int = 0

    def __post_init__(self) -> None:
        check_workers(self.workers)
        check_callable(self.warm_up)


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


class _GuardedSelector(selectors.DefaultSelector):
    """Selector of an event loop whose thread holds a lock, except while it waits for events."""

    def __init__(self, lock: threading.Lock) -> None:
        super().__init__()
        self._lock = lock

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._lock.release()
        try:
            return super().select(timeout)
        finally:
            self._lock.acquire()


W = TypeVar("W", bound=WorkerHandle)


class Supervisor(ABC, Generic[W]):
    """Keeps the workers; other threads leave it requests and read the attributes.

    Attributes:
        target: how many workers there shall be, those for light jobs alone included.
        workers: those there are; a new tuple at each change.
        restarts: how many workers died or were killed, but for those of jobs that were asked to stop.
    """

    _any_thread_sends = False  # whether ``_send_job`` works in any thread that holds ``_guard``

    def __init__(self, name: str, settings: PoolSettings, queue: JobQueue) -> None:
        self.target = settings.workers + settings.light_workers
        self.workers: tuple[W, ...] = ()
        self.restarts = 0
        self._settings = settings
        self._queue = queue
        self._guard = threading.Lock()
        self._loop = asyncio.SelectorEventLoop(_GuardedSelector(self._guard))
        self._loop.set_exception_handler(self._stop_after_error)
        self._n_started = self._n_failures = 0  # workers; starts in a row that failed
        self._next_start = 0.0
        self._is_closing = self._is_over = False
        self._ready = threading.Condition()
        self._thread = threading.Thread(target=self._supervise, name=name, daemon=True)

    # Called by other threads.

    def wake(self) -> None:
        """Have the thread check everything now."""
        self._call(self._check)

    def accept(self, record: JobRecord) -> bool:
        """Look after a job that was put in the queue; return False when the thread has ended."""
        if self._any_thread_sends and record.job.deadline is None and self._guard.acquire(blocking=False):
            try:
                self._hand_out_jobs()
            finally:
                self._guard.release()
            if record.job.started is not None:
                return True
        return self._call(self._accept, record)

    def cancel(self, record: JobRecord) -> None:
        """Stop a job that runs, or was started and is queued again."""
        self._call(self._stop, record, StopReason.CANCELLED)

    def resize(self, workers: int) -> None:
        """Change the number of workers that take all jobs."""
        self.target = workers + self._settings.light_workers
        self.wake()

    def close(self, wait: bool) -> None:
        """End once all jobs have ended."""
        self._is_closing = True
        self.wake()
        if wait:
            self._thread.join()

    @contextmanager
    def read_in(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        """Have a running event loop read what workers send while the body runs; here the thread goes on reading."""
        yield

    def wait_ready(self, timeout: float | None) -> bool:
        """Wait until all workers are up; return whether they are."""
        with self._ready:
            self._ready.wait_for(lambda: self._is_over or self._n_up >= self.target, timeout)
            return not self._is_over and self._n_up >= self.target

    @property
    def _n_up(self) -> int:
        return sum(worker.is_up for worker in self.workers)

    def _call(self, fn: Callable[..., None], *args: Any) -> bool:
        try:
            self._loop.call_soon_threadsafe(fn, *args)
        except RuntimeError:  # the loop is closed
            return False
        return True

    # Differs between pools.

    @abstractmethod
    def _adjust_workers(self) -> None:
        """Start missing workers and end surplus ones."""

    @abstractmethod
    def _send_job(self, worker: W, record: JobRecord) -> None:
        """Have a worker run a job."""

    @abstractmethod
    def _end_worker(self, worker: W) -> None:
        """Kill a worker that has no job."""

    @abstractmethod
    def _close_workers(self) -> None:
        """End all workers."""

    def _select_idle(self) -> list[W]:
        """Return the workers that can take a job, in the order in which they get one."""
        return [worker for worker in self.workers if worker.state is WorkerState.IDLE]

    # The thread.

    def _supervise(self) -> None:
        with self._guard:
            try:
                self._loop.call_soon(self._check)
                self._loop.run_forever()
            finally:
                self._is_over = True
                self._close_workers()
                self.workers = ()
                self._loop.close()  # from now on no job is accepted
                for record in self._queue.list_open():  # none, unless this thread failed
                    record.fail(ExecutorError("the pool failed; see its log"))
                with self._ready:
                    self._ready.notify_all()

    def _stop_after_error(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        LOG.critical("the pool's supervisor failed: %s", context["message"], exc_info=context.get("exception"))
        loop.stop()

    def _check(self) -> None:
        """Bring the number of workers to what it shall be, and give jobs to idle ones; end when all is done."""
        if self._is_over:
            return
        if self._is_closing and not self._queue.n_open:
            self._loop.stop()
            return
        self._adjust_workers()
        self._hand_out_jobs()

    def _hand_out_jobs(self) -> None:
        """Give queued jobs to idle workers."""
        n_heavy = sum(worker.record is not None and worker.record.place.lane > Lane.LIGHT for worker in self.workers)
        for worker in self._select_idle():
            record = self._take_job(only_light=n_heavy >= self.target - self._settings.light_workers)
            if record is None:
                return
            n_heavy += record.place.lane > Lane.LIGHT
            record.note_start(worker.pid)
            worker.state, worker.record = WorkerState.BUSY, record
            self._send_job(worker, record)

    # Jobs.

    def _accept(self, record: JobRecord) -> None:
        if record.job.deadline is not None:
            limit = self._loop.call_at(record.job.deadline, self._stop, record, StopReason.DEADLINE)
            record.job.add_done_callback(lambda _: self._call(limit.cancel))
        self._check()

    def _take_job(self, only_light: bool) -> JobRecord | None:
        """Remove and return the next job to run; jobs past their deadline fail instead."""
        while (record := self._queue.take(only_light)) is not None:
            if record.claim():
                if record.job.deadline is None or record.job.deadline > self._loop.time():
                    return record
                record.set_dropped(StopReason.DEADLINE)
        return None

    def _stop(self, record: JobRecord, reason: StopReason) -> None:
        """Ask a job to stop, or end it when it is queued."""
        if self._queue.withdraw(record):
            if record.claim():
                record.set_dropped(reason)
        elif record.stop_reason is None:
            for worker in self.workers:
                if worker.record is record:
                    record.stop_reason = reason
                    worker.request_stop(record)
                    self._limit(worker, self._settings.grace_s, self._kill_overdue)
        self._loop.call_soon(self._check)

    def _finish_job(self, worker: W, is_result: bool, payload: bytes) -> None:
        """Free a worker, set its job's result or exception, and give the worker the next job."""
        record = self._take_record(worker)
        worker.state = WorkerState.IDLE
        worker.jobs_done += 1
        if record is not None and is_result:
            record.set_returned(payload)
        elif record is not None:
            record.set_raised(payload)
        if self._is_closing or self._should_end(worker):
            self._call(self._check)
        elif self._queue.n_queued:
            self._hand_out_jobs()

    def _should_end(self, worker: W) -> bool:
        """Whether an idle worker is no longer needed."""
        return len(self.workers) > self.target

    def _kill_overdue(self, worker: W) -> None:
        """Kill the worker of a job that was asked to stop and did not."""
        record = self._take_record(worker)  # what was asked for is no restart that an operator should look at
        self._end_worker(worker)
        if record is not None:
            record.set_killed()
        self._loop.call_soon(self._check)

    def _take_record(self, worker: W) -> JobRecord | None:
        """Return a worker's job, which it no longer runs."""
        self._limit(worker, None)
        record, worker.record = worker.record, None
        return record

    # Workers.

    def _limit(self, worker: W, seconds: float | None, kill: Callable[[W], None] | None = None) -> None:
        """Have ``kill`` called with the worker after a time [s] instead of any earlier limit."""
        if worker.limit is not None:
            worker.limit.cancel()
        worker.limit = None if seconds is None or kill is None else self._loop.call_later(seconds, kill, worker)

    @property
    def _may_start(self) -> bool:
        """Whether enough time has passed since the last start that failed."""
        return self._loop.time() >= self._next_start

    def _note_started(self, worker: W) -> None:
        """Look after a worker whose start has begun."""
        self.workers = (*self.workers, worker)
        self._limit(worker, self._settings.start_timeout_s, self._kill_unready)

    def _note_up(self, worker: W) -> None:
        """Note that a worker has become ready."""
        self._n_failures = 0
        self._limit(worker, None)
        worker.state = WorkerState.IDLE
        with self._ready:
            self._ready.notify_all()
        self._call(self._check)

    def _kill_unready(self, worker: W) -> None:
        self._end_worker(worker)
        self._note_failed_start(self._describe_timeout(worker))

    def _note_death(self, worker: W, cause: str, details: str, last_output: str) -> None:
        """Note that a worker has ended; its job is started again or fails."""
        self.workers = tuple(other for other in self.workers if other is not worker)
        record = self._take_record(worker)
        if worker.state is WorkerState.STARTING:
            self._note_failed_start(f"worker {worker.number} ended ({cause}) before it was ready: {last_output}")
        elif worker.state is not WorkerState.STOPPING:
            self.restarts += 1
            LOG.warning("worker %d (pid %s) ended: %s", worker.number, worker.pid, details)
        if record is None:
            pass
        elif record.stop_reason is not None:
            record.set_killed()
        elif record.job.attempts >= record.max_attempts:
            record.fail(WorkerDied(cause, record.job.attempts, last_output))
        else:
            self._queue.put_back(record)
        self._loop.call_soon(self._check)

    def _note_failed_start(self, reason: str) -> None:
        """Wait before the next start; after several failures in a row there is no hope for queued jobs."""
        LOG.error("a worker could not be started: %s", reason)
        if not self._may_start:  # of several workers that fail together one counts
            return
        wait_s = min(FIRST_WAIT_S * 2**self._n_failures, _LONGEST_WAIT_S)
        self._next_start = self._loop.time() + wait_s
        self._loop.call_later(wait_s + 0.001, self._check)
        self._n_failures += 1
        if self._n_failures >= _HOPELESS and self._n_up == 0:
            for record in self._queue.list_open(only_queued=True):
                if self._queue.withdraw(record) and record.claim():
                    record.fail(WorkerDied("none could be started", record.job.attempts, reason[-1000:]))

    def _describe_timeout(self, worker: W) -> str:
        return f"worker {worker.number} was not ready after {self._settings.start_timeout_s:g} s"
