"""The jobs that a pool has accepted: their order, their deadlines, and their results, each set exactly once."""

from __future__ import annotations

import enum
import heapq
import logging
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from service.executor.errors import DeadlineExceeded, ExecutorError, JobCancelled, JobFailed, WorkerDied
from service.executor.interface import Job, OnEvent

LOG = logging.getLogger("service.executor")


class StopReason(enum.Enum):
    """Why a job is asked to stop."""

    CANCELLED = "cancelled"
    DEADLINE = "deadline"


_ERRORS: dict[StopReason, Callable[[str], ExecutorError]] = {
    StopReason.CANCELLED: lambda text: JobCancelled(f"cancelled{text}"),
    StopReason.DEADLINE: lambda text: DeadlineExceeded(f"the deadline passed{text}"),
}


@dataclass(eq=False)
class JobRecord:
    """A job with what the pool needs to run it.

    Attributes:
        job: the caller's side of it.
        payload: the pickled call.
        on_event: called with each event that the function reports.
        max_attempts: how often the job may be started.
        stop_reason: why it was asked to stop; None while it was not.
    """

    job: Job[Any]
    payload: bytes
    on_event: OnEvent | None
    max_attempts: int
    stop_reason: StopReason | None = None

    def note_start(self, pid: int | None) -> None:
        """Note that a worker starts the job now."""
        self.job.started, self.job.pid, self.job.attempts = time.monotonic(), pid, self.job.attempts + 1


class JobQueue:
    """Jobs without a result, the queued ones in order of submission; safe to use from several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._queued: deque[JobRecord] = deque()
        self._open: dict[int, JobRecord] = {}  # by the job's number: queued or running
        self._deadlines: list[tuple[float, int]] = []  # a heap; jobs that ended early drop out late
        self._n_done = 0

    @property
    def n_queued(self) -> int:
        """Number of queued jobs."""
        return len(self._queued)

    @property
    def n_open(self) -> int:
        """Number of jobs without a result."""
        return len(self._open)

    @property
    def n_done(self) -> int:
        """Number of jobs that have ended."""
        return self._n_done

    def put(self, record: JobRecord) -> None:
        """Add a new job at the end."""
        with self._changed:
            self._open[record.job.number] = record
            self._queued.append(record)
            if record.job.deadline is not None:
                heapq.heappush(self._deadlines, (record.job.deadline, record.job.number))
                self._prune_deadlines()

    def put_back(self, record: JobRecord) -> None:
        """Add a job that was started before, in front of all others."""
        with self._changed:
            self._queued.appendleft(record)

    def take(self) -> JobRecord | None:
        """Remove and return the first queued job."""
        with self._changed:
            return self._queued.popleft() if self._queued else None

    def withdraw(self, record: JobRecord) -> bool:
        """Remove a job from the queue; return whether it was there."""
        with self._changed:
            if record not in self._queued:
                return False
            self._queued.remove(record)
            return True

    def close(self, record: JobRecord) -> None:
        """Forget a job that has ended."""
        with self._changed:
            if self._open.pop(record.job.number, None) is not None:
                self._n_done += 1
            self._changed.notify_all()

    def find(self, number: int) -> JobRecord | None:
        """Return the record of a job that has not ended."""
        return self._open.get(number)

    def position(self, job: Job[Any]) -> int | None:
        """Return 1 for the job that is next, None for a job that is not queued."""
        with self._changed:
            return next((i for i, record in enumerate(self._queued, 1) if record.job is job), None)

    def list_queued(self) -> list[JobRecord]:
        """Return the queued jobs, in order."""
        with self._changed:
            return list(self._queued)

    def list_open(self) -> list[JobRecord]:
        """Return the jobs without a result, in order of submission."""
        with self._changed:
            return list(self._open.values())

    def next_deadline(self) -> float | None:
        """Return the earliest deadline, on the clock of ``time.monotonic`` [s]."""
        with self._changed:
            return self._deadlines[0][0] if self._deadlines else None

    def take_overdue(self, now: float) -> list[JobRecord]:
        """Return the jobs whose deadline has passed at ``now``; each is returned once."""
        with self._changed:
            overdue = []
            while self._deadlines and self._deadlines[0][0] <= now:
                record = self._open.get(heapq.heappop(self._deadlines)[1])
                if record is not None:
                    overdue.append(record)
            return overdue

    def wait_empty(self, timeout_s: float | None) -> bool:
        """Wait until all jobs have ended; return whether they have."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._open, timeout_s)

    def _prune_deadlines(self) -> None:
        if len(self._deadlines) > 2 * len(self._open) + 64:
            self._deadlines = [entry for entry in self._deadlines if entry[1] in self._open]
            heapq.heapify(self._deadlines)


