"""An executor whose workers are processes of this machine."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress

from service.executor import linux
from service.executor.channel import Inbox, Kind, Message, ProcessOutput
from service.executor.fork_server import ForkServer
from service.executor.job import LOG, JobRecord
from service.executor.job_queue import JobQueue
from service.executor.pool import Pool
from service.executor.supervisor import PoolSettings, Supervisor
from service.executor.worker import WorkerSetup
from service.executor.worker_handle import STOPPED_LOOKS, WorkerProcess, WorkerState

N_STANDBYS = 2  # copies of the fork server, since importing takes longer than anybody wants to wait
WATCH_EVERY_S = 0.25  # between two looks at the processes


class LocalPool(Pool):
    """Long-lived worker processes, forked from a process that has imported the modules they need.

    A worker that dies, is stopped by a signal, or whose Python does not go on, is replaced, and its job is started
    again.

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
        light_workers: int = 0,
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
            light_workers: further workers, so that jobs of the light lane never wait for others. Any worker may run
                them; at most ``workers`` run other jobs.
        """
        settings = PoolSettings(
            workers, warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s, light_workers
        )
        queue = JobQueue()
        super().__init__(queue, _LocalSupervisor(settings, queue))


class _LocalSupervisor(Supervisor[WorkerProcess]):
    """Keeps the fork server and its workers running, and talks to them without ever waiting for one of them."""

    _any_thread_sends = True

    def __init__(self, settings: PoolSettings, queue: JobQueue) -> None:
        super().__init__("scopt-pool", settings, queue)
        self._setup = WorkerSetup((), settings.warm_up, settings.max_bytes)
        self._server: ForkServer | None = None
        self._standbys: list[ForkServer] = []
        self._n_stopped = 0  # looks in a row at a stopped fork server
        self._inbox = Inbox(self._loop, self._guard, self._read_ready)
        self._output = ProcessOutput("fork server")
        self._loop.add_reader(self._output.fd, self._output.read)
        self._loop.call_soon(self._watch)
        self._thread.start()

    def _close_workers(self) -> None:
        for server in (self._server, *self._standbys):
            if server is not None:
                server.close()
        for worker in self.workers:
            worker.close()
        self._inbox.close()
        self._output.close()

    @contextmanager
    def read_in(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        """Have a running event loop read what workers send while the body runs; to be used in its thread."""
        self._inbox.lend(loop)
        try:
            yield
        finally:
            self._inbox.take_back()

    # Fork server.

    def _start_server(self) -> None:
        # Modules that workers import themselves need not be imported before.
        preload = () if self._setup.preload else self._settings.preload
        try:
            self._server = server = ForkServer.start(preload, self._output.write_fd)
        except OSError as error:
            self._note_failed_start(str(error))
            return
        self._loop.add_reader(server.control, self._on_server, server)
        self._loop.call_later(self._settings.start_timeout_s, self._kill_unready_server, server)

    def _add_standbys(self, server: ForkServer) -> None:
        with suppress(OSError):  # without any, the next fork server imports everything
            while len(self._standbys) < N_STANDBYS:
                self._standbys.append(standby := server.fork_standby())
                self._loop.add_reader(standby.control, self._on_server, standby)

    def _on_server(self, server: ForkServer) -> None:
        """Handle a message of the fork server or a standby."""
        message = server.receive()
        if message is None:
            self._on_server_ended(server)
        elif "pid" in message:
            server.pid = message["pid"]
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
            self._add_standbys(server)
        else:
            text = "%s: %d threads once imported, so each worker imports for itself"
            LOG.warning(text, self._name_preload(), n_threads)
            self._setup = dataclasses.replace(self._setup, preload=self._settings.preload)
            self._close_server(server)
        self._check()

    def _kill_unready_server(self, server: ForkServer) -> None:
        if server is self._server and not server.is_ready:
            self._note_failed_start(f"importing {self._name_preload()} took too long")
            self._close_server(server)
            self._check()

    def _name_preload(self) -> str:
        return ", ".join(self._settings.preload) or "nothing"

    def _on_server_ended(self, server: ForkServer) -> None:
        self._output.read()
        reason = f"the process that workers are forked from (pid {server.pid}) ended: {self._output.tail}"
        if server is not self._server:
            self._standbys.remove(server)
            if server.pid and self._server is not None:  # else it could not be forked
                self._add_standbys(self._server)
        elif server.is_ready:
            LOG.error("%s", reason)
        elif self._may_start:  # else it has sent the reason
            self._note_failed_start(reason)
        self._close_server(server)
        self._check()

    def _close_server(self, server: ForkServer) -> None:
        """Close the fork server, whose place a standby takes, or a standby."""
        self._loop.remove_reader(server.control)
        server.close()
        if server is not self._server:
            return
        for worker in self.workers:
            self._on_worker_ended(worker, "lost with the process it was forked from")
        self._server = self._standbys.pop(0) if self._standbys else None
        if self._server is not None:
            self._add_standbys(self._server)

    # Workers.

    def _watch(self) -> None:
        """Continue a stopped fork server, and replace a worker that does not go on."""
        self._loop.call_later(WATCH_EVERY_S, self._watch)
        server = self._server
        is_stopped = server is not None and linux.state_of(server.pid) == "T"
        self._n_stopped = self._n_stopped + 1 if is_stopped else 0
        if server is not None and self._n_stopped > STOPPED_LOOKS:
            LOG.warning("the process that workers are forked from (pid %d) is stopped; it is continued", server.pid)
            server.resume()
        for worker in self.workers:
            if fault := worker.find_fault():
                LOG.warning("worker %d (pid %s) %s; it is replaced", worker.number, worker.pid, fault)
                self._kill(worker)

    def _adjust_workers(self) -> None:
        if self._server is None and self._may_start:
            self._start_server()
        lasting = [w for w in self.workers if w.state is not WorkerState.STOPPING and not w.is_retiring]
        if self._server is not None and self._server.is_ready:
            for _ in range(self.target - len(lasting)):
                if self._may_start:
                    self._start_worker(self._server)
        surplus = [w for w in lasting if w.state is not WorkerState.BUSY][: max(0, len(lasting) - self.target)]
        if sum(worker.is_up for worker in lasting) >= self.target:
            surplus += [w for w in self.workers if w.is_retiring and w.state is WorkerState.IDLE]
        for worker in surplus:
            self._end_worker(worker)

    def _start_worker(self, server: ForkServer) -> None:
        self._n_started += 1
        try:
            worker = WorkerProcess(self._n_started, server, self._setup)
        except OSError as error:
            self._note_failed_start(str(error))
            return
        self._note_started(worker)
        self._inbox.add(worker.sock)
        self._loop.add_reader(worker.output.fd, self._read_output, worker)
        self._flush(worker)

    def _end_worker(self, worker: WorkerProcess) -> None:
        worker.state = WorkerState.STOPPING
        self._kill(worker)

    def _kill(self, worker: WorkerProcess) -> None:
        self._limit(worker, None)
        self._stop_talking(worker)
        if self._server is not None:
            self._server.kill_worker(worker.number)

    def _on_worker_ended(self, worker: WorkerProcess, cause: str) -> None:
        if worker.state is not WorkerState.STOPPING:
            self._read(worker, everything=True)  # it may have sent a result before
        self._stop_talking(worker)
        self._loop.remove_reader(worker.output.fd)
        worker.close()
        self._note_death(worker, cause, cause, worker.output.tail)

    # Sockets and output.

    def _stop_talking(self, worker: WorkerProcess) -> None:
        self._inbox.remove(worker.sock)
        self._loop.remove_writer(worker.sock)

    def _read_output(self, worker: WorkerProcess) -> None:
        if not worker.output.read():
            self._loop.remove_reader(worker.output.fd)

    def _flush(self, worker: WorkerProcess) -> None:
        """Send a worker its messages, now or as soon as its socket takes more."""
        if worker.writer.flush():
            self._loop.remove_writer(worker.sock)
        else:
            self._loop.add_writer(worker.sock, self._flush, worker)

    def _read_ready(self, ready: Container[int]) -> None:
        """Handle the messages of workers by the descriptors of their sockets."""
        for worker in self.workers:
            if worker.sock.fileno() in ready:
                self._read(worker)

    def _read(self, worker: WorkerProcess, everything: bool = False) -> None:
        """Handle a worker's messages; only the first ones, since other workers wait, unless ``everything`` is set."""
        try:
            for message in worker.reader.read(everything):
                self._on_message(worker, message)
        except Exception:  # whatever a worker sends, the others' jobs go on
            LOG.exception("worker %d (pid %s) sent a malformed message", worker.number, worker.pid)
            worker.is_lost = True
        worker.is_lost |= worker.reader.is_closed
        if worker.is_lost:  # it has ended, which the fork server reports, or is of no more use
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

    # Jobs.

    def _select_idle(self) -> list[WorkerProcess]:
        return sorted((w for w in super()._select_idle() if not w.is_lost), key=lambda worker: worker.is_retiring)

    def _send_job(self, worker: WorkerProcess, record: JobRecord) -> None:
        worker.writer.put(Message(Kind.RUN, record.job.number, record.payload))
        self._flush(worker)

    def _on_job_message(self, worker: WorkerProcess, message: Message) -> None:
        record = worker.record
        if record is None or record.job.number != message.job:
            return  # of a job that has ended
        if message.kind is Kind.EVENT:
            record.deliver_event(message.payload)
            return
        limit = self._settings.recycle_after
        if limit is not None and worker.jobs_done + 1 >= limit:
            worker.is_retiring = not any(other.is_retiring for other in self.workers)  # at most one at a time
        self._finish_job(worker, message.kind is Kind.RETURNED, message.payload)

    def _should_end(self, worker: WorkerProcess) -> bool:
        return super()._should_end(worker) or worker.is_retiring

    def _kill_overdue(self, worker: WorkerProcess) -> None:
        self._read(worker)
        if worker.record is not None:  # else it has stopped at the last moment
            super()._kill_overdue(worker)
