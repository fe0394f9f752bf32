"""The thread that looks after a pool's workers: hands out jobs, hears answers, ends and replaces workers."""

from __future__ import annotations

import logging
import os
import selectors
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from service.executor.backlog import Backlog, Ending, Task
from service.executor.desk import Desk
from service.executor.errors import ExecutorError
from service.executor.frames import Frame, Kind
from service.executor.interface import WorkerState
from service.executor.nest import Nursery, Worker
from service.executor.worker import WorkerSetup

_LOG = logging.getLogger("service.executor")
FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 5.0  # between attempts to start what does not start
FAILED_STARTS = 3  # in a row, and those who wait are told


@dataclass(frozen=True)
class Settings:
    """What a local pool is made with.

    Attributes:
        warm_up: called once in each worker before it takes jobs.
        preload: modules that are imported once and shared by all workers.
        grace_s: from asking a job to stop to killing its worker [s].
        max_bytes: address space of a worker; None for no limit.
        recycle_after: jobs after which a worker is replaced; None for never.
        start_timeout_s: in which modules are imported, and in which a worker becomes ready [s].
    """

    warm_up: Callable[[], object] | None = None
    preload: tuple[str, ...] = ()
    grace_s: float = 0.25
    max_bytes: int | None = None
    recycle_after: int | None = None
    start_timeout_s: float = 120.0


