"""The worker process's side of a pool: prepares itself, then runs one call after the other until the pool ends."""

from __future__ import annotations

import _thread
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
from typing import Any

from service.executor import linux
from service.executor.channel import BlockingChannel, Kind
from service.executor.job import JobFailed

BEAT_EVERY_S = 0.2


@dataclass(frozen=True)
class WorkerSetup:
    """Settings that a worker needs before its first job.

    Attributes:
        preload: modules to import that the process it was forked from does not have.
        warm_up: called once.
        max_bytes: of address space; None for no limit.
    """

    preload: tuple[str, ...]
    warm_up: Callable[[], object] | None
    max_bytes: int | None

    def apply(self, taken_bytes: int = 0) -> None:
        """Bound this process's memory to ``max_bytes`` beyond ``taken_bytes``, import the modules, warm up."""
        linux.limit_memory(None if self.max_bytes is None else taken_bytes + self.max_bytes)
        for name in self.preload:
            importlib.import_module(name)
        if self.warm_up is not None:
            self.warm_up()


class SharedFlags(ctypes.Structure):
    """Memory that the pool may share with a worker; ``open`` maps it.

    Attributes:
        cancelled: number of the job that shall stop; 0 while there is none.
        beats: counts up every ``BEAT_EVERY_S`` while the worker's Python runs.
    """

    cancelled: int
    beats: int
    _fields_ = (("cancelled", ctypes.c_uint64), ("beats", ctypes.c_uint64))

    @classmethod
    def create(cls) -> tuple[int, SharedFlags]:
        """Return the file descriptor of new flags, and the flags."""
        fd = os.memfd_create("worker-flags")
        os.ftruncate(fd, ctypes.sizeof(cls))
        return fd, cls.open(fd)

    @classmethod
    def open(cls, fd: int) -> SharedFlags:
        """Map the flags behind a file descriptor, which all processes that have the descriptor share."""
        return cls.from_buffer(mmap.mmap(fd, ctypes.sizeof(cls)))


class JobControl:
    """The ``Control`` that a function gets in a worker."""

    def __init__(
        self,
        job: int,
        flags: SharedFlags,
        send: Callable[[Kind, int, bytes], None],
        clock_offset_s: float = 0.0,
    ) -> None:
        self._job = job
        self._flags = flags
        self._send = send
        self._clock_offset_s = clock_offset_s  # 0 on one machine, whose processes share the clock

    def should_stop(self) -> bool:
        """Whether the pool wants the job to stop."""
        return self._flags.cancelled == self._job

    def report(self, event: Any) -> None:
        """Send an event."""
        self._send(Kind.EVENT, self._job, pickle.dumps(event, pickle.HIGHEST_PROTOCOL))

    def now(self) -> float:
        """Return the time on the caller's clock."""
        return time.monotonic() + self._clock_offset_s


class Worker:
    """Runs the calls that arrive on a socket and sends back their events and results."""

    def __init__(self, sock: socket.socket, flags: SharedFlags) -> None:
        self._channel = BlockingChannel(sock)
        self._flags = flags
        self._sending = threading.Lock()  # a function may report from threads of its own

    def run(self) -> None:
        """Run calls until the pool closes the socket."""
        faulthandler.enable()  # a crash prints its stack on standard error
        linux.raise_oom_score()
        linux.lower_priority()
        _thread.start_new_thread(self._beat, ())  # no `threading.Thread`: functions see only threads of their own
        self._send(Kind.STARTED, 0, str(os.getpid()).encode())
        setup = self._channel.receive()
        if setup is None or not self._set_up(setup.payload):
            return
        while (message := self._channel.receive()) is not None:
            control = JobControl(message.job, self._flags, self._send)
            kind, payload = run_call(message.payload, control)
            self._send(kind, message.job, payload)

    def _set_up(self, payload: bytes) -> bool:
        try:
            setup: WorkerSetup = pickle.loads(payload)
            setup.apply()
            gc.collect()
            gc.freeze()  # what every job needs is no garbage: a full collection of it takes as long as a job
        except BaseException:
            self._send(Kind.START_FAILED, 0, traceback.format_exc().encode())
            return False
        self._send(Kind.READY, 0, b"")
        return True

    def _beat(self) -> None:
        while True:
            self._flags.beats += 1
            time.sleep(BEAT_EVERY_S)

    def _send(self, kind: Kind, job: int, payload: bytes) -> None:
        with self._sending:
            self._channel.send(kind, job, payload)


def run_call(payload: bytes | bytearray, control: JobControl) -> tuple[Kind, bytes]:
    """Run a pickled call; return ``RETURNED`` and its pickled result, or ``RAISED`` and its pickled exception."""
    try:
        fn, args, kwargs = pickle.loads(payload)
        del payload
        if _takes_control(fn):
            kwargs["control"] = control
        return Kind.RETURNED, _pickle_result(fn(*args, **kwargs))
    except BaseException as error:
        return Kind.RAISED, pickle_exception(error)
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()


def pickle_exception(error: BaseException) -> bytes:
    """Pickle (exception, or None where it cannot be pickled; its summary line; its traceback)."""
    trace = "".join(traceback.format_exception(error))
    summary = "".join(traceback.format_exception_only(error)).strip()
    if isinstance(error, Exception):
        try:
            payload = pickle.dumps((error.with_traceback(None), summary, trace))
            pickle.loads(payload)  # an exception whose constructor takes other arguments can be written but not read
        except Exception:
            pass
        else:
            return payload
    return pickle.dumps((None, summary, trace))


def _pickle_result(result: object) -> bytes:
    try:
        return pickle.dumps(result, pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        kind = type(result).__qualname__
        raise JobFailed(f"returned what cannot be pickled, a {kind}: {error}") from error


@lru_cache(maxsize=256)
def _takes_control(fn: Callable[..., object]) -> bool:
    try:
        return "control" in inspect.signature(fn).parameters
    except (TypeError, ValueError):  # builtins without a signature
        return False
