"""An executor whose workers are actors of a Ray cluster; ``pip install scopt[ray]``, here and on all its machines."""

from __future__ import annotations

import asyncio
import os
import pickle
import threading
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from service.executor import linux
from service.executor.channel import Kind
from service.executor.job import LOG, JobRecord
from service.executor.job_queue import JobQueue
from service.executor.pool import Pool
from service.executor.supervisor import PoolSettings, Supervisor
from service.executor.worker import JobControl, SharedFlags, WorkerSetup, run_call
from service.executor.worker_handle import WorkerHandle, WorkerState

_END_TIMEOUT_S = 5.0
N_THREADS = 8  # one for the job, one for wait_for_end, some for calls that must wait for neither


class RayPool(Pool):
    """Actors of one CPU each, supervised as local workers are.

    The functions they run are looked up by name in modules, which the cluster's machines must have. A job is stopped by
    a call to its actor, which is killed if the job does not stop. A dead actor is replaced and its job started again.
    """

    def __init__(
        self,
        address: str,
        workers: int,
        *,
        warm_up: Callable[[], object] | None = None,
        preload: tuple[str, ...] = (),
        grace_s: float = 0.25,
        max_bytes: int | None = None,
        recycle_after: int | None = None,
        start_timeout_s: float = 120.0,
    ) -> None:
        """Connect to a cluster, unless this process is connected, and start actors; ``wait_ready`` waits for them.

        Args:
            address: ``ray://HOST:PORT`` of a cluster's client server, or any address that ``ray.init`` takes.
            workers: how many actors; more than the cluster has CPUs start when there are more.
            warm_up: top-level function, called once in each actor before it takes jobs.
            preload: modules that each actor imports before that.
            grace_s: from asking a job to stop to killing its actor [s].
            max_bytes: address space of an actor beyond what Ray has taken there; None for no limit.
            recycle_after: jobs after which an actor is replaced; None for never.
            start_timeout_s: in which an actor becomes ready [s].

        Raises:
            ImportError: Ray is not installed.
            ConnectionError: there is no cluster at the address.
        """
        settings = PoolSettings(workers, warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s)
        jobs = JobQueue()
        super().__init__(jobs, _RaySupervisor(address, settings, jobs))


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes:
        kind: ``RETURNED`` or ``RAISED``.
        payload: as ``worker.run_call`` returns it.
        rss_bytes: the worker's resident memory after it.
    """

    kind: Kind
    payload: bytes
    rss_bytes: int


class RayWorker:
    """An actor whose calls run in threads: one for jobs and some for calls that must not wait for them."""

    def __init__(self, setup: bytes) -> None:
        worker: WorkerSetup = pickle.loads(setup)
        # Ray's own memory, such as the objects that all processes of a machine share, does not count.
        worker.apply(taken_bytes=linux.address_space_bytes())
        self._flags = SharedFlags()
        self._changed = threading.Condition()
        self._run = 0
        self._is_over = True
        self._events: list[bytes] = []
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
            self._run, self._is_over, self._wants_events, self._events = run, False, wants_events, []
            self._changed.notify_all()
        try:
            kind, result = run_call(payload, JobControl(run, self._flags, self._report, clock_offset_s))
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()
        return RunResult(kind, result, linux.rss_bytes(os.getpid()))

    def stop(self, run: int) -> None:
        """Ask a run to stop."""
        self._flags.cancelled = run

    def wait_for_events(self, run: int) -> tuple[list[bytes], bool]:
        """Return a run's new events and whether these were the last, as soon as there are any or the run is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._run > run or (self._run == run and (self._is_over or self._events)))
            if self._run != run:
                return [], True
            events, self._events = self._events, []
            return events, self._is_over

    def _report(self, kind: Kind, run: int, payload: bytes) -> None:
        with self._changed:
            if run == self._run and self._wants_events and not self._is_over:
                self._events.append(payload)
                self._changed.notify_all()


class _Actor(WorkerHandle):
    """The pool's view of one actor.

    Attributes:
        handle: Ray's handle of it.
        run: number of its latest run; counts the runs of the pool.
    """

    def __init__(self, number: int, handle: Any) -> None:
        super().__init__(number)
        self.handle = handle
        self.run = 0
        self.last_rss_bytes = 0

    @property
    def rss_bytes(self) -> int:
        """Resident memory after its last job; 0 before."""
        return self.last_rss_bytes

    def request_stop(self, record: JobRecord) -> None:
        """Have ``should_stop`` of its job return True."""
        self.handle.stop.remote(self.run)


