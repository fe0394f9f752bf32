"""An executor of worker processes on this machine."""

from __future__ import annotations

from collections.abc import Callable

from service.executor import linux
from service.executor.backlog import Backlog
from service.executor.interface import WorkerStats
from service.executor.pool import Pool, check_callable, check_workers
from service.executor.settings import Settings
from service.executor.supervisor import Supervisor


class LocalPool(Pool):
    """Long-lived worker processes, forked from one that has imported what they need.

    The workers, and whatever they start, end with this process, however it ends. The functions they run are looked up
    by name in modules; the main script is not imported again, so its own functions cannot be run.
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
        """
        check_workers(workers)
        check_callable(warm_up)
        settings = Settings(warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s)
        backlog = Backlog()
        self._local = Supervisor(workers, settings, backlog)
        super().__init__(backlog, self._local)

    def _workers(self) -> tuple[WorkerStats, ...]:
        return tuple(
            WorkerStats(w.pid, w.state, w.jobs_done, 0 if w.pid is None else linux.rss_bytes(w.pid))
            for w in self._local.workers
        )
