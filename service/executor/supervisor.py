"""The supervisor thread that pools have in common: hands jobs to workers, stops and kills them, replaces the dead."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from service.executor.errors import ExecutorError
from service.executor.interface import WorkerState
from service.executor.job_queue import LOG, JobQueue, JobRecord, JobResults, StopReason

FIRST_WAIT_S, _LONGEST_WAIT_S = 0.1, 5.0
_HOPELESS = 3  # failures in a row


@dataclass(frozen=True)
class PoolSettings:
    """Settings of a pool, as its constructor documents them."""

    warm_up: Callable[[], object] | None
    preload: tuple[str, ...]
    grace_s: float
    max_bytes: int | None
    recycle_after: int | None
    start_timeout_s: float


class RetryBackoff:
    """Wait after failed starts, twice as long after each in a row.

    Attributes:
        until: when to try again, on the clock of ``time.monotonic`` [s].
    """

    def __init__(self) -> None:
        self.until = 0.0
        self._n_failures = 0

    @property
    def is_waiting(self) -> bool:
        """Whether it is too early to try again."""
        return time.monotonic() < self.until

    def count_failure(self) -> bool:
        """Count a failure, at most one per attempt; return whether there were several in a row."""
        if self.is_waiting:
            return False
        self.until = time.monotonic() + min(FIRST_WAIT_S * 2**self._n_failures, _LONGEST_WAIT_S)
        self._n_failures += 1
        return self._n_failures >= _HOPELESS

    def reset(self) -> None:
        """Count from zero again."""
        self._n_failures = 0


class WorkerHandle(ABC):
    """The pool's view of one worker.

    Attributes:
        number: counts the pool's workers from 1.
        state: what it is doing.
        pid: on its own machine; None until it has sent it.
        record: the job it runs.
        kill_at: when it is killed unless its job stops before, on the clock of ``time.monotonic`` [s].
        jobs_done: how many jobs it has finished.
        started: when it was started [s].
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.state = WorkerState.STARTING
        self.pid: int | None = None
        self.record: JobRecord | None = None
        self.kill_at: float | None = None
        self.jobs_done = 0
        self.started = time.monotonic()

    @property
    def is_up(self) -> bool:
        """Whether it runs a job or could."""
        return self.state in (WorkerState.IDLE, WorkerState.BUSY)

    @property
    @abstractmethod
    def rss_bytes(self) -> int:
        """Resident memory, shared pages included; 0 where it is not known."""

    @abstractmethod
    def request_stop(self, record: JobRecord) -> None:
        """Have ``should_stop`` of its job return True."""


W = TypeVar("W", bound=WorkerHandle)


