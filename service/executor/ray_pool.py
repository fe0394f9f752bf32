"""An executor of actors on a Ray cluster; ``pip install scopt[ray]``, here and on all machines of the cluster."""

from __future__ import annotations

from collections.abc import Callable

try:
    import ray
except ImportError as missing:
    raise ImportError(f"a Ray cluster needs the package ray: pip install 'scopt[ray]' ({missing})") from missing

from service.executor.backlog import Backlog
from service.executor.interface import WorkerStats
from service.executor.pool import Pool, check_callable, check_workers
from service.executor.ray_supervisor import RaySupervisor
from service.executor.settings import Settings


class RayPool(Pool):
    """Actors of one CPU each, looked after as local workers are.

    The functions they run are looked up by name in modules, which the cluster's machines must have. A job is stopped by
    a call to its actor, and the actor killed if that does not help; one that dies is replaced and its job begun again.
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
        """Connect to a cluster, unless this process is connected, and ask for actors; ``wait_ready`` waits for them.

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
        settings = Settings(warm_up, tuple(preload), grace_s, max_bytes, recycle_after, start_timeout_s)
        backlog = Backlog()
        self._ray = RaySupervisor(workers, settings, backlog, disconnects=connects)
        super().__init__(backlog, self._ray)

    def _workers(self) -> tuple[WorkerStats, ...]:
        return tuple(WorkerStats(a.pid, a.state, a.jobs_done, a.rss_bytes) for a in list(self._ray.actors))
