"""Start of a server, its run until a signal, and its drain."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from logging import ERROR, INFO

import grpc
import structlog
from grpc_health.v1 import health_pb2_grpc
from grpc_health.v1.health import SERVICE_NAME as HEALTH_NAME

from service.errors import ServiceError
from service.executor import Lane, Place, Pool
from service.result.approval import Signer
from service.server.admission import Admission
from service.server.cloud_handlers import CloudHandlers
from service.server.disk import DiskWatch
from service.server.jobs import JobRunner
from service.server.lifecycle import Health, OpenCalls
from service.server.methods import SERVICE, Servicer, make_handlers
from service.server.operation.executions import ExecutionHandlers, RobotSettings
from service.server.operation.lists import ListHandlers
from service.server.operation.pose_handler import PoseHandler
from service.server.plan_handler import PlanHandler
from service.server.query_handlers import QueryHandlers
from service.server.refusals import GOING_DOWN, STOPPING
from service.server.requests import RequestReader
from service.server.robots import KnownRobots, RobotFolder
from service.server.settings import MAX_STREAMS, ServerSettings
from service.server.uploads import UploadHandler
from service.store import CloudStore, Store
from service.telemetry import Later, Metrics, MetricsServer, PlanCounts, Spans, TelemetryInterceptor
from service.trust import (
    UNIX,
    AccessInterceptor,
    Certificates,
    ClientLimiter,
    TlsFiles,
    Tokens,
    TrustError,
    find_listen_problems,
    resolve_folders,
)
from service.trust.rpc import Interceptor, Refusal
from service.wire.reflection import enable_reflection
from service.work.look import list_names

_LOG = structlog.get_logger("scopt.server")
PRELOAD = (
    "service.work.plan",
    "service.posing.world",
    "service.work.look",
    "perception",
    "service.tasks.valve.plan",
    "service.trajopt",
)
CHECK_JOBS_EVERY_S = 0.5
SWITCH_S = 1e-3  # a thread that reads a large message must yield to the event loop, which answers all calls
SEND_S = 5.0  # for responses that are being sent when all jobs have ended
REFUSE_S = 1.0  # for open calls to end with a refusal
CLOUDS_FOLDER, STORE_FOLDER = "clouds", "plans"


@dataclass(frozen=True)
class Endpoint:
    """Address of a server, and access to it.

    Attributes:
        address: ``HOST:PORT``, ``[IPV6]:PORT`` or ``unix:PATH``; port 0 takes a free one.
        tls: certificate files; None without TLS.
        tokens: known clients; None accepts every client of this machine.
        limiter: limits of each client.
        metrics: address of the metrics; None without.
        is_metrics_remote: whether that address may be one that other machines can reach.
        socket: path of a Unix socket for clients of this machine, without TLS; None without.
        spans: recorder of spans.
        signer: key that signs approvals; None without.
        robot: settings of the robot that plans are carried out on.
    """

    address: str
    tls: TlsFiles | None = None
    tokens: Tokens | None = None
    limiter: ClientLimiter | None = None
    metrics: str | None = None
    is_metrics_remote: bool = False
    socket: str | None = None
    spans: Spans | None = None
    signer: Signer | None = None
    robot: RobotSettings = field(default_factory=RobotSettings)


@dataclass(frozen=True)
class RunningServer:
    """A started server and its parts.

    Attributes:
        address: with the port that was taken.
    """

    address: str
    server: grpc.aio.Server
    plans: PlanHandler
    queries: QueryHandlers
    jobs: JobRunner
    health: Health
    calls: OpenCalls
    certificates: Certificates | None


async def serve(settings: ServerSettings, endpoint: Endpoint, executor: Pool, on_ready: Callable[[str], None]) -> None:
    """Serve until SIGTERM or SIGINT, then drain; a second signal ends at once.

    Args:
        settings: settings of the server.
        endpoint: its address, and access to it.
        executor: runs the jobs; shut down at the end.
        on_ready: called with the address as soon as requests are answered.

    Raises:
        ServiceError: the server cannot be started.
    """
    async with start_server(settings, endpoint, executor) as server:
        stop, now = asyncio.Event(), asyncio.Event()

        def request_stop() -> None:
            (now if stop.is_set() else stop).set()

        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, request_stop)
        files = {"tokens": endpoint.tokens, "certificates": server.certificates}
        reloadable = {name: file for name, file in files.items() if file is not None}
        # SIGHUP reloads; without files to reload it means that the terminal was closed.
        loop.add_signal_handler(signal.SIGHUP, partial(_reload, reloadable) if reloadable else request_stop)
        gc.collect()
        sys.setswitchinterval(SWITCH_S)
        gc.freeze()  # what is loaded by now stays, so that later collections need not scan it
        on_ready(server.address)
        await stop.wait()
        await _drain(server, settings.drain_s, now)


@asynccontextmanager
async def start_server(settings: ServerSettings, endpoint: Endpoint, executor: Pool) -> AsyncIterator[RunningServer]:
    """Start a server that answers while the body runs, and stop it without a drain.

    Raises:
        ServiceError: the server cannot be started.
    """
    problems = find_listen_problems(endpoint.address, endpoint.tls, endpoint.tokens)
    if problems:
        raise TrustError("\n".join(problems))
    certificates = None if endpoint.tls is None else Certificates(endpoint.tls)
    async with AsyncExitStack() as stack:
        stack.callback(executor.shutdown, wait=False, cancel_futures=True)
        store = stack.enter_context(Store(settings.data / STORE_FOLDER, settings.store_limits))
        clouds = stack.enter_context(CloudStore(settings.data / CLOUDS_FOLDER, settings.cloud_limits))
        folders = resolve_folders(settings.allowed, clouds.has, store.scenes.has)
        limiter = endpoint.limiter or ClientLimiter()
        metrics = _start_metrics(stack, endpoint, executor, store, clouds)
        counts, later = PlanCounts(), Later()
        stack.callback(later.finish)

        def count(kind: str, verdict: str, timings: Mapping[str, float]) -> None:
            counts.add(verdict, timings)
            later.call(metrics.plan_finished, kind, verdict, timings)

        calls, health = OpenCalls(), Health((SERVICE.full_name,))
        disk = DiskWatch(settings.data, store, clouds, health)
        jobs = JobRunner(executor, Admission(settings.workers, settings.queue_limit))
        robots = RobotFolder(settings.robots)
        if robots.overriding:
            _LOG.warning("own robots override robots of scopt", names=list(robots.overriding))
        known = KnownRobots(robots)
        reader = RequestReader(settings, folders, clouds, store.scenes, robots, known)
        plans = PlanHandler(reader, jobs, store, disk, count, later)
        uploads = UploadHandler(clouds, disk, limiter, metrics.upload_finished)
        queries = QueryHandlers(settings, jobs, store, plans.running, robots, counts, endpoint.signer)
        uses_certificates = endpoint.tls is not None and endpoint.tls.client_ca is not None
        interceptors: list[Interceptor] = [
            TelemetryInterceptor(metrics, endpoint.spans, later),
            calls,
            AccessInterceptor(endpoint.tokens, limiter, uses_certificates),
        ]
        executions = ExecutionHandlers(endpoint.robot, store)
        servicer = Servicer(
            plans,
            uploads,
            CloudHandlers(reader, jobs, store, disk),
            queries,
            PoseHandler(reader, jobs),
            ListHandlers(store, plans.running),
            executions,
        )
        server = grpc.aio.server(interceptors=interceptors, options=_options(settings))
        _add_services(server, servicer, health)
        address = _bind_ports(server, endpoint, certificates)
        stack.push_async_callback(executions.close)
        is_ready, _ = await asyncio.gather(asyncio.to_thread(executor.wait_ready), executions.start())
        if not is_ready:
            raise ServiceError("no worker could be started; see the log")
        stack.enter_context(executor.read_in(asyncio.get_running_loop()))
        await plans.resume()
        await server.start()
        stack.push_async_callback(server.stop, 0.0)
        for watch in (_watch_jobs(jobs, health), disk.watch(), _learn_names(jobs, known, settings)):
            stack.callback(asyncio.create_task(watch).cancel)
        yield RunningServer(address, server, plans, queries, jobs, health, calls, certificates)


def _start_metrics(
    stack: AsyncExitStack, endpoint: Endpoint, executor: Pool, store: Store, clouds: CloudStore
) -> Metrics:
    """Make the metrics, and serve them until the end of the stack if they have an address.

    Raises:
        TelemetryError: the address cannot be used.
    """
    metrics = Metrics([method.name for method in SERVICE.methods])
    metrics.watch(pool=executor.stats, store=store, clouds=clouds)
    if endpoint.metrics is not None:
        stack.enter_context(MetricsServer(endpoint.metrics, metrics.registry, endpoint.is_metrics_remote))
    return metrics


def _add_services(server: grpc.aio.Server, servicer: Servicer, health: Health) -> None:
    """Register the planning service, health and reflection."""
    server.add_generic_rpc_handlers((make_handlers(servicer),))
    health_pb2_grpc.add_HealthServicer_to_server(health, server)
    enable_reflection(server, (SERVICE.full_name, HEALTH_NAME))


def _options(settings: ServerSettings) -> list[tuple[str, int]]:
    return [
        ("grpc.max_receive_message_length", settings.message_bytes),
        ("grpc.max_send_message_length", -1),
        ("grpc.max_concurrent_streams", MAX_STREAMS),
        ("grpc.so_reuseport", 0),  # a second server on the port is an error
        ("grpc.keepalive_time_ms", 30_000),
        ("grpc.keepalive_timeout_ms", 10_000),
        ("grpc.http2.min_ping_interval_without_data_ms", 10_000),
    ]


def _bind_ports(server: grpc.aio.Server, endpoint: Endpoint, certificates: Certificates | None) -> str:
    """Bind the server's port and its Unix socket; returns the address with the port's number.

    Raises:
        TrustError: one of them cannot be used.
    """
    address = _bind_port(server, endpoint.address, certificates)
    if endpoint.socket is not None:
        _bind_port(server, f"{UNIX}{endpoint.socket}", None)
    return address


def _bind_port(server: grpc.aio.Server, address: str, certificates: Certificates | None) -> str:
    """Bind the server's port; returns the address with its number.

    Raises:
        TrustError: the address cannot be used.
    """
    try:
        if certificates is None:
            number = server.add_insecure_port(address)
        else:
            number = server.add_secure_port(address, certificates.credentials)
    except RuntimeError:
        number = 0
    if number == 0:
        raise TrustError(f"--listen {address}: cannot listen there; does another server use it?")
    return address if address.startswith(UNIX) else f"{address.rpartition(':')[0]}:{number}"


async def _drain(server: RunningServer, drain_s: float, now: asyncio.Event) -> None:
    """Refuse new work, and wait for the open jobs for at most ``drain_s``.

    Calls for status and stored plans are answered until then; new work is told to try another server.
    """
    _LOG.info("draining", running=len(server.plans.running), at_most_s=drain_s)
    server.queries.is_draining = server.jobs.is_closed = True
    server.health.end()
    hurry = asyncio.create_task(now.wait())
    empty = asyncio.create_task(server.jobs.wait_until_empty())
    await asyncio.wait([empty, hurry], timeout=drain_s, return_when=asyncio.FIRST_COMPLETED)
    server.jobs.stop_all(GOING_DOWN if now.is_set() else STOPPING)
    stopping = asyncio.create_task(server.server.stop(SEND_S + REFUSE_S))  # responses being sent still arrive
    await asyncio.wait([stopping, hurry], timeout=SEND_S, return_when=asyncio.FIRST_COMPLETED)
    hurry.cancel()
    empty.cancel()
    server.calls.end_all()
    await asyncio.wait([stopping], timeout=REFUSE_S)
    await server.server.stop(0.0)
    with suppress(asyncio.CancelledError):
        await stopping
    await server.plans.wait_for_all()


async def _watch_jobs(jobs: JobRunner, health: Health) -> None:
    """Stop overdue jobs, and report NOT_SERVING while there is no worker."""
    while True:
        await asyncio.sleep(CHECK_JOBS_EVERY_S)
        jobs.stop_overdue()
        is_ready = jobs.executor.stats().ready > 0
        if health.set_ready("workers", is_ready):
            _LOG.log(INFO if is_ready else ERROR, "workers are ready" if is_ready else "no worker is ready")


async def _learn_names(jobs: JobRunner, known: KnownRobots, settings: ServerSettings) -> None:
    """Have a worker describe the package's robots; until then wrong names are refused by the workers that plan."""
    place, budget_s = Place("", Lane.LIGHT), settings.budget_s("robots")
    try:
        known.learn(await jobs.run("robots", list_names, deadline=None, budget_s=budget_s, place=place))
    except Refusal as error:
        _LOG.warning("names of robots are not known before a plan", reason=error.text)


def _reload(files: Mapping[str, Tokens | Certificates]) -> None:
    for name, file in files.items():
        try:
            file.reload()
        except TrustError as error:  # the previous ones stay valid
            _LOG.error(f"{name} not reloaded", reason=str(error))
        else:
            _LOG.info(f"{name} reloaded")