class Supervisor(ABC, Generic[W]):
    """One thread that alone changes workers; other threads leave it requests and read the attributes.

    Attributes:
        target: how many workers there shall be.
        workers: those there are; a new tuple at each change.
        restarts: how many workers died or were killed.
    """

    def __init__(self, name: str, target: int, settings: PoolSettings, queue: JobQueue) -> None:
        self.target = target
        self.workers: tuple[W, ...] = ()
        self.restarts = 0
        self._settings = settings
        self._queue = queue
        self._results = JobResults(queue)
        self._backoff = RetryBackoff()
        self._n_started = 0
        self._to_cancel: deque[JobRecord] = deque()
        self._is_closing = self._is_over = False
        self._ready = threading.Condition()
        self._thread = threading.Thread(target=self._supervise, name=name, daemon=True)

    # Called by other threads.

    @abstractmethod
    def wake(self) -> bool:
        """Have the thread check everything now; return False when it has ended."""

    def cancel(self, record: JobRecord) -> None:
        """Stop a job that runs, or was started and is queued again."""
        self._to_cancel.append(record)
        self.wake()

    def close(self, wait: bool) -> None:
        """End once all jobs have ended."""
        self._is_closing = True
        self.wake()
        if wait:
            self._thread.join()

    def wait_ready(self, timeout: float | None) -> bool:
        """Wait until all workers are up; return whether they are."""
        with self._ready:
            self._ready.wait_for(lambda: self._is_over or self._n_up >= self.target, timeout)
            return not self._is_over and self._n_up >= self.target

    @property
    def _n_up(self) -> int:
        return sum(worker.is_up for worker in self.workers)

    # Differs between pools.

    @abstractmethod
    def _wait_for_events(self, timeout_s: float | None) -> None:
        """Handle what workers and other threads send, waiting at most that long for it."""

    @abstractmethod
    def _adjust_workers(self, now: float) -> None:
        """Start missing workers and end surplus ones."""

    @abstractmethod
    def _send_job(self, worker: W, record: JobRecord) -> None:
        """Have a worker run a job."""

    @abstractmethod
    def _end_worker(self, worker: W) -> None:
        """Kill a worker that has no job."""

    @abstractmethod
    def _close_workers(self) -> None:
        """End all workers; from then on ``wake`` returns False."""

    def _select_idle(self) -> list[W]:
        """Return the workers that can take a job, in the order in which they get one."""
        return [worker for worker in self.workers if worker.state is WorkerState.IDLE]

    def _next_checks(self) -> list[float | None]:
        """Return further times at which something is due without an event [s]."""
        return []

    # The thread.

    def _supervise(self) -> None:
        try:
            while not (self._is_closing and not self._queue.n_open):
                self._wait_for_events(self._do_due())
        except BaseException:
            LOG.critical("the pool's supervisor failed", exc_info=True)
        finally:
            self._close_workers()
            for record in self._queue.list_open():  # none, unless this thread failed
                self._results.fail(record, ExecutorError("the pool failed; see its log"))
            self._notify_ready()

    def _do_due(self) -> float | None:
        """Do all that is due; return the time until something is due again [s]."""
        while self._to_cancel:
            self._stop(self._to_cancel.popleft(), StopReason.CANCELLED)
        now = time.monotonic()
        for record in self._queue.take_overdue(now):
            self._stop(record, StopReason.DEADLINE)
        for worker in self.workers:
            if worker.kill_at is not None and worker.kill_at <= now:
                self._kill_overdue(worker)
            elif worker.state is WorkerState.STARTING and worker.started + self._settings.start_timeout_s <= now:
                self._end_worker(worker)
                self._note_failed_start(self._describe_timeout(worker))
        self._adjust_workers(now)
        self._dispatch()
        times = [self._queue.next_deadline(), self._backoff.until if self._backoff.is_waiting else None]
        times += [worker.kill_at for worker in self.workers]
        times += [w.started + self._settings.start_timeout_s for w in self.workers if w.state is WorkerState.STARTING]
        times += self._next_checks()
        return min((max(0.0, at - time.monotonic()) for at in times if at is not None), default=None)

    def _dispatch(self) -> None:
        for worker in self._select_idle():
            record = self._results.take_next()
            if record is None:
                return
            record.note_start(worker.pid)
            worker.state, worker.record, worker.kill_at = WorkerState.BUSY, record, None
            self._send_job(worker, record)

    def _finish_job(self, worker: W, record: JobRecord, is_result: bool, payload: bytes) -> None:
        """Free a worker and set its job's result or exception."""
        worker.record, worker.kill_at, worker.state = None, None, WorkerState.IDLE
        worker.jobs_done += 1
        if is_result:
            self._results.set_returned(record, payload)
        else:
            self._results.set_raised(record, payload)

    def _stop(self, record: JobRecord, reason: StopReason) -> None:
        """Ask a job to stop, or end it when it is queued."""
        if self._results.drop_queued(record, reason) or record.stop_reason is not None:
            return
        worker = next((worker for worker in self.workers if worker.record is record), None)
        if worker is not None:
            worker.kill_at = time.monotonic() + self._settings.grace_s
            worker.request_stop(record)
            record.stop_reason = reason

    def _kill_overdue(self, worker: W) -> None:
        """Kill the worker of a job that was asked to stop and did not."""
        record, worker.record = worker.record, None
        self.restarts += 1
        self._end_worker(worker)
        if record is not None:
            self._results.set_killed(record)

    def _note_up(self, worker: W) -> None:
        """Note that a worker has become ready."""
        self._backoff.reset()
        worker.state = WorkerState.IDLE
        self._notify_ready()

    def _notify_ready(self) -> None:
        with self._ready:
            self._ready.notify_all()

    def _note_death(self, worker: W, cause: str, details: str, last_output: str) -> None:
        """Note that a worker has ended; its job is started again or fails."""
        if worker.state is WorkerState.STARTING:
            self._note_failed_start(f"worker {worker.number} ended ({cause}) before it was ready: {last_output}")
        elif worker.state is not WorkerState.STOPPING:
            self.restarts += 1
            LOG.warning("worker %d (pid %s) ended: %s", worker.number, worker.pid, details)
        if worker.record is not None:
            self._results.retry_or_fail(worker.record, cause, last_output)

    def _note_failed_start(self, reason: str) -> None:
        LOG.error("a worker could not be started: %s", reason)
        if self._backoff.count_failure() and self._n_up == 0:
            self._results.fail_all_queued(reason)

    def _describe_timeout(self, worker: W) -> str:
        return f"worker {worker.number} was not ready after {self._settings.start_timeout_s:g} s"
