"""The pool's end of the nursery and of the workers that are forked there."""

from __future__ import annotations

import json
import logging
import os
import pickle
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from service.executor import bootstrap
from service.executor.backlog import Task
from service.executor.chatter import Chatter
from service.executor.frames import Frame, Inbox, Kind, Outbox
from service.executor.interface import WorkerState
from service.executor.nursery import MAX_MESSAGE
from service.executor.worker import WorkerSetup, make_cell

_PATIENCE_S = 5.0
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
}


class Nursery:
    """The process that workers are forked from.

    Attributes:
        is_ready: it has imported what it shall and has one thread.
        born: when it was started, on the clock of ``time.monotonic`` [s].
    """

    def __init__(self, preload: tuple[str, ...], log: logging.Logger) -> None:
        self.is_ready = False
        self.born = time.monotonic()
        self.chatter = Chatter(log, "nursery")
        self.control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-P", bootstrap.__file__, str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=self.chatter.write_fd,
                stderr=self.chatter.write_fd,
                env={**os.environ, **_ONE_THREAD},
                pass_fds=[other.fileno()],
            )
        self.chatter.hand_over()
        self._say({"path": sys.path, "parent": os.getpid(), "preload": preload})

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def start(self, number: int, setup: WorkerSetup, log: logging.Logger) -> Worker:
        """Have a worker forked.

        Raises:
            OSError: not now, for lack of something or of the process itself.
        """
        worker = Worker(number, setup, log)
        try:
            socket.send_fds(self.control, [json.dumps({"start": number}).encode()], worker.fds_to_give)
        except OSError:
            worker.hand_over()
            worker.close()
            raise
        worker.hand_over()
        return worker

    def kill(self, worker: Worker) -> None:
        """Have a worker killed; it has ended already is no error."""
        self._say({"kill": worker.number})

    def hear(self) -> dict[str, Any] | None:
        """The next message, which must be there; None when it is gone."""
        try:
            message = self.control.recv(MAX_MESSAGE)
        except OSError:
            return None
        heard: dict[str, Any] | None = json.loads(message) if message else None
        return heard

    def close(self) -> None:
        """End it and all its workers, and wait for that."""
        self.control.close()
        try:
            self._process.wait(_PATIENCE_S if self.is_ready else 0.0)  # one that still imports does not listen
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.chatter.close()

    def _say(self, content: dict[str, Any]) -> None:
        with suppress(OSError):  # it is gone, which is heard next
            self.control.send(json.dumps(content).encode())


class Worker:
    """The pool's end of one worker.

    Attributes:
        number: counts the pool's workers.
        state: what it is doing.
        pid: None until it has said so.
        task: what it runs.
        kill_at: when it is killed unless it stops by itself, on the clock of ``time.monotonic`` [s].
        jobs_done: how many it has answered.
        is_lost: it says no more, or what makes no sense.
        is_tired: it has done its share and ends as soon as another is up in its place.
        born: when it was started [s].
    """

    def __init__(self, number: int, setup: WorkerSetup, log: logging.Logger) -> None:
        self.number = number
        self.state = WorkerState.STARTING
        self.pid: int | None = None
        self.task: Task | None = None
        self.kill_at: float | None = None
        self.jobs_done = 0
        self.is_lost = self.is_tired = False
        self.born = time.monotonic()
        self.chatter = Chatter(log, f"worker {number}")
        self.sock, self._other = socket.socketpair()
        self.sock.setblocking(False)
        self._cell_fd, self._cell = make_cell()
        self._inbox, self._outbox = Inbox(self.sock), Outbox(self.sock)
        self._outbox.put(Frame(Kind.SETUP, 0, pickle.dumps(setup)))

    @property
    def fds_to_give(self) -> list[int]:
        """What the worker's process needs: socket, cancel cell, standard error."""
        return [self._other.fileno(), self._cell_fd, self.chatter.write_fd]

    @property
    def is_up(self) -> bool:
        """Whether it works or could."""
        return self.state in (WorkerState.IDLE, WorkerState.BUSY)

    def hand_over(self) -> None:
        """Close what is the worker's."""
        self._other.close()
        os.close(self._cell_fd)
        self.chatter.hand_over()

    def run(self, task: Task) -> None:
        """Have a job run; ``flush`` sends it."""
        self.state, self.task, self.kill_at = WorkerState.BUSY, task, None
        self._outbox.put(Frame(Kind.RUN, task.job.number, task.payload))

    def flush(self) -> bool:
        """Send what it takes without waiting; whether all is gone."""
        return self._outbox.flush()

    def read(self, everything: bool) -> Iterator[Frame]:
        """What it has said since, or the first of it."""
        yield from self._inbox.read(everything)
        self.is_lost |= self._inbox.is_closed

    def ask_to_stop(self, task: Task, kill_at: float) -> None:
        """Tell its function to stop, and remember when patience ends."""
        self._cell.value = task.job.number
        self.kill_at = kill_at

    def close(self) -> None:
        """Let go of it once it has ended."""
        self.sock.close()
        self.chatter.close()
