"""A pool's workers on this machine: started, listened to, ended, replaced; what they work at is nothing to it."""

from __future__ import annotations

import logging
import selectors
from abc import ABC, abstractmethod
from typing import Any

from service.executor.backoff import Backoff
from service.executor.frames import Frame, Kind
from service.executor.interface import WorkerState
from service.executor.nest import Nursery, Worker
from service.executor.settings import Settings
from service.executor.worker import WorkerSetup

_LOG = logging.getLogger("service.executor")


class Crew(ABC):
    """Nursery and workers, used by one thread; others may read the attributes.

    Attributes:
        target: how many workers there shall be.
        workers: those there are, those included that are ending; a new tuple at each change.
        restarts: how many died or were killed.
    """

    def __init__(self, target: int, settings: Settings) -> None:
        self.target = target
        self.workers: tuple[Worker, ...] = ()
        self.restarts = 0
        self._settings = settings
        self._selector = selectors.DefaultSelector()
        self._setup = WorkerSetup((), settings.warm_up, settings.max_bytes)
        self._nursery: Nursery | None = None
        self._backoff = Backoff()
        self._numbered = 0

    @abstractmethod
    def _on_ready(self, worker: Worker) -> None:
        """A worker has come up."""

    @abstractmethod
    def _on_frame(self, worker: Worker, frame: Frame) -> None:
        """A worker has said something about a job."""

    @abstractmethod
    def _on_lost(self, worker: Worker, how: str) -> None:
        """A worker is no more."""

    @abstractmethod
    def _on_hopeless(self, reason: str) -> None:
        """No worker is up, and again none could be started."""

    @property
    def n_up(self) -> int:
        """How many workers are up."""
        return sum(worker.is_up for worker in self.workers)

    def _keep_crew(self, now: float) -> None:
        """Start what is missing, end what is too much or never becomes ready."""
        self._keep_nursery(now)
        for worker in self.workers:
            if worker.state is WorkerState.STARTING and worker.born + self._settings.start_timeout_s <= now:
                self._start_failed(f"worker {worker.number} was not ready after {self._settings.start_timeout_s:g} s")
                self._end_worker(worker)
        lasting = [w for w in self.workers if w.state is not WorkerState.STOPPING and not w.is_tired]
        if self._nursery is not None and self._nursery.is_ready:
            for _ in range(self.target - len(lasting)):
                if not self._backoff.is_waiting:
                    self._start_worker(self._nursery)
        surplus = [w for w in lasting if w.state is not WorkerState.BUSY][: max(0, len(lasting) - self.target)]
        if sum(worker.is_up for worker in lasting) >= self.target:
            surplus += [w for w in self.workers if w.is_tired and w.state is WorkerState.IDLE]
        for worker in surplus:
            self._end_worker(worker)

    def _crew_is_due(self) -> list[float]:
        """When there is something to do again if nobody says anything [s]."""
        starting = [worker.born for worker in self.workers if worker.state is WorkerState.STARTING]
        if self._nursery is not None and not self._nursery.is_ready:
            starting.append(self._nursery.born)
        times = [born + self._settings.start_timeout_s for born in starting]
        return [*times, self._backoff.until] if self._backoff.is_waiting else times

    def _close_crew(self) -> None:
        if self._nursery is not None:
            self._nursery.close()
        for worker in self.workers:
            worker.close()
        self.workers = ()
        self._selector.close()

    # Nursery.

    def _keep_nursery(self, now: float) -> None:
        nursery = self._nursery
        if nursery is None:
            if not self._backoff.is_waiting:
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

    def _on_nursery(self, nursery: Nursery) -> None:
        heard = nursery.hear()
        if heard is None:
            nursery.chatter.read()
            reason = f"the process that workers are forked from (pid {nursery.pid}) ended: {nursery.chatter.tail}"
            if nursery.is_ready:
                _LOG.error("%s", reason)
            elif not self._backoff.is_waiting:  # else it has said why
                self._start_failed(reason)
            self._close_nursery(nursery)
        elif "ready" in heard:
            self._on_nursery_ready(nursery, heard["ready"])
        elif "failed" in heard:
            self._start_failed(heard["failed"])
        else:
            for worker in self.workers:
                if worker.number == heard["ended"]:
                    self._on_ended(worker, heard["how"])

    def _on_nursery_ready(self, nursery: Nursery, n_threads: int) -> None:
        if n_threads == 1:
            nursery.is_ready = True
            return
        _LOG.warning("%s: %d threads once imported, so each worker imports for itself", self._preloaded(), n_threads)
        self._setup = WorkerSetup(self._settings.preload, self._setup.warm_up, self._setup.max_bytes)
        self._close_nursery(nursery)

    def _preloaded(self) -> str:
        return ", ".join(self._settings.preload) or "nothing"

    def _close_nursery(self, nursery: Nursery) -> None:
        self._selector.unregister(nursery.control)
        self._selector.unregister(nursery.chatter.fd)
        nursery.close()
        self._nursery = None
        for worker in self.workers:
            self._on_ended(worker, "lost with the process it was forked from")

    # Workers.

    def _start_worker(self, nursery: Nursery) -> None:
        self._numbered += 1
        try:
            worker = nursery.start(self._numbered, self._setup, _LOG)
        except OSError as error:
            self._start_failed(str(error))
            return
        self.workers = (*self.workers, worker)
        self._selector.register(worker.sock, selectors.EVENT_READ, lambda mask: self._on_worker(worker, mask))
        self._selector.register(worker.chatter.fd, selectors.EVENT_READ, lambda _: self._on_chatter(worker))
        self._flush(worker)

    def _start_failed(self, reason: str) -> None:
        _LOG.error("a worker could not be started: %s", reason)
        if self._backoff.failed() and self.n_up == 0:
            self._on_hopeless(reason)

    def _on_worker(self, worker: Worker, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._flush(worker)
        if mask & selectors.EVENT_READ:
            self._read(worker)

    def _on_chatter(self, worker: Worker) -> None:
        if not worker.chatter.read():
            self._unregister(worker.chatter.fd)

    def _flush(self, worker: Worker) -> None:
        """Send a worker what waits for it, now or as soon as it takes more."""
        events = selectors.EVENT_READ if worker.flush() else selectors.EVENT_READ | selectors.EVENT_WRITE
        key = self._selector.get_key(worker.sock)
        if key.events != events:
            self._selector.modify(worker.sock, events, key.data)

    def _read(self, worker: Worker, everything: bool = False) -> None:
        """Hear what a worker has said; not too much at a time, for there are others."""
        try:
            for frame in worker.read(everything):
                self._take(worker, frame)
        except Exception:  # whatever a worker says, the others' jobs go on
            _LOG.exception("worker %d (pid %s) says what makes no sense", worker.number, worker.pid)
            worker.is_lost = True
        if worker.is_lost:  # it has ended, which the nursery tells, or is of no more use
            self._unregister(worker.sock)
            self._kill(worker)

    def _take(self, worker: Worker, frame: Frame) -> None:
        is_starting = worker.state is WorkerState.STARTING
        if is_starting and frame.kind is Kind.BORN:
            worker.pid = int(frame.payload)
            worker.chatter.who = f"worker {worker.number} (pid {worker.pid})"
        elif is_starting and frame.kind is Kind.READY:
            self._backoff.succeeded()
            worker.state = WorkerState.IDLE
            self._on_ready(worker)
        elif is_starting and frame.kind is Kind.UNREADY:
            self._start_failed(frame.payload.decode(errors="replace"))
            self._end_worker(worker)
        elif frame.kind in (Kind.EVENT, Kind.RETURNED, Kind.RAISED):
            self._on_frame(worker, frame)
        elif worker.state is not WorkerState.STOPPING:
            raise ValueError(f"{frame.kind.name} of a worker that is {worker.state.value}")

    def _end_worker(self, worker: Worker) -> None:
        """Have a worker killed that owes nothing; it is out of the way as soon as that is heard."""
        worker.state, worker.kill_at = WorkerState.STOPPING, None
        self._unregister(worker.sock)
        self._kill(worker)

    def _kill(self, worker: Worker) -> None:
        if self._nursery is not None:
            self._nursery.kill(worker)

    def _on_ended(self, worker: Worker, how: str) -> None:
        if worker.state is not WorkerState.STOPPING:
            self._read(worker, everything=True)  # it may have answered before
        self.workers = tuple(other for other in self.workers if other is not worker)
        self._unregister(worker.sock)
        self._unregister(worker.chatter.fd)
        worker.close()
        if worker.state is WorkerState.STARTING:
            self._start_failed(f"worker {worker.number} ended ({how}) before it was ready: {worker.chatter.tail}")
        elif worker.state is not WorkerState.STOPPING:
            self.restarts += 1
            _LOG.warning("worker %d (pid %s) ended: %s", worker.number, worker.pid, how)
        self._on_lost(worker, how)

    def _unregister(self, source: Any) -> None:
        if source in self._selector.get_map():
            self._selector.unregister(source)
