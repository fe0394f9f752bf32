"""The pool's view of one worker, on any machine or as a process of this one."""

from __future__ import annotations

import asyncio
import enum
import os
import pickle
import socket
from abc import ABC, abstractmethod

from service.executor import linux
from service.executor.channel import Kind, Message, MessageReader, MessageWriter, ProcessOutput
from service.executor.fork_server import ForkServer
from service.executor.job import JobRecord
from service.executor.worker import SharedFlags, WorkerSetup

STOPPED_LOOKS = 2  # in a row at a stopped process, after which it counts as one that does not go on
SILENT_LOOKS = 4  # at a worker that neither beats nor computes
STUCK_S = 10.0  # processor time without a beat, in a native call; the planner's longest take 0.3 s


class WorkerState(enum.Enum):
    """State of a worker; one that has ended is forgotten."""

    STARTING = "starting"
    IDLE = "idle"
    BUSY = "busy"
    STOPPING = "stopping"


class WorkerHandle(ABC):
    """The pool's view of one worker.

    Attributes:
        number: counts the pool's workers from 1.
        state: what it is doing.
        pid: on its own machine; None until it has sent it.
        record: the job it runs.
        limit: kills it when it does not become ready, or does not stop.
        jobs_done: how many jobs it has finished.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.state = WorkerState.STARTING
        self.pid: int | None = None
        self.record: JobRecord | None = None
        self.limit: asyncio.TimerHandle | None = None
        self.jobs_done = 0

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


class WorkerProcess(WorkerHandle):
    """The pool's view of one worker process.

    Attributes:
        is_lost: it has closed its socket or sent nonsense.
        is_retiring: it has done ``recycle_after`` jobs and ends as soon as its replacement is up.
        output: what it writes.
        sock: the pool's end of the socket to it.
        reader, writer: the messages on the socket.
    """

    def __init__(self, number: int, server: ForkServer, setup: WorkerSetup) -> None:
        """Fork the process.

        Raises:
            OSError: out of resources, or the fork server has ended.
        """
        super().__init__(number)
        self.is_lost = self.is_retiring = False
        self.output = ProcessOutput(f"worker {number}")
        self.sock, child_sock = socket.socketpair()
        self.sock.setblocking(False)
        fd, self._flags = SharedFlags.create()
        self.reader, self.writer = MessageReader(self.sock), MessageWriter(self.sock)
        self.writer.put(Message(Kind.SETUP, 0, pickle.dumps(setup)))
        self._n_stopped = self._n_waiting = self._last_beats = 0  # looks in a row; beats at the last one
        self._busy_s: list[float] = []
        try:
            server.fork_worker(number, [child_sock.fileno(), fd, self.output.write_fd])
        except OSError:
            self.close()
            raise
        finally:
            child_sock.close()
            os.close(fd)
            self.output.close_write_end()

    @property
    def rss_bytes(self) -> int:
        """Resident memory, shared pages included; 0 where it is not known."""
        return 0 if self.pid is None else linux.rss_bytes(self.pid)

    def request_stop(self, record: JobRecord) -> None:
        """Have ``should_stop`` of its job return True."""
        self._flags.cancelled = record.job.number

    def find_fault(self) -> str:
        """Return why it does not go on, empty while it does; called at regular times."""
        if self.pid is None or self.state is WorkerState.STOPPING:
            return ""
        started = linux.descendants(self.pid) if self.state is WorkerState.BUSY else ()
        is_stopped = any(linux.state_of(pid) == "T" for pid in (self.pid, *started))
        self._n_stopped = self._n_stopped + 1 if is_stopped else 0
        beats, self._last_beats = self._last_beats, self._flags.beats
        if beats != self._last_beats or not self.is_up:  # while it starts, it may wait for a disk
            self._n_waiting, self._busy_s = 0, []
        else:
            is_waiting, used_s = linux.read_activity(self.pid)
            self._n_waiting = self._n_waiting + 1 if is_waiting and self._busy_s[-1:] == [used_s] else 0
            self._busy_s = [*self._busy_s[:1], used_s]  # at the first look without a beat, and at this one
        fault = ""
        if self._n_stopped > STOPPED_LOOKS:
            fault = "is stopped"
        elif self._n_waiting > SILENT_LOOKS:
            fault = "waits for something that does not happen and keeps the interpreter's lock"
        elif self._busy_s and self._busy_s[-1] - self._busy_s[0] > STUCK_S:
            fault = f"has kept the interpreter's lock for {STUCK_S:g} s of processor time"
        if fault:  # named again only if it still holds after some time
            self._n_stopped, self._n_waiting, self._busy_s = 0, 0, []
        return fault

    def close(self) -> None:
        """Close its socket, output and flags once it has ended."""
        self.sock.close()
        self.output.close()
        del self._flags  # whose memory keeps a descriptor