class Supervisor:
    """One thread, which alone touches nursery and workers; others leave wishes and read figures.

    Attributes:
        workers: by number, those included that are ending.
        target: how many there shall be.
        restarts: how many died or were killed.
    """

    def __init__(self, target: int, settings: Settings, backlog: Backlog) -> None:
        self.target = target
        self.workers: dict[int, Worker] = {}
        self.restarts = 0
        self._settings = settings
        self._setup = WorkerSetup((), settings.warm_up, settings.max_bytes)
        self._backlog = backlog
        self._desk = Desk(backlog)
        self._nursery: Nursery | None = None
        self._selector = selectors.DefaultSelector()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._selector.register(self._wake, selectors.EVENT_READ, lambda _: os.eventfd_read(self._wake))
        self._wishes: deque[Callable[[], None]] = deque()
        self._is_closing = False
        self._over = threading.Lock()  # held while the wake-up may be used
        self._is_over = False
        self._numbered = 0
        self._failures, self._not_before = 0, 0.0
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
        """Have a running job stopped."""
        self._wishes.append(lambda: self._stop_task(task, Ending.CANCELLED))
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
            return (
                self._ready.wait_for(lambda: self._is_over or self._n_up() >= self.target, timeout)
                and not self._is_over
            )

    # The thread.

    def _run(self) -> None:
        """Look after everything until it is closed and all jobs are answered."""
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
        if self._nursery is not None:
            self._nursery.close()
        for worker in self.workers.values():
            worker.close()
        self.workers = {}
        with self._over:
            self._is_over = True
            os.close(self._wake)
        self._selector.close()
        for task in self._backlog.all_open():  # none, unless this thread failed
            self._desk.fail(task, ExecutorError("the pool failed; its log says why"))
        with self._ready:
            self._ready.notify_all()

    def _keep_house(self) -> float | None:
        """Do all that is due; how long there is nothing to do then [s]."""
        while self._wishes:
            self._wishes.popleft()()
        now = time.monotonic()
        for task in self._backlog.take_late(now):
            self._stop_task(task, Ending.DEADLINE)
        for worker in list(self.workers.values()):
            if worker.kill_at is not None and worker.kill_at <= now:
                self._lose_patience(worker)
        self._keep_nursery(now)
        self._keep_workers(now)
        self._dispatch()
        return self._wait_s(now)

    def _wait_s(self, now: float) -> float | None:
        times = [worker.kill_at for worker in self.workers.values()]
        times.append(self._backlog.next_deadline())
        starting = [worker.born for worker in self.workers.values() if worker.state is WorkerState.STARTING]
        if self._nursery is not None and not self._nursery.is_ready:
            starting.append(self._nursery.born)
        times += [born + self._settings.start_timeout_s for born in starting]
        times.append(self._not_before if self._not_before > now else None)
        return min((max(0.0, at - time.monotonic()) for at in times if at is not None), default=None)

    # Nursery and workers.

    def _keep_nursery(self, now: float) -> None:
        nursery = self._nursery
        if nursery is None:
            if now >= self._not_before:
                self._start_nursery()
        elif not nursery.is_ready and nursery.born + self._settings.start_timeout_s <= now:
            self._start_failed(f"importing {self._preloaded()} took too long")
            self._close_nursery(nursery)

    def _start_nursery(self) -> None:
        # What workers import themselves need not be there before.
        preload = () if self._setup.preload else self._settings.preload
        try:
            self._nursery = nursery = Nursery(preload, _LOG)
        except OSError as error:
            self._start_failed(str(error))
            return
        self._selector.register(nursery.control, selectors.EVENT_READ, lambda _: self._on_nursery(nursery))
        self._selector.register(nursery.chatter.fd, selectors.EVENT_READ, lambda _: nursery.chatter.read())

    def _close_nursery(self, nursery: Nursery) -> None:
        self._selector.unregister(nursery.control)
        self._selector.unregister(nursery.chatter.fd)
        nursery.close()
        self._nursery = None
        for worker in list(self.workers.values()):
            self._on_ended(worker, "lost with the process it was forked from")

    def _preloaded(self) -> str:
        return ", ".join(self._settings.preload) or "nothing"

    def _on_nursery(self, nursery: Nursery) -> None:
        heard = nursery.hear()
        if heard is None:
            nursery.chatter.read()
            if not nursery.is_ready and time.monotonic() >= self._not_before:
                self._start_failed(f"the process that workers are forked from ended: {nursery.chatter.tail}")
            elif nursery.is_ready:
                _LOG.error("the process that workers are forked from ended (pid %d); starting another", nursery.pid)
            self._close_nursery(nursery)
        elif "ready" in heard:
            self._on_nursery_ready(nursery, heard["ready"])
        elif "failed" in heard:
            self._start_failed(heard["failed"])
        elif heard["ended"] in self.workers:
            self._on_ended(self.workers[heard["ended"]], heard["how"])

    def _on_nursery_ready(self, nursery: Nursery, n_threads: int) -> None:
        if n_threads > 1:
            _LOG.warning(
                "%s: %d threads once imported, so each worker imports for itself", self._preloaded(), n_threads
            )
            self._setup = WorkerSetup(self._settings.preload, self._setup.warm_up, self._setup.max_bytes)
            self._close_nursery(nursery)
        else:
            nursery.is_ready = True

    def _keep_workers(self, now: float) -> None:
        for worker in list(self.workers.values()):
            if worker.state is WorkerState.STARTING and worker.born + self._settings.start_timeout_s <= now:
                self._start_failed(f"worker {worker.number} was not ready after {self._settings.start_timeout_s:g} s")
                self._end_worker(worker)
        lasting = [w for w in self.workers.values() if w.state is not WorkerState.STOPPING and not w.is_tired]
        if self._nursery is not None and self._nursery.is_ready:
            for _ in range(self.target - len(lasting)):
                if now >= self._not_before:
                    self._start_worker(self._nursery)
        surplus = [w for w in lasting if w.state is not WorkerState.BUSY][: max(0, len(lasting) - self.target)]
        if sum(w.is_up for w in lasting) >= self.target:
            surplus += [w for w in self.workers.values() if w.is_tired and w.state is WorkerState.IDLE]
        for worker in surplus:
            self._end_worker(worker)

    def _start_worker(self, nursery: Nursery) -> None:
        self._numbered += 1
        try:
            worker = Worker(self._numbered, self._setup, _LOG)
            nursery.start(worker)
        except OSError as error:
            self._start_failed(str(error))
            return
        self.workers[worker.number] = worker
        self._selector.register(worker.sock, selectors.EVENT_READ, lambda mask: self._on_worker(worker, mask))
        self._selector.register(worker.chatter.fd, selectors.EVENT_READ, lambda _: self._on_chatter(worker))
        self._flush(worker)

    def _end_worker(self, worker: Worker) -> None:
        """Have a worker killed that owes nothing; it is out of the way as soon as that is heard."""
        worker.state, worker.kill_at = WorkerState.STOPPING, None
        self._unregister(worker.sock)
        if self._nursery is not None:
            self._nursery.kill(worker)

    def _on_ended(self, worker: Worker, how: str) -> None:
        """A worker is no more."""
        if worker.state is not WorkerState.STOPPING:
            self._read(worker)  # it may have answered before
        del self.workers[worker.number]
        self._unregister(worker.sock)
        self._unregister(worker.chatter.fd)
        worker.close()
        if worker.state is WorkerState.STARTING:
            self._start_failed(f"worker {worker.number} ended ({how}) before it was ready: {worker.chatter.tail}")
        elif worker.state is not WorkerState.STOPPING:
            self.restarts += 1
            _LOG.warning("worker %d (pid %s) ended: %s", worker.number, worker.pid, how)
        if worker.task is not None:
            self._desk.worker_died(worker.task, how, worker.chatter.tail)

    def _start_failed(self, reason: str) -> None:
        """Wait longer before the next attempt, each time; tell those who wait when there is little hope."""
        now = time.monotonic()
        _LOG.error("a worker could not be started: %s", reason)
        if now < self._not_before:
            return  # another one of the same attempt
        self._failures += 1
        self._not_before = now + min(FIRST_WAIT_S * 2 ** (self._failures - 1), LONGEST_WAIT_S)
        if self._failures >= FAILED_STARTS and self._n_up() == 0:
            self._desk.give_up(reason)

    def _n_up(self) -> int:
        return sum(worker.is_up for worker in list(self.workers.values()))

    # What workers say.

    def _on_worker(self, worker: Worker, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._flush(worker)
        if mask & selectors.EVENT_READ:
            self._read(worker)

    def _on_chatter(self, worker: Worker) -> None:
        if not worker.chatter.read():
            self._unregister(worker.chatter.fd)

    def _read(self, worker: Worker) -> None:
        try:
            for frame in worker.read():
                self._take(worker, frame)
        except Exception:  # whatever a worker says, the others' jobs go on
            _LOG.exception("worker %d (pid %s) says what makes no sense", worker.number, worker.pid)
            self._unregister(worker.sock)
            self._kill(worker)
        if worker.is_closed:  # it has ended, which the nursery tells, or is of no more use
            self._unregister(worker.sock)
            self._kill(worker)

    def _kill(self, worker: Worker) -> None:
        if self._nursery is not None:
            self._nursery.kill(worker)

    def _take(self, worker: Worker, frame: Frame) -> None:
        if frame.kind is Kind.BORN:
            worker.pid = int(frame.payload)
            worker.chatter.who = f"worker {worker.number} (pid {worker.pid})"
        elif frame.kind is Kind.READY:
            self._failures = 0
            worker.state = WorkerState.IDLE
            with self._ready:
                self._ready.notify_all()
        elif frame.kind is Kind.UNREADY:
            self._start_failed(frame.payload.decode(errors="replace"))
            self._end_worker(worker)
        elif worker.task is not None and worker.task.job.number == frame.job:
            if frame.kind is Kind.EVENT:
                self._desk.hand_on(worker.task, frame.payload)
            else:
                self._answered(worker, worker.task, frame)

    def _answered(self, worker: Worker, task: Task, frame: Frame) -> None:
        worker.task, worker.kill_at, worker.state = None, None, WorkerState.IDLE
        worker.jobs_done += 1
        limit = self._settings.recycle_after
        if limit is not None and worker.jobs_done >= limit:
            worker.is_tired = not any(other.is_tired for other in self.workers.values())  # one at a time
        if frame.kind is Kind.RETURNED:
            self._desk.returned(task, frame.payload)
        else:
            self._desk.raised(task, frame.payload)

    # Jobs.

    def _dispatch(self) -> None:
        idle = [worker for worker in self.workers.values() if worker.state is WorkerState.IDLE and not worker.is_closed]
        idle.sort(key=lambda worker: worker.is_tired)
        for worker in idle:
            task = self._desk.next_task()
            if task is None:
                return
            job = task.job
            job.started, job.pid, job.attempts = time.monotonic(), worker.pid, job.attempts + 1
            worker.run(task)
            self._flush(worker)

    def _flush(self, worker: Worker) -> None:
        events = selectors.EVENT_READ if worker.flush() else selectors.EVENT_READ | selectors.EVENT_WRITE
        key = self._selector.get_key(worker.sock)
        if key.events != events:
            self._selector.modify(worker.sock, events, key.data)

    def _stop_task(self, task: Task, ending: Ending) -> None:
        """Ask a job to stop, or let it never begin."""
        if self._desk.drop(task, ending):
            return
        worker = next((worker for worker in self.workers.values() if worker.task is task), None)
        if worker is not None and task.ending is None:
            task.ending = ending
            worker.ask_to_stop(task, time.monotonic() + self._settings.grace_s)

    def _lose_patience(self, worker: Worker) -> None:
        """Kill the worker of a job that was asked to stop and did not."""
        self._read(worker)
        task = worker.task
        if task is None or task.ending is None:
            return  # it has stopped at the last moment
        worker.task = None
        self.restarts += 1
        self._end_worker(worker)
        self._desk.killed(task)

    def _unregister(self, source: Any) -> None:
        if source in self._selector.get_map():
            self._selector.unregister(source)
