"""The worker's side of a Ray pool: an actor that runs calls. Importable without Ray."""

from __future__ import annotations

import os
import pickle
import threading
import time
from dataclasses import dataclass

from service.executor import linux
from service.executor.messages import Kind
from service.executor.worker import JobControl, WorkerSetup, run_call

N_THREADS = 8  # one for the job, one for wait_for_end, some for calls that must wait for neither


@dataclass
class _CancelFlag:
    """The number of the run that shall stop."""

    value: int = 0


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes:
        kind: ``RETURNED`` or ``RAISED``.
        payload: as ``worker.run_call`` returns it.
        n_events: how many events were reported.
        rss_bytes: the worker's resident memory after it.
    """

    kind: Kind
    payload: bytes
    n_events: int
    rss_bytes: int


class RayWorker:
    """An actor whose calls run in threads: one for jobs and some for calls that must not wait for them."""

    def __init__(self, setup: bytes) -> None:
        worker: WorkerSetup = pickle.loads(setup)
        # Ray's own memory, such as the objects that all processes of a machine share, does not count.
        worker.apply(taken_bytes=linux.address_space_bytes())
        self._cancel_flag = _CancelFlag()
        self._changed = threading.Condition()
        self._run = 0
        self._is_over = True
        self._events: list[bytes] = []
        self._n_events = 0
        self._wants_events = True

    def report_pid(self) -> int:
        """Return the process id, once the worker is ready."""
        return os.getpid()

    def wait_for_end(self) -> None:
        """Never return: this call fails when the actor ends."""
        threading.Event().wait()

    def run(self, run: int, payload: bytes, wants_events: bool, now: float) -> RunResult:
        """Run a pickled call; ``run`` is higher each time, ``now`` is the caller's time [s]."""
        clock_offset_s = now - time.monotonic()
        with self._changed:
            self._run, self._is_over, self._wants_events = run, False, wants_events
            self._events, self._n_events = [], 0
            self._changed.notify_all()
        try:
            kind, result = run_call(payload, JobControl(run, self._cancel_flag, self._report, clock_offset_s))
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()
        return RunResult(kind, result, self._n_events, linux.rss_bytes(os.getpid()))

    def stop(self, run: int) -> None:
        """Ask a run to stop."""
        self._cancel_flag.value = run

    def wait_for_events(self, run: int, n_seen: int) -> list[bytes]:
        """Return a run's events after the first ``n_seen``, as soon as there are any or the run is over."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._run > run or (self._run == run and (self._is_over or self._n_events > n_seen))
            )
            if self._run != run:
                return []
            del self._events[: len(self._events) - (self._n_events - n_seen)]  # these have arrived
            return list(self._events)

    def _report(self, kind: Kind, run: int, payload: bytes) -> None:
        with self._changed:
            if run == self._run and self._wants_events and not self._is_over:
                self._events.append(payload)
                self._n_events += 1
                self._changed.notify_all()