class JobResults:
    """Sets the result or exception of a queue's jobs; used by the supervisor's thread only."""

    def __init__(self, queue: JobQueue) -> None:
        self._queue = queue

    def take_next(self) -> JobRecord | None:
        """Remove and return the next job to run; jobs past their deadline fail instead."""
        while (record := self._queue.take()) is not None:
            if not self._claim(record):
                continue
            if record.job.deadline is None or record.job.deadline > time.monotonic():
                return record
            self._fail_queued(record, StopReason.DEADLINE)
        return None

    def drop_queued(self, record: JobRecord, reason: StopReason) -> bool:
        """End a queued job; return False when it is not queued."""
        if not self._queue.withdraw(record):
            return False
        if self._claim(record):
            self._fail_queued(record, reason)
        return True

    def fail_all_queued(self, reason: str) -> None:
        """End all queued jobs, since no worker can be started."""
        for record in self._queue.list_queued():
            if self._queue.withdraw(record) and self._claim(record):
                self.fail(record, WorkerDied("none could be started", record.job.attempts, reason[-1000:]))

    def set_returned(self, record: JobRecord, payload: bytes | bytearray) -> None:
        """End a job with a pickled result."""
        try:
            result = pickle.loads(payload)
        except Exception as error:
            self.fail(record, _unreadable(error))
            return
        record.job.set_result(result)
        self._queue.close(record)

    def set_raised(self, record: JobRecord, payload: bytes | bytearray) -> None:
        """End a job with an exception pickled by ``worker.pickle_exception``."""
        try:
            error, summary, trace = pickle.loads(payload)
        except Exception as unread:
            self.fail(record, _unreadable(unread))
            return
        if isinstance(error, JobCancelled):
            error = None if record.stop_reason is None else _ERRORS[record.stop_reason]("; it stopped by itself")
        raised: Exception = JobFailed(summary) if error is None else error
        raised.__cause__ = RemoteTraceback(trace)
        self.fail(record, raised)

    def set_killed(self, record: JobRecord) -> None:
        """End a job whose worker was killed because it did not stop."""
        if record.stop_reason is None:  # a worker's message alone ends no job without a result
            self.fail(record, ExecutorError("ended although it was not asked to stop"))
        else:
            self.fail(record, _ERRORS[record.stop_reason]("; it did not stop by itself and was ended"))

    def retry_or_fail(self, record: JobRecord, cause: str, last_output: str) -> None:
        """Put a job whose worker died in front of the queue, or end it when it may not be started again."""
        if record.stop_reason is not None:
            self.set_killed(record)
        elif record.job.attempts >= record.max_attempts:
            self.fail(record, WorkerDied(cause, record.job.attempts, last_output))
        else:
            self._queue.put_back(record)

    def fail(self, record: JobRecord, error: Exception) -> None:
        """End a job with an exception, unless it has ended."""
        if not record.job.done():
            record.job.set_exception(error)
        self._queue.close(record)

    def deliver_event(self, record: JobRecord, payload: bytes | bytearray) -> None:
        """Pass an event to the caller; errors in that are logged, and the job goes on."""
        if record.on_event is None:
            return
        try:
            record.on_event(pickle.loads(payload))
        except Exception:
            LOG.exception("an event of job %d could not be delivered", record.job.number)

    def _claim(self, record: JobRecord) -> bool:
        """Mark a job as running, so that ``cancel`` no longer ends it directly; False when it was cancelled before."""
        if record.job.attempts or record.job.set_running_or_notify_cancel():
            return True
        self._queue.close(record)
        return False

    def _fail_queued(self, record: JobRecord, reason: StopReason) -> None:
        if reason is StopReason.CANCELLED:
            text = " while it waited for another worker"
        else:
            text = f" while it waited, started {record.job.attempts} times"
        self.fail(record, _ERRORS[reason](text))


class RemoteTraceback(Exception):  # noqa: N818
    """The traceback of an exception that was raised in a worker."""

    def __init__(self, trace: str) -> None:
        super().__init__(trace)
        self.trace = trace

    def __str__(self) -> str:
        return f"\n{self.trace}"


def _unreadable(error: Exception) -> JobFailed:
    return JobFailed(f"its result cannot be unpickled here: {type(error).__name__}: {error}")
