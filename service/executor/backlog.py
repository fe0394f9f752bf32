"""The jobs a pool has taken and not answered: which is next, which are late, whether there are any left."""

from __future__ import annotations

import enum
import heapq
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from service.executor.interface import Job, OnEvent


class Ending(enum.Enum):
    """Why a job is asked to stop."""

    CANCELLED = "cancelled"
    DEADLINE = "deadline"


@dataclass(eq=False)
class Task:
    """A job with what the pool needs for it.

    Attributes:
        job: the caller's side of it.
        payload: the pickled call.
        on_event: gets what the function reports.
        max_attempts: how often it may be begun.
        ending: why it was asked to stop; None while it was not.
    """

    job: Job[Any]
    payload: bytes
    on_event: OnEvent | None
    max_attempts: int
    ending: Ending | None = None

    def begin(self, pid: int | None) -> None:
        """A worker is at it from now on."""
        self.job.started, self.job.pid, self.job.attempts = time.monotonic(), pid, self.job.attempts + 1


class Backlog:
    """Tasks in the order in which they came; safe to use from several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._queue: deque[Task] = deque()
        self._open: dict[int, Task] = {}  # by the job's number: queued or running
        self._deadlines: list[tuple[float, int]] = []  # a heap; jobs that were answered early drop out late
        self._done = 0

    @property
    def queued(self) -> int:
        """Tasks that wait."""
        return len(self._queue)

    @property
    def open(self) -> int:
        """Tasks that are not answered."""
        return len(self._open)

    @property
    def done(self) -> int:
        """Tasks that were answered."""
        return self._done

    def put(self, task: Task) -> None:
        """Take a new task."""
        with self._changed:
            self._open[task.job.number] = task
            self._queue.append(task)
            if task.job.deadline is not None:
                heapq.heappush(self._deadlines, (task.job.deadline, task.job.number))
                self._forget_answered()

    def put_back(self, task: Task) -> None:
        """Take a task again that was begun, before all others."""
        with self._changed:
            self._queue.appendleft(task)

    def take(self) -> Task | None:
        """The next task, which waits no longer."""
        with self._changed:
            return self._queue.popleft() if self._queue else None

    def withdraw(self, task: Task) -> bool:
        """Have a task wait no longer; whether it did."""
        with self._changed:
            if task not in self._queue:
                return False
            self._queue.remove(task)
            return True

    def answered(self, task: Task) -> None:
        """Forget a task."""
        with self._changed:
            if self._open.pop(task.job.number, None) is not None:
                self._done += 1
            self._changed.notify_all()

    def find(self, number: int) -> Task | None:
        """The task of a job that is not answered."""
        return self._open.get(number)

    def place(self, job: Job[Any]) -> int | None:
        """1 for the job that is next, None for one that does not wait."""
        with self._changed:
            return next((i for i, task in enumerate(self._queue, 1) if task.job is job), None)

    def all_queued(self) -> list[Task]:
        """The tasks that wait, in order."""
        with self._changed:
            return list(self._queue)

    def all_open(self) -> list[Task]:
        """The tasks that are not answered, in the order in which they came."""
        with self._changed:
            return list(self._open.values())

    def next_deadline(self) -> float | None:
        """When somebody may be late next [s]."""
        with self._changed:
            return self._deadlines[0][0] if self._deadlines else None

    def take_late(self, now: float) -> list[Task]:
        """The tasks whose deadline has passed by now; each is told once."""
        with self._changed:
            late = []
            while self._deadlines and self._deadlines[0][0] <= now:
                task = self._open.get(heapq.heappop(self._deadlines)[1])
                if task is not None:
                    late.append(task)
            return late

    def wait_empty(self, timeout_s: float | None) -> bool:
        """Wait until all tasks are answered; whether they are."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._open, timeout_s)

    def _forget_answered(self) -> None:
        if len(self._deadlines) > 2 * len(self._open) + 64:
            self._deadlines = [entry for entry in self._deadlines if entry[1] in self._open]
            heapq.heapify(self._deadlines)