class _RaySupervisor(Supervisor[_Actor]):
    """Starts actors, calls them, and waits for their answers in coroutines."""

    def __init__(self, address: str, settings: PoolSettings, jobs: JobQueue) -> None:
        import ray  # workers and clients of other pools need not have it

        disconnects = not ray.is_initialized()
        if disconnects:
            ray.init(address=address, log_to_driver=False)
        super().__init__("scopt-ray-pool", settings, jobs)
        self._ray, self._disconnects = ray, disconnects
        self._class = ray.remote(num_cpus=1, max_restarts=0, max_concurrency=N_THREADS)(RayWorker)
        self._setup = pickle.dumps(WorkerSetup(settings.preload, settings.warm_up, settings.max_bytes))
        self._n_runs = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._thread.start()

    def _close_workers(self) -> None:
        for actor in self.workers:
            self._end_worker(actor)
        if self._disconnects:
            self._ray.shutdown()
        if self._tasks:  # their calls fail now
            self._loop.run_until_complete(asyncio.wait(self._tasks, timeout=_END_TIMEOUT_S))

    def _start_task(self, actor: _Actor, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine that calls an actor; of several that fail when the actor ends, the first one counts."""

        async def run() -> None:
            try:
                await work
            except Exception as error:
                self._on_ended(actor, str(error).strip())

        task = self._loop.create_task(run())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # Actors.

    def _adjust_workers(self) -> None:
        limit = self._settings.recycle_after
        idle = [actor for actor in self.workers if actor.state is not WorkerState.BUSY]
        surplus = idle[: max(0, len(self.workers) - self.target)]
        surplus += [a for a in idle if limit is not None and a.jobs_done >= limit and a not in surplus]
        for actor in surplus:
            self._end_worker(actor)
        if self._may_start:
            for _ in range(self.target - len(self.workers)):
                self._start_actor()

    def _start_actor(self) -> None:
        self._n_started += 1
        actor = _Actor(self._n_started, self._class.remote(self._setup))
        self._note_started(actor)
        self._start_task(actor, self._wait_until_up(actor))
        self._start_task(actor, _wait_for(actor.handle.wait_for_end.remote()))

    async def _wait_until_up(self, actor: _Actor) -> None:
        actor.pid = await _wait_for(actor.handle.report_pid.remote())
        if actor in self.workers:
            self._note_up(actor)

    def _on_ended(self, actor: _Actor, error: str) -> None:
        if actor in self.workers:
            self._end_worker(actor)
            self._note_death(actor, "lost", error, error[-1000:])

    def _end_worker(self, actor: _Actor) -> None:
        self._limit(actor, None)
        self.workers = tuple(other for other in self.workers if other is not actor)
        try:
            self._ray.kill(actor.handle)
        except Exception as error:  # without a connection it ends with its cluster, or when that misses this pool
            LOG.warning("worker %d (pid %s) could not be killed: %s", actor.number, actor.pid, error)

    def _should_end(self, actor: _Actor) -> bool:
        limit = self._settings.recycle_after
        return super()._should_end(actor) or (limit is not None and actor.jobs_done >= limit)

    def _describe_timeout(self, actor: _Actor) -> str:
        return f"{super()._describe_timeout(actor)}; has Ray a free CPU?"

    # Jobs.

    def _send_job(self, actor: _Actor, record: JobRecord) -> None:
        self._n_runs += 1
        actor.run = self._n_runs
        self._start_task(actor, self._run_job(actor, record))

    async def _run_job(self, actor: _Actor, record: JobRecord) -> None:
        run = actor.run
        wants_events = is_open = record.on_event is not None
        reference = actor.handle.run.remote(run, record.payload, wants_events, time.monotonic())
        while is_open:
            events, is_last = await _wait_for(actor.handle.wait_for_events.remote(run))
            is_open = not is_last and actor.record is record
            for event in events if actor.record is record else ():
                record.deliver_event(event)
        result: RunResult = await _wait_for(reference)
        if actor.record is record:
            actor.last_rss_bytes = result.rss_bytes
            self._finish_job(actor, result.kind is Kind.RETURNED, result.payload)


async def _wait_for(reference: Any) -> Any:
    """Return what a call to an actor returns, or raise what it raises."""
    return await asyncio.wrap_future(reference.future())
