"""An executor whose workers are processes of this machine."""

from __future__ import annotations

import dataclasses
import os
import selectors
import threading
from collections.abc import Callable
from typing import Any

from service.executor.interface import WorkerState
from service.executor.job_queue import LOG, JobQueue, JobRecord
from service.executor.local_processes import ForkServer, WorkerProcess
from service.executor.messages import Kind, Message
from service.executor.pool import Pool, check_callable, check_workers
from service.executor.supervisor import PoolSettings, Supervisor
from service.executor.worker import WorkerSetup


class LocalPool(Pool):
    """Long-lived worker processes, forked from a process that has imported the modules they need.

    The workers, and the processes they start, end with this process, however it ends. The functions they run are looked
    up by name in modules; the main script is not imported again, so its own functions cannot be run.
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
        check_workers(workers)
        check_callable(warm_up)
        settings = PoolSettings(warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s)
        queue = JobQueue()
        super().__init__(queue, _LocalSupervisor(workers, settings, queue))


class _LocalSupervisor(Supervisor[WorkerProcess]):
    """The thread that keeps the fork server and its workers running and talks to them without ever blocking."""

    def __init__(self, target: int, settings: PoolSettings, queue: JobQueue) -> None:
        super().__init__("scopt-pool", target, settings, queue)
        self._setup = WorkerSetup((), settings.warm_up, settings.max_bytes)
        self._fork_server: ForkServer | None = None
        self._selector = selectors.DefaultSelector()
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._selector.register(self._wake_fd, selectors.EVENT_READ, lambda _: os.eventfd_read(self._wake_fd))
        self._waking = threading.Lock()  # held while the descriptor may be used
        self._thread.start()

    def wake(self) -> bool:
        with self._waking:
            if not self._is_over:
                os.eventfd_write(self._wake_fd, 1)
            return not self._is_over

    def _wait_for_events(self, timeout_s: float | None) -> None:
        for key, mask in self._selector.select(timeout_s):
            if self._selector.get_map().get(key.fd) is key:  # an event before may have closed it
                key.data(mask)

    def _close_workers(self) -> None:
        if self._fork_server is not None:
            self._fork_server.close()
        for worker in self.workers:
            worker.close()
        self.workers = ()
        self._selector.close()
        with self._waking:
            self._is_over = True
            os.close(self._wake_fd)

    # Fork server.

    def _check_fork_server(self, now: float) -> None:
        """Start the fork server when there is none, end one that does not become ready."""
        server = self._fork_server
        if server is None:
            if not self._backoff.is_waiting:
                self._start_fork_server()
        elif not server.is_ready and server.started + self._settings.start_timeout_s <= now:
            self._note_failed_start(f"importing {self._name_preload()} took too long")
            self._close_fork_server(server)

    def _start_fork_server(self) -> None:
        # Modules that workers import themselves need not be imported before.
        preload = () if self._setup.preload else self._settings.preload
        try:
            self._fork_server = server = ForkServer(preload)
        except OSError as error:
            self._note_failed_start(str(error))
            return
        self._selector.register(server.control, selectors.EVENT_READ, lambda _: self._on_fork_server(server))
        self._selector.register(server.output.fd, selectors.EVENT_READ, lambda _: server.output.read())

    def _on_fork_server(self, server: ForkServer) -> None:
        message = server.receive()
        if message is None:
            server.output.read()
            reason = f"the process that workers are forked from (pid {server.pid}) ended: {server.output.tail}"
            if server.is_ready:
                LOG.error("%s", reason)
            elif not self._backoff.is_waiting:  # else it has sent the reason
                self._note_failed_start(reason)
            self._close_fork_server(server)
        elif "ready" in message:
            self._on_imported(server, message["ready"])
        elif "failed" in message:
            self._note_failed_start(message["failed"])
        else:
            for worker in self.workers:
                if worker.number == message["ended"]:
                    self._on_worker_ended(worker, message["cause"])

    def _on_imported(self, server: ForkServer, n_threads: int) -> None:
        if n_threads == 1:
            server.is_ready = True
            return
        LOG.warning("%s: %d threads once imported, so each worker imports for itself", self._name_preload(), n_threads)
        self._setup = dataclasses.replace(self._setup, preload=self._settings.preload)
        self._close_fork_server(server)

    def _name_preload(self) -> str:
        return ", ".join(self._settings.preload) or "nothing"

    def _close_fork_server(self, server: ForkServer) -> None:
        self._selector.unregister(server.control)
        self._selector.unregister(server.output.fd)
        server.close()
        self._fork_server = None
        for worker in self.workers:
            self._on_worker_ended(worker, "lost with the process it was forked from")

    # Workers.

    def _adjust_workers(self, now: float) -> None:
        self._check_fork_server(now)
        lasting = [w for w in self.workers if w.state is not WorkerState.STOPPING and not w.is_retiring]
        if self._fork_server is not None and self._fork_server.is_ready:
            for _ in range(self.target - len(lasting)):
                if not self._backoff.is_waiting:
                    self._start_worker(self._fork_server)
        surplus = [w for w in lasting if w.state is not WorkerState.BUSY][: max(0, len(lasting) - self.target)]
        if sum(worker.is_up for worker in lasting) >= self.target:
            surplus += [w for w in self.workers if w.is_retiring and w.state is WorkerState.IDLE]
        for worker in surplus:
            self._end_worker(worker)

    def _next_checks(self) -> list[float | None]:
        server = self._fork_server
        return [] if server is None or server.is_ready else [server.started + self._settings.start_timeout_s]

    def _start_worker(self, server: ForkServer) -> None:
        self._n_started += 1
        try:
            worker = server.start_worker(self._n_started, self._setup)
        except OSError as error:
            self._note_failed_start(str(error))
            return
        self.workers = (*self.workers, worker)
        self._selector.register(worker.sock, selectors.EVENT_READ, lambda mask: self._on_socket(worker, mask))
        self._selector.register(worker.output.fd, selectors.EVENT_READ, lambda _: self._on_output(worker))
        self._flush(worker)

    def _end_worker(self, worker: WorkerProcess) -> None:
        worker.state, worker.kill_at = WorkerState.STOPPING, None
        self._unregister(worker.sock)
        self._kill(worker)

    def _kill(self, worker: WorkerProcess) -> None:
        if self._fork_server is not None:
            self._fork_server.kill_worker(worker)

    def _on_worker_ended(self, worker: WorkerProcess, cause: str) -> None:
        if worker.state is not WorkerState.STOPPING:
            self._read(worker, everything=True)  # it may have sent a result before
        self.workers = tuple(other for other in self.workers if other is not worker)
        self._unregister(worker.sock)
        self._unregister(worker.output.fd)
        worker.close()
        self._note_death(worker, cause, cause, worker.output.tail)

    # Sockets and output of workers.

    def _on_socket(self, worker: WorkerProcess, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._flush(worker)
        if mask & selectors.EVENT_READ:
            self._read(worker)

    def _on_output(self, worker: WorkerProcess) -> None:
        if not worker.output.read():
            self._unregister(worker.output.fd)

    def _flush(self, worker: WorkerProcess) -> None:
        """Send a worker its messages, now or as soon as its socket takes more."""
        events = selectors.EVENT_READ if worker.flush() else selectors.EVENT_READ | selectors.EVENT_WRITE
        key = self._selector.get_key(worker.sock)
        if key.events != events:
            self._selector.modify(worker.sock, events, key.data)

    def _read(self, worker: WorkerProcess, everything: bool = False) -> None:
        """Handle a worker's messages; only the first ones, since other workers wait, unless ``everything`` is set."""
        try:
            for message in worker.read(everything):
                self._on_message(worker, message)
        except Exception:  # whatever a worker sends, the others' jobs go on
            LOG.exception("worker %d (pid %s) sent a malformed message", worker.number, worker.pid)
            worker.is_lost = True
        if worker.is_lost:  # it has ended, which the fork server reports, or is of no more use
            self._unregister(worker.sock)
            self._kill(worker)

    def _on_message(self, worker: WorkerProcess, message: Message) -> None:
        is_starting = worker.state is WorkerState.STARTING
        if is_starting and message.kind is Kind.STARTED:
            worker.pid = int(message.payload)
            worker.output.name = f"worker {worker.number} (pid {worker.pid})"
        elif is_starting and message.kind is Kind.READY:
            self._note_up(worker)
        elif is_starting and message.kind is Kind.START_FAILED:
            self._note_failed_start(message.payload.decode(errors="replace"))
            self._end_worker(worker)
        elif message.kind in (Kind.EVENT, Kind.RETURNED, Kind.RAISED):
            self._on_job_message(worker, message)
        elif worker.state is not WorkerState.STOPPING:
            raise ValueError(f"{message.kind.name} of a worker that is {worker.state.value}")

    def _unregister(self, source: Any) -> None:
        if source in self._selector.get_map():
            self._selector.unregister(source)

    # Jobs.

    def _select_idle(self) -> list[WorkerProcess]:
        return sorted((w for w in super()._select_idle() if not w.is_lost), key=lambda worker: worker.is_retiring)

    def _send_job(self, worker: WorkerProcess, record: JobRecord) -> None:
        worker.put_job(record)
        self._flush(worker)

    def _on_job_message(self, worker: WorkerProcess, message: Message) -> None:
        record = worker.record
        if record is None or record.job.number != message.job:
            return  # of a job that has ended
        if message.kind is Kind.EVENT:
            self._results.deliver_event(record, message.payload)
            return
        limit = self._settings.recycle_after
        if limit is not None and worker.jobs_done + 1 >= limit:
            worker.is_retiring = not any(other.is_retiring for other in self.workers)  # at most one at a time
        self._finish_job(worker, record, message.kind is Kind.RETURNED, message.payload)

    def _kill_overdue(self, worker: WorkerProcess) -> None:
        self._read(worker)
        if worker.record is not None:  # else it has stopped at the last moment
            super()._kill_overdue(worker)
