"""The thread that looks after a local pool: hands out jobs, hears answers, stops what must stop."""

from __future__ import annotations

import logging
import os
import selectors
import threading
import time
from collections import deque

from service.executor.backlog import Backlog, Ending, Task
from service.executor.crew import Crew
from service.executor.desk import Desk
from service.executor.errors import ExecutorError
from service.executor.frames import Frame, Kind
from service.executor.interface import WorkerState
from service.executor.nest import Worker
from service.executor.settings import Settings

_LOG = logging.getLogger("service.executor")


class Supervisor(Crew):
    """One thread, which alone touches nursery and workers; others leave wishes and read figures."""

    def __init__(self, target: int, settings: Settings, backlog: Backlog) -> None:
        super().__init__(target, settings)
        self._backlog = backlog
        self._desk = Desk(backlog)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._selector.register(self._wake, selectors.EVENT_READ, lambda _: os.eventfd_read(self._wake))
        self._to_cancel: deque[Task] = deque()
        self._is_closing = False
        self._over = threading.Lock()  # held while the wake-up may be used
        self._is_over = False
        self._ready = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="scopt-pool", daemon=True)
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

    def close(self, wait: bool) -> None:
        """End once all jobs are answered."""
        self._is_closing = True
        self.wake()
        if wait:
            self._thread.join()

    def wait_ready(self, timeout: float | None) -> bool:
        """Wait until all workers are up."""
        with self._ready:
            self._ready.wait_for(lambda: self._is_over or self.n_up >= self.target, timeout)
            return not self._is_over and self.n_up >= self.target

    # The thread.

    def _run(self) -> None:
        try:
            while not (self._is_closing and not self._backlog.open):
                wait_s = self._keep_house()
                for key, mask in self._selector.select(wait_s):
                    if self._selector.get_map().get(key.fd) is key:  # what came before may have closed it
                        key.data(mask)
        except BaseException:
            _LOG.critical("the pool's supervisor failed", exc_info=True)
        finally:
            self._end()

    def _end(self) -> None:
        self._close_crew()
        with self._over:
            self._is_over = True
            os.close(self._wake)
        for task in self._backlog.all_open():  # none, unless this thread failed
            self._desk.fail(task, ExecutorError("the pool failed; its log says why"))
        with self._ready:
            self._ready.notify_all()

    def _keep_house(self) -> float | None:
        """Do all that is due; how long there is nothing to do then [s]."""
        while self._to_cancel:
            self._stop(self._to_cancel.popleft(), Ending.CANCELLED)
        now = time.monotonic()
        for task in self._backlog.take_late(now):
            self._stop(task, Ending.DEADLINE)
        for worker in self.workers:
            if worker.interrupt_at is not None and worker.interrupt_at <= now:
                self._interrupt(worker)
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
            job = task.job
            job.started, job.pid, job.attempts = time.monotonic(), worker.pid, job.attempts + 1
            worker.run(task)
            self._flush(worker)

    def _stop(self, task: Task, ending: Ending) -> None:
        """Ask a job to stop, or let it never begin."""
        if self._desk.drop(task, ending):
            return
        worker = next((worker for worker in self.workers if worker.task is task), None)
        if worker is not None and task.ending is None:
            task.ending = ending
            now, interrupt_s = time.monotonic(), self._settings.interrupt_s
            worker.ask_to_stop(task, None if interrupt_s is None else now + interrupt_s, now + self._settings.grace_s)

    def _impatient_at(self) -> list[float | None]:
        return [at for worker in self.workers for at in (worker.interrupt_at, worker.kill_at)]

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
        with self._ready:
            self._ready.notify_all()

    def _on_frame(self, worker: Worker, frame: Frame) -> None:
        task = worker.task
        if task is None or task.job.number != frame.job:
            return  # of a job that has its answer
        if frame.kind is Kind.EVENT:
            self._desk.hand_on(task, frame.payload)
            return
        worker.task, worker.interrupt_at, worker.kill_at, worker.state = None, None, None, WorkerState.IDLE
        worker.jobs_done += 1
        limit = self._settings.recycle_after
        if limit is not None and worker.jobs_done >= limit:
            worker.is_tired = not any(other.is_tired for other in self.workers)  # one at a time
        if frame.kind is Kind.RETURNED:
            self._desk.returned(task, frame.payload)
        elif frame.kind is Kind.INTERRUPTED:
            self._desk.killed(task)
        else:
            self._desk.raised(task, frame.payload)

    def _on_lost(self, worker: Worker, how: str) -> None:
        if worker.task is not None:
            self._desk.worker_died(worker.task, how, worker.chatter.tail)

    def _on_hopeless(self, reason: str) -> None:
        self._desk.give_up(reason)
