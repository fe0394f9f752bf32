"""The pool's handles of its processes on this machine: the fork server, the workers forked from it, their output."""

from __future__ import annotations

import json
import os
import pickle
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from service.executor import linux
from service.executor.fork_server import MAX_REQUEST, START_COMMAND
from service.executor.job_queue import LOG, JobRecord
from service.executor.messages import Kind, Message, MessageReader, MessageWriter
from service.executor.supervisor import WorkerHandle
from service.executor.worker import WorkerSetup, create_cancel_flag

_EXIT_TIMEOUT_S = 5.0
_CHUNK = 2**16
_MAX_LINE = 2000
_MAX_TAIL = 1000
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
}


class ProcessOutput:
    """A pipe for a process's standard output and error: logged line by line, its end kept.

    Attributes:
        name: of the process in the log.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._line = b""
        self._tail = b""
        self.fd, self.write_fd = os.pipe()
        os.set_blocking(self.fd, False)

    @property
    def tail(self) -> str:
        """The end of the output."""
        return self._tail.decode(errors="replace").strip()

    def read(self) -> bool:
        """Log what has arrived; return False when no more can follow."""
        try:
            data = os.read(self.fd, _CHUNK)
        except BlockingIOError:
            return True
        self._tail = (self._tail + data)[-_MAX_TAIL:]
        *lines, self._line = (self._line + data).split(b"\n")
        if len(self._line) > _MAX_LINE or not data:
            lines, self._line = [*lines, self._line], b""
        for line in lines:
            if line.strip():
                LOG.info("%s: %s", self.name, line[:_MAX_LINE].decode(errors="replace").rstrip())
        return bool(data)

    def close_write_end(self) -> None:
        """Close the writing end once the process has its copy."""
        if self.write_fd >= 0:
            os.close(self.write_fd)
            self.write_fd = -1

    def close(self) -> None:
        """Log the rest and close the pipe."""
        self.close_write_end()
        self.read()
        os.close(self.fd)


class ForkServer:
    """The process that workers are forked from, as the pool sees it.

    Attributes:
        is_ready: it has imported its modules and has one thread.
        started: when it was started, on the clock of ``time.monotonic`` [s].
        output: what it writes.
        control: the socket on which it answers.
    """

    def __init__(self, preload: tuple[str, ...]) -> None:
        self.is_ready = False
        self.started = time.monotonic()
        self.output = ProcessOutput("fork server")
        self.control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", START_COMMAND, str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=self.output.write_fd,
                stderr=self.output.write_fd,
                env={**os.environ, **_ONE_THREAD},
                pass_fds=[other.fileno()],
            )
        self.output.close_write_end()
        self._send({"path": sys.path, "parent": os.getpid(), "preload": preload})

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def start_worker(self, number: int, setup: WorkerSetup) -> WorkerProcess:
        """Fork a worker.

        Raises:
            OSError: out of resources, or the process has ended.
        """
        worker = WorkerProcess(number, setup)
        try:
            socket.send_fds(self.control, [json.dumps({"start": number}).encode()], worker.child_fds)
        except OSError:
            worker.close_child_ends()
            worker.close()
            raise
        worker.close_child_ends()
        return worker

    def kill_worker(self, worker: WorkerProcess) -> None:
        """Kill a worker, unless it has ended."""
        self._send({"kill": worker.number})

    def receive(self) -> dict[str, Any] | None:
        """Return the next message, which must have arrived; None when the process has ended."""
        try:
            data = self.control.recv(MAX_REQUEST)
        except OSError:
            return None
        message: dict[str, Any] | None = json.loads(data) if data else None
        return message

    def close(self) -> None:
        """End it and all its workers, and wait for that."""
        self.control.close()
        try:
            self._process.wait(_EXIT_TIMEOUT_S if self.is_ready else 0.0)  # while it imports it reads no requests
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.output.close()

    def _send(self, request: dict[str, Any]) -> None:
        with suppress(OSError):  # it has ended, which `receive` reports
            self.control.send(json.dumps(request).encode())


class WorkerProcess(WorkerHandle):
    """The pool's view of one worker process.

    Attributes:
        is_lost: it has closed its socket or sent nonsense.
        is_retiring: it has done ``recycle_after`` jobs and ends as soon as its replacement is up.
        output: what it writes.
        sock: the pool's end of the socket to it.
    """

    def __init__(self, number: int, setup: WorkerSetup) -> None:
        super().__init__(number)
        self.is_lost = self.is_retiring = False
        self.output = ProcessOutput(f"worker {number}")
        self.sock, self._child_sock = socket.socketpair()
        self.sock.setblocking(False)
        self._cancel_fd, self._cancel_flag = create_cancel_flag()
        self._reader, self._writer = MessageReader(self.sock), MessageWriter(self.sock)
        self._writer.put(Message(Kind.SETUP, 0, pickle.dumps(setup)))

    @property
    def rss_bytes(self) -> int:
        """Resident memory, shared pages included; 0 where it is not known."""
        return 0 if self.pid is None else linux.rss_bytes(self.pid)

    @property
    def child_fds(self) -> list[int]:
        """Descriptors for the worker's process: socket, cancel flag, standard output and error."""
        return [self._child_sock.fileno(), self._cancel_fd, self.output.write_fd]

    def close_child_ends(self) -> None:
        """Close the descriptors that the worker's process has copies of."""
        self._child_sock.close()
        os.close(self._cancel_fd)
        self.output.close_write_end()

    def put_job(self, record: JobRecord) -> None:
        """Queue a job for sending; ``flush`` sends it."""
        self._writer.put(Message(Kind.RUN, record.job.number, record.payload))

    def flush(self) -> bool:
        """Send what the socket takes without waiting; return whether nothing is left."""
        return self._writer.flush()

    def read(self, everything: bool) -> Iterator[Message]:
        """Yield its messages, or the first of them."""
        yield from self._reader.read(everything)
        self.is_lost |= self._reader.is_closed

    def request_stop(self, record: JobRecord) -> None:
        """Have ``should_stop`` of its job return True."""
        self._cancel_flag.value = record.job.number

    def close(self) -> None:
        """Close its socket and output once it has ended."""
        self.sock.close()
        self.output.close()
