"""What a worker process does: become ready, then one call after the other until the pool is gone."""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import importlib
import inspect
import mmap
import os
import pickle
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from service.executor.errors import JobFailed
from service.executor.frames import Channel, Kind
from service.executor.linux import be_first_out_of_memory, let_others_go_first, limit_memory


@dataclass(frozen=True)
class WorkerSetup:
    """What a worker needs to become ready.

    Attributes:
        preload: modules to import that the process it was forked from does not have.
        warm_up: called once.
        max_bytes: of address space; None for no limit.
    """

    preload: tuple[str, ...]
    warm_up: Callable[[], object] | None
    max_bytes: int | None


def make_cell() -> tuple[int, ctypes.c_uint64]:
    """A new cancel cell, holding the number of the job to stop, and its file descriptor."""
    fd = os.memfd_create("cancel-cell")
    os.ftruncate(fd, ctypes.sizeof(ctypes.c_uint64))
    return fd, open_cell(fd)


def open_cell(fd: int) -> ctypes.c_uint64:
    """The cancel cell behind a file descriptor, shared with whoever has it."""
    return ctypes.c_uint64.from_buffer(mmap.mmap(fd, ctypes.sizeof(ctypes.c_uint64)))


class Cell(Protocol):
    """Holds the number of the job to stop."""

    value: int


class JobControl:
    """``Control`` of one job."""

    def __init__(
        self,
        job: int,
        cell: Cell | ctypes.c_uint64,
        send: Callable[[Kind, int, bytes], None],
        caller_is_ahead_s: float = 0.0,
    ) -> None:
        self._job = job
        self._cell = cell
        self._send = send
        self._caller_is_ahead_s = caller_is_ahead_s  # 0 on one machine: its processes share the clock

    def should_stop(self) -> bool:
        """Whether the pool wants the job to end."""
        return self._cell.value == self._job

    def report(self, event: Any) -> None:
        """Send an event."""
        self._send(Kind.EVENT, self._job, pickle.dumps(event, pickle.HIGHEST_PROTOCOL))

    def now(self) -> float:
        """The caller's time."""
        return time.monotonic() + self._caller_is_ahead_s


class Worker:
    """One worker."""

    def __init__(self, sock: socket.socket, cell: ctypes.c_uint64) -> None:
        self._channel = Channel(sock)
        self._cell = cell
        self._sending = threading.Lock()  # a function may report from threads of its own

    def work(self) -> None:
        """Serve until the pool is gone."""
        faulthandler.enable()  # a crash tells where, on standard error
        be_first_out_of_memory()
        let_others_go_first()
        self._send(Kind.BORN, 0, str(os.getpid()).encode())
        setup = self._channel.receive()
        if setup is None or not self._become_ready(setup.payload):
            return
        while (frame := self._channel.receive()) is not None:
            control = JobControl(frame.job, self._cell, self._send)
            kind, answer = run_call(frame.payload, control)
            self._send(kind, frame.job, answer)

    def _become_ready(self, payload: bytes) -> bool:
        try:
            setup: WorkerSetup = pickle.loads(payload)
            limit_memory(setup.max_bytes)
            for name in setup.preload:
                importlib.import_module(name)
            if setup.warm_up is not None:
                setup.warm_up()
            gc.collect()
            gc.freeze()  # what every job needs is no garbage: a full collection of it would take as long as a job
        except BaseException:
            self._send(Kind.UNREADY, 0, traceback.format_exc().encode())
            return False
        self._send(Kind.READY, 0, b"")
        return True

    def _send(self, kind: Kind, job: int, payload: bytes) -> None:
        with self._sending:
            self._channel.send(kind, job, payload)


def run_call(payload: bytes | bytearray, control: JobControl) -> tuple[Kind, bytes]:
    """Run a pickled call; ``RETURNED`` and its pickled result, or ``RAISED`` and its exception as ``carried``."""
    try:
        fn, args, kwargs = pickle.loads(payload)
        del payload
        if _takes_control(fn):
            kwargs["control"] = control
        return Kind.RETURNED, _pickled(fn(*args, **kwargs))
    except BaseException as error:
        return Kind.RAISED, carried(error)
    finally:
        _flush()


def carried(error: BaseException) -> bytes:
    """An exception as a pickle of (exception, None where it cannot be carried; what it says; its traceback)."""
    trace = "".join(traceback.format_exception(error))
    said = "".join(traceback.format_exception_only(error)).strip()
    if isinstance(error, Exception):
        try:
            payload = pickle.dumps((error.with_traceback(None), said, trace))
            pickle.loads(payload)  # many an exception with arguments of its own can be written but not read
        except Exception:
            pass
        else:
            return payload
    return pickle.dumps((None, said, trace))


def _pickled(result: object) -> bytes:
    try:
        return pickle.dumps(result, pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        kind = type(result).__qualname__
        raise JobFailed(f"returned what cannot be carried between processes, a {kind}: {error}") from error


@lru_cache(maxsize=256)
def _takes_control(fn: Callable[..., object]) -> bool:
    try:
        return "control" in inspect.signature(fn).parameters
    except (TypeError, ValueError):  # builtins without a signature
        return False


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
