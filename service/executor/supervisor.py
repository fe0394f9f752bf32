"""The thread that looks after a local pool: hands out jobs, hears answers, stops what must stop."""

from __future__ import annotations

import os
import selectors
import threading
import time
from collections import deque

from service.executor.backlog import Backlog, Ending, Task
from service.executor.crew import Crew
from service.executor.frames import Frame, Kind
from service.executor.interface import WorkerState
from service.executor.nest import Worker
from service.executor.overseer import Overseer
from service.executor.settings import Settings


class Supervisor(Crew, Overseer):
    """The thread that starts workers, hands out jobs, hears answers."""

    def __init__(self, target: int, settings: Settings, backlog: Backlog) -> None:
        Crew.__init__(self, target, settings)
        Overseer.__init__(self, backlog, "scopt-pool")
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._selector.register(self._wake, selectors.EVENT_READ, lambda _: os.eventfd_read(self._wake))
        self._to_cancel: deque[Task] = deque()
        self._over = threading.Lock()  # held while the wake-up may be used
        self._thread.start()

    # What other threads may call.

    def wake(self) -> bool:
        """Have the thread look after everything now; False when it has ended."""
        with self._over:
            if not self._is_over:
                os.eventfd_write(self._wake, 1)
            return not self._is_over

    def cancel(self, task: Task) -> None:
        """Have a job stopped that runs, or was begun and waits."""
        self._to_cancel.append(task)
        self.wake()

    # The thread.

    def _listen(self, wait_s: float | None) -> None:
        for key, mask in self._selector.select(wait_s):
            if self._selector.get_map().get(key.fd) is key:  # what came before may have closed it
                key.data(mask)

    def _disband(self) -> None:
        self._close_crew()
        with self._over:
            self._is_over = True
            os.close(self._wake)

    def _keep_house(self) -> float | None:
        while self._to_cancel:
            self._stop(self._to_cancel.popleft(), Ending.CANCELLED)
        now = time.monotonic()
        for task in self._backlog.take_late(now):
            self._stop(task, Ending.DEADLINE)
        for worker in self.workers:
            if worker.kill_at is not None and worker.kill_at <= now:
                self._lose_patience(worker)
        self._keep_crew(now)
        self._dispatch()
        times = [*self._crew_is_due(), self._backlog.next_deadline(), *self._impatient_at()]
        return min((max(0.0, at - time.monotonic()) for at in times if at is not None), default=None)

    def _dispatch(self) -> None:
        idle = [worker for worker in self.workers if worker.state is WorkerState.IDLE and not worker.is_lost]
        for worker in sorted(idle, key=lambda worker: worker.is_tired):
            task = self._desk.next_task()
            if task is None:
                return
            task.begin(worker.pid)
            worker.run(task)
            self._flush(worker)

    def _ask_to_stop(self, task: Task) -> bool:
        worker = next((worker for worker in self.workers if worker.task is task), None)
        if worker is not None:
            worker.ask_to_stop(task, time.monotonic() + self._settings.grace_s)
        return worker is not None

    def _impatient_at(self) -> list[float | None]:
        return [worker.kill_at for worker in self.workers]

    def _lose_patience(self, worker: Worker) -> None:
        """Kill the worker of a job that was asked to stop and did not."""
        self._read(worker)
        task = worker.task
        if task is None:
            return  # it has stopped at the last moment
        worker.task = None
        self.restarts += 1
        self._end_worker(worker)
        self._desk.killed(task)

    # What the crew tells.

    def _on_ready(self, worker: Worker) -> None:
        self._tell_ready()

    def _on_frame(self, worker: Worker, frame: Frame) -> None:
        task = worker.task
        if task is None or task.job.number != frame.job:
            return  # of a job that has its answer
        if frame.kind is Kind.EVENT:
            self._desk.hand_on(task, frame.payload)
            return
        worker.task, worker.kill_at, worker.state = None, None, WorkerState.IDLE
        worker.jobs_done += 1
        limit = self._settings.recycle_after
        if limit is not None and worker.jobs_done >= limit:
            worker.is_tired = not any(other.is_tired for other in self.workers)  # one at a time
        if frame.kind is Kind.RETURNED:
            self._desk.returned(task, frame.payload)
        else:
            self._desk.raised(task, frame.payload)

    def _on_lost(self, worker: Worker, how: str) -> None:
        if worker.task is not None:
            self._desk.worker_died(worker.task, how, worker.chatter.tail)

    def _on_hopeless(self, reason: str) -> None:
        self._desk.give_up(reason)
