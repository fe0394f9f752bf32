"""An executor whose workers are actors of a Ray cluster; ``pip install scopt[ray]``, here and on all its machines."""

from __future__ import annotations

import pickle
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

try:
    import ray
except ImportError as missing:
    raise ImportError(f"a Ray cluster needs the package ray: pip install 'scopt[ray]' ({missing})") from missing

from service.executor.interface import WorkerState
from service.executor.job_queue import LOG, JobQueue, JobRecord
from service.executor.messages import Kind
from service.executor.pool import Pool, check_callable, check_workers
from service.executor.ray_worker import N_THREADS, RayWorker, RunResult
from service.executor.supervisor import PoolSettings, Supervisor, WorkerHandle
from service.executor.worker import WorkerSetup


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
            ConnectionError: there is no cluster at the address.
        """
        check_workers(workers)
        check_callable(warm_up)
        connects = not ray.is_initialized()
        if connects:
            ray.init(address=address, log_to_driver=False)
        settings = PoolSettings(warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s)
        jobs = JobQueue()
        super().__init__(jobs, _RaySupervisor(workers, settings, jobs, disconnects=connects))


class _Actor(WorkerHandle):
    """The pool's view of one actor.

    Attributes:
        handle: Ray's handle of it.
        run: number of its latest run; counts the runs of the pool.
        n_seen: how many events of the run were delivered.
        result: the run's, while events have not arrived yet.
    """

    def __init__(self, number: int, handle: Any) -> None:
        super().__init__(number)
        self.handle = handle
        self.run = 0
        self.n_seen = 0
        self.result: RunResult | None = None
        self.last_rss_bytes = 0

    @property
    def rss_bytes(self) -> int:
        """Resident memory after its last job; 0 before."""
        return self.last_rss_bytes

    def request_stop(self, record: JobRecord) -> None:
        """Have ``should_stop`` of its job return True."""
        self.handle.stop.remote(self.run)


class _RaySupervisor(Supervisor[_Actor]):
    """The thread that starts actors and calls them; their replies come to it through a queue."""

    def __init__(self, target: int, settings: PoolSettings, jobs: JobQueue, *, disconnects: bool) -> None:
        super().__init__("scopt-ray-pool", target, settings, jobs)
        self._disconnects = disconnects
        as_actor = ray.remote(num_cpus=1, max_restarts=0, max_concurrency=N_THREADS)
        self._class = as_actor(RayWorker)
        self._setup = pickle.dumps(WorkerSetup(settings.preload, settings.warm_up, settings.max_bytes))
        self._replies: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._n_runs = 0
        self._thread.start()

    def wake(self) -> bool:
        self._replies.put(lambda: None)
        return not self._is_over

    def _wait_for_events(self, timeout_s: float | None) -> None:
        with suppress(queue.Empty):
            handle_reply = self._replies.get(timeout=timeout_s)
            handle_reply()

    def _close_workers(self) -> None:
        self._is_over = True
        for actor in self.workers:
            self._end_worker(actor)
        if self._disconnects:
            ray.shutdown()

    # Actors.

    def _adjust_workers(self, now: float) -> None:
        limit = self._settings.recycle_after
        idle = [actor for actor in self.workers if actor.state is not WorkerState.BUSY]
        surplus = idle[: max(0, len(self.workers) - self.target)]
        surplus += [a for a in idle if limit is not None and a.jobs_done >= limit and a not in surplus]
        for actor in surplus:
            self._end_worker(actor)
        if not self._backoff.is_waiting:
            for _ in range(self.target - len(self.workers)):
                self._start_actor()

    def _start_actor(self) -> None:
        self._n_started += 1
        actor = _Actor(self._n_started, self._class.remote(self._setup))
        self.workers = (*self.workers, actor)
        self._on_reply(actor.handle.report_pid.remote(), lambda f: self._on_started(actor, f))
        self._on_reply(actor.handle.wait_for_end.remote(), lambda f: self._on_ended(actor, f))

    def _on_reply(self, reference: Any, handle: Callable[[Future[Any]], None]) -> None:
        """Have this thread call a function once a call to an actor has returned or failed."""
        reference.future().add_done_callback(lambda future: self._replies.put(lambda: handle(future)))

    def _on_started(self, actor: _Actor, future: Future[int]) -> None:
        if future.exception() is not None:
            self._on_ended(actor, future)
        elif actor in self.workers:
            actor.pid = future.result()
            self._note_up(actor)

    def _on_ended(self, actor: _Actor, future: Future[Any]) -> None:
        """Remove an actor that has ended; several calls to it fail then, and the first one counts."""
        if actor not in self.workers:
            return
        self._end_worker(actor)
        error = str(future.exception()).strip()
        self._note_death(actor, "lost", error, error[-1000:])

    def _end_worker(self, actor: _Actor) -> None:
        self.workers = tuple(other for other in self.workers if other is not actor)
        try:
            ray.kill(actor.handle)
        except Exception as error:  # without a connection it ends with its cluster, or when that misses this pool
            LOG.warning("worker %d (pid %s) could not be killed: %s", actor.number, actor.pid, error)

    def _describe_timeout(self, actor: _Actor) -> str:
        return f"{super()._describe_timeout(actor)}; has Ray a free CPU?"

    # Jobs.

    def _send_job(self, actor: _Actor, record: JobRecord) -> None:
        self._n_runs += 1
        run = actor.run = self._n_runs
        actor.n_seen, actor.result = 0, None
        reference = actor.handle.run.remote(run, record.payload, record.on_event is not None, time.monotonic())
        self._on_reply(reference, lambda future: self._on_result(actor, run, future))
        if record.on_event is not None:
            self._request_events(actor)

    def _request_events(self, actor: _Actor) -> None:
        run = actor.run
        reference = actor.handle.wait_for_events.remote(run, actor.n_seen)
        self._on_reply(reference, lambda future: self._on_events(actor, run, future))

    def _on_events(self, actor: _Actor, run: int, future: Future[list[bytes]]) -> None:
        if future.exception() is not None:
            self._on_ended(actor, future)
        elif actor.record is not None and actor.run == run:
            for event in future.result():
                actor.n_seen += 1
                self._results.deliver_event(actor.record, event)
            if actor.result is None or actor.n_seen < actor.result.n_events:
                self._request_events(actor)
            else:
                self._finish_run(actor, actor.record, actor.result)

    def _on_result(self, actor: _Actor, run: int, future: Future[RunResult]) -> None:
        if future.exception() is not None:
            self._on_ended(actor, future)
        elif actor.record is not None and actor.run == run:
            result = future.result()
            if actor.n_seen < result.n_events:
                actor.result = result  # the remaining events come first
            else:
                self._finish_run(actor, actor.record, result)

    def _finish_run(self, actor: _Actor, record: JobRecord, result: RunResult) -> None:
        actor.result, actor.last_rss_bytes = None, result.rss_bytes
        self._finish_job(actor, record, result.kind is Kind.RETURNED, result.payload)
