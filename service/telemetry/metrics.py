"""Prometheus metrics of a server: requests, plans and their phases, workers, stores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Self

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, start_http_server
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from service.errors import shown
from service.executor import PoolStats
from service.store import CloudStore, Store
from service.telemetry.errors import TelemetryError
from service.telemetry.plan_counts import sum_phases
from service.trust import is_loopback

_RPC_BUCKETS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60, 120, 300)
_PHASE_BUCKETS = (0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2, 4, 8, 15, 30, 60, 120, 300)


ALERT_CODES = ("INTERNAL", "UNKNOWN", "DATA_LOSS")  # of requests, on whose first one an alert fires


class Metrics:
    """A server's metrics, in a registry of their own."""

    def __init__(self, methods: Sequence[str] = ()) -> None:
        """Make the metrics.

        Args:
            methods: of the service, whose errors are counted from 0: an alert on ``increase`` sees nothing in the first
                sample of a series.
        """
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        self._requests = Counter("scopt_requests", "RPCs that ended.", ["method", "code"], registry=registry)
        self._seconds = Histogram(
            "scopt_request_seconds",
            "How long RPCs took, streams to their end.",
            ["method"],
            buckets=_RPC_BUCKETS,
            registry=registry,
        )
        self._open = Gauge("scopt_requests_open", "RPCs being answered.", ["method"], registry=registry)
        self._phases = Histogram(
            "scopt_plan_phase_seconds",
            "How long the phases of finished plans took; queue: before a worker had time.",
            ["kind", "phase"],
            buckets=_PHASE_BUCKETS,
            registry=registry,
        )
        self._verdicts = Counter("scopt_verdicts", "Plans that finished.", ["kind", "verdict"], registry=registry)
        self._upload_bytes = Counter("scopt_upload_bytes", "Bytes of clouds that came in.", registry=registry)
        for method in methods:
            for code in ALERT_CODES:
                self._requests.labels(method, code)

    def request_began(self, method: str) -> None:
        """Count the begin of an RPC."""
        self._open.labels(method).inc()

    def request_ended(self, method: str, code: str, seconds: float) -> None:
        """Count the end of an RPC."""
        self._open.labels(method).dec()
        self._requests.labels(method, code).inc()
        self._seconds.labels(method).observe(seconds)

    def plan_finished(self, kind: str, verdict: str, timings: Mapping[str, float]) -> None:
        """Count a finished plan.

        Args:
            kind: kind of request.
            verdict: the plan's verdict.
            timings: seconds by step of the planner, with ``total`` and ``queue`` where known.
        """
        self._verdicts.labels(kind, verdict).inc()
        for phase, seconds in sum_phases(timings).items():
            self._phases.labels(kind, phase).observe(seconds)

    def upload_finished(self, n_bytes: int) -> None:
        """Count the bytes of an uploaded cloud."""
        self._upload_bytes.inc(n_bytes)

    def watch(self, *, pool: Callable[[], PoolStats], store: Store, clouds: CloudStore) -> None:
        """Read workers and stores at every scrape."""
        self.registry.register(_StateCollector(pool, store, clouds))


class MetricsServer:
    """Server of metrics at ``http://HOST:PORT/metrics``, which asks nobody who they are.

    Args:
        address: ``HOST:PORT``; port 0 takes a free one.
        is_remote: whether the address may be one that other machines can reach.

    Raises:
        TelemetryError: other machines could reach the address and may not, or it is in use.
    """

    def __init__(self, address: str, registry: CollectorRegistry, is_remote: bool = False) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise TelemetryError(f"--metrics {shown(address)}: expected HOST:PORT, such as 127.0.0.1:9464")
        if not is_remote and not is_loopback(host):
            raise TelemetryError(
                f"--metrics {shown(address)}: can be reached from other machines, and metrics need no token; "
                "expected this machine, such as 127.0.0.1:9464, or --remote-metrics"
            )
        try:
            self._server, self._thread = start_http_server(int(port), host.strip("[]"), registry)
        except OSError as error:
            raise TelemetryError(f"--metrics {address}: cannot listen there ({error.strerror})") from None
        self.address = f"{host}:{self._server.server_port}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _StateCollector(Collector):
    """Metrics read from workers and stores at every scrape."""

    def __init__(self, pool: Callable[[], PoolStats], store: Store, clouds: CloudStore) -> None:
        self._pool, self._store, self._clouds = pool, store, clouds

    def describe(self) -> Iterable[Metric]:
        return ()  # registration must not read the state

    def collect(self) -> Iterator[Metric]:
        yield from _collect_pool(self._pool())
        store, clouds = self._store.stats(), self._clouds.stats()
        kept = GaugeMetricFamily("scopt_store_entries", "Stored entries.", labels=["what"])
        n_bytes = GaugeMetricFamily("scopt_store_bytes", "Bytes of stored entries.", labels=["what"])
        for what, n, size in (
            ("plans", store.n_plans, store.plan_bytes),
            ("scenes", store.n_scenes, store.scene_bytes),
            ("clouds", clouds.n_clouds, clouds.n_bytes),
        ):
            kept.add_metric([what], n)
            n_bytes.add_metric([what], size)
        yield from (kept, n_bytes)
        yield GaugeMetricFamily("scopt_uploads_open", "Clouds on their way in.", value=clouds.n_uploads)


def _collect_pool(pool: PoolStats) -> Iterator[Metric]:
    yield GaugeMetricFamily("scopt_queue_length", "Jobs that wait for a worker.", value=pool.queued)
    yield GaugeMetricFamily("scopt_jobs_running", "Jobs that workers are at.", value=pool.running)
    yield CounterMetricFamily("scopt_worker_restarts", "Workers that were replaced.", value=pool.restarts)
    workers = GaugeMetricFamily("scopt_workers", "Workers by state.", labels=["state"])
    states = [worker.state.value for worker in pool.workers]
    for state in sorted(set(states)):
        workers.add_metric([state], states.count(state))
    yield workers
    memory = GaugeMetricFamily("scopt_worker_rss_bytes", "Resident memory of a worker.", labels=["worker"])
    for number, worker in enumerate(pool.workers):  # by position, since a pid would make a new series at a restart
        memory.add_metric([str(number)], worker.rss_bytes)
    yield memory
