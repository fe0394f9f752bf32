"""What an actor of a Ray cluster does as a worker."""

from __future__ import annotations

import importlib
import os
import pickle
import threading
import time
from dataclasses import dataclass

from service.executor import linux
from service.executor.frames import Kind
from service.executor.worker import JobControl, WorkerSetup, run_call

N_THREADS = 8  # one for the job, one to hold, some for what must wait for neither


@dataclass
class _Cell:
    """The number of the run to stop."""

    value: int = 0


@dataclass(frozen=True)
class Answer:
    """How a run ended.

    Attributes:
        kind: ``RETURNED`` or ``RAISED``.
        payload: as ``worker.run_call`` writes it.
        n_events: how many were reported.
        rss_bytes: the worker's resident memory after it.
    """

    kind: Kind
    payload: bytes
    n_events: int
    rss_bytes: int


class RayWorker:
    """An actor; its calls run in threads, one for jobs and some for what must not wait for them."""

    def __init__(self, setup: bytes) -> None:
        worker: WorkerSetup = pickle.loads(setup)
        # Ray's own, such as the objects that all processes of a machine share, is no fault of a job's.
        taken = linux.address_space_bytes()
        linux.limit_memory(None if worker.max_bytes is None else taken + worker.max_bytes)
        for name in worker.preload:
            importlib.import_module(name)
        if worker.warm_up is not None:
            worker.warm_up()
        self._cell = _Cell()
        self._changed = threading.Condition()
        self._run = 0
        self._is_over = True
        self._events: list[bytes] = []
        self._n_events = 0
        self._wants_events = True

    def born(self) -> int:
        """Its process id, once it is ready."""
        return os.getpid()

    def hold(self) -> None:
        """Come back never: what waits for this learns when the actor ends."""
        threading.Event().wait()

    def run(self, run: int, payload: bytes, wants_events: bool, now: float) -> Answer:
        """Run a pickled call; ``run`` is higher each time, ``now`` the caller's time [s]."""
        ahead_s = now - time.monotonic()
        with self._changed:
            self._run, self._is_over, self._wants_events = run, False, wants_events
            self._events, self._n_events = [], 0
            self._changed.notify_all()
        try:
            kind, answer = run_call(payload, JobControl(run, self._cell, self._report, ahead_s))
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()
        return Answer(kind, answer, self._n_events, linux.rss_bytes(os.getpid()))

    def stop(self, run: int) -> None:
        """Ask a run to stop."""
        self._cell.value = run

    def events(self, run: int, seen: int) -> list[bytes]:
        """What a run has reported after the first ``seen``, as soon as there is any or it is over."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._run > run or (self._run == run and (self._is_over or self._n_events > seen))
            )
            if self._run != run:
                return []
            del self._events[: len(self._events) - (self._n_events - seen)]  # these have arrived
            return list(self._events)

    def _report(self, kind: Kind, run: int, payload: bytes) -> None:
        with self._changed:
            if run == self._run and self._wants_events and not self._is_over:
                self._events.append(payload)
                self._n_events += 1
                self._changed.notify_all()
