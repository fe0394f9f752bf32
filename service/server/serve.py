"""A server from its start to its end: store, workers, port, and a drain when it is told to stop."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial

import grpc
import structlog
from grpc_health.v1 import health, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from service.errors import ServiceError
from service.executor import CancellableExecutor
from service.server.admission import Admission
from service.server.asked import Door
from service.server.disk import Disk
from service.server.farewell import GOING_DOWN, STOPPING, Farewell
from service.server.health import Health
from service.server.keeping import Keeping
from service.server.perceiving import Perceiving
from service.server.planning import Planning
from service.server.registration import SERVICE, method_handlers
from service.server.robots import RobotFolder
from service.server.servicer import Servicer
from service.server.settings import MOST_STREAMS, ServerSettings
from service.server.uploading import Uploading
from service.server.workshop import Workshop
from service.store import CloudStore, Store
from service.telemetry import Metrics, MetricsServer, Spans, TelemetryInterceptor
from service.trust import UNIX, Certificates, Gate, TlsFiles, Tokens, TrustError, allowed_folders, listen_problems
from service.trust import Limits as ClientLimiter

_LOG = structlog.get_logger("scopt.server")
PRELOAD = ("service.work.plan", "service.work.look", "perception", "service.tasks.valve_task", "service.trajopt")
OVERTIME_EVERY_S = 0.5
SWITCH_S = 1e-3  # after which a thread that reads a large message lets the event loop go on, who answers everybody
LAST_WORDS_S = 5.0  # for files on their way to a client when the work has ended
SAID_S = 1.0  # for calls to hear that they are ended
CLOUDS_FOLDER, STORE_FOLDER = "clouds", "plans"


@dataclass(frozen=True)
class Port:
    """Where a server listens, and for whom.

    Attributes:
        address: ``HOST:PORT``, ``[IPV6]:PORT`` or ``unix:PATH``; port 0 for any that is free.
        tls: its certificate; None without TLS.
        tokens: who may come in; None: everybody who can reach a server that only this machine can reach.
        limiter: of what each client may ask.
        metrics: where this machine may read them; None: nowhere.
        spans: what is told of every call.
    """

    address: str
    tls: TlsFiles | None = None
    tokens: Tokens | None = None
    limiter: ClientLimiter | None = None
    metrics: str | None = None
    spans: Spans | None = None


@dataclass(frozen=True)
class Running:
    """A server that answers.

    Attributes:
        address: where; with the port that was free.
        server: of gRPC; planning, keeping, workshop, health, farewell: its parts.
        certificates: that it shows; None without TLS.
    """

    address: str
    server: grpc.aio.Server
    planning: Planning
    keeping: Keeping
    workshop: Workshop
    health: Health
    farewell: Farewell
    certificates: Certificates | None


async def serve(
    settings: ServerSettings, port: Port, executor: CancellableExecutor, on_ready: Callable[[str], None]
) -> None:
    """Answer until SIGTERM or SIGINT, then finish what is under way; a second signal ends at once.

    Args:
        settings: of the server.
        port: where it listens.
        executor: what runs the work; it is shut down at the end.
        on_ready: told the address as soon as requests are answered.

    Raises:
        ServiceError: it cannot be started so.
    """
    async with running(settings, port, executor) as server:
        stop, now = asyncio.Event(), asyncio.Event()

        def ask() -> None:
            (now if stop.is_set() else stop).set()

        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, ask)
        kept = {"tokens": port.tokens, "certificates": server.certificates}
        known = {name: one for name, one in kept.items() if one is not None}
        # With nothing to read anew, the terminal it was started in has gone.
        loop.add_signal_handler(signal.SIGHUP, partial(_reload, known) if known else ask)
        gc.collect()
        sys.setswitchinterval(SWITCH_S)
        gc.freeze()  # what is loaded by now is no garbage: nobody waits while it is looked through
        on_ready(server.address)
        await stop.wait()
        await _drain(server, settings.drain_s, now)


@asynccontextmanager
async def running(settings: ServerSettings, port: Port, executor: CancellableExecutor) -> AsyncIterator[Running]:
    """A server that answers while the body runs; stopped without a drain.

    Raises:
        ServiceError: it cannot be started so.
    """
    problems = listen_problems(port.address, port.tls, port.tokens)
    if problems:
        raise TrustError("\n".join(problems))
    certificates = None if port.tls is None else Certificates(port.tls)
    async with AsyncExitStack() as stack:
        stack.callback(executor.shutdown, wait=False, cancel_futures=True)
        store = stack.enter_context(Store(settings.data / STORE_FOLDER, settings.store_limits))
        clouds = stack.enter_context(CloudStore(settings.data / CLOUDS_FOLDER, settings.cloud_limits))
        folders = allowed_folders(settings.allowed, clouds.has, store.scenes.has)
        limiter = port.limiter or ClientLimiter()
        metrics = Metrics()
        metrics.watch(pool=executor.stats, store=store, clouds=clouds)
        if port.metrics is not None:
            stack.enter_context(MetricsServer(port.metrics, metrics.registry))
        verdicts: Counter[str] = Counter()

        def count(kind: str, verdict: str, timings: Mapping[str, float]) -> None:
            verdicts[verdict] += 1
            metrics.plan_finished(kind, verdict, timings)

        farewell, state = Farewell(), Health((SERVICE.full_name,))
        disk = Disk(settings.data, store, clouds, state)
        workshop = Workshop(executor, Admission(settings.workers, settings.queue_limit))
        robots = RobotFolder(settings.robots)
        if robots.replaced:
            _LOG.warning("own robots in place of those that come with scopt", names=list(robots.replaced))
        planning = Planning(Door(settings, folders, clouds, store.scenes, robots), workshop, store, disk, count)
        perceiving = Perceiving(settings, folders, workshop, store, clouds, disk, robots)
        uploading = Uploading(clouds, disk, limiter, metrics.upload_finished)
        keeping = Keeping(settings, workshop, store, planning.running, robots, verdicts)
        server = grpc.aio.server(
            interceptors=[
                TelemetryInterceptor(metrics, port.spans),
                farewell,
                Gate(port.tokens, limiter, _asks_for_certificates(port.tls)),
            ],
            options=_options(settings),
        )
        server.add_generic_rpc_handlers((method_handlers(Servicer(planning, uploading, perceiving, keeping)),))
        health_pb2_grpc.add_HealthServicer_to_server(state, server)
        names = (SERVICE.full_name, health.SERVICE_NAME, reflection.SERVICE_NAME)
        reflection.enable_server_reflection(names, server)
        address = _bound(server, port.address, certificates)
        if not await asyncio.to_thread(executor.wait_ready):
            raise ServiceError("no worker could be started; the log tells why")
        await server.start()
        stack.push_async_callback(server.stop, 0.0)
        for watch in (_stop_overtime(workshop), disk.watch()):
            stack.callback(asyncio.create_task(watch).cancel)
        yield Running(address, server, planning, keeping, workshop, state, farewell, certificates)


def _asks_for_certificates(tls: TlsFiles | None) -> bool:
    return tls is not None and tls.client_ca is not None


def _options(settings: ServerSettings) -> list[tuple[str, int]]:
    return [
        ("grpc.max_receive_message_length", settings.message_bytes),
        ("grpc.max_send_message_length", -1),
        ("grpc.max_concurrent_streams", MOST_STREAMS),
        ("grpc.so_reuseport", 0),  # a second server on the port is an error, not a lottery
        ("grpc.keepalive_time_ms", 30_000),
        ("grpc.keepalive_timeout_ms", 10_000),
        ("grpc.http2.min_ping_interval_without_data_ms", 10_000),
    ]


def _bound(server: grpc.aio.Server, asked: str, certificates: Certificates | None) -> str:
    """The address it listens at.

    Raises:
        TrustError: it cannot.
    """
    try:
        if certificates is None:
            number = server.add_insecure_port(asked)
        else:
            number = server.add_secure_port(asked, certificates.credentials)
    except RuntimeError:
        number = 0
    if number == 0:
        raise TrustError(f"--listen {asked}: cannot listen there; is another server at it?")
    return asked if asked.startswith(UNIX) else f"{asked.rpartition(':')[0]}:{number}"


async def _drain(server: Running, drain_s: float, now: asyncio.Event) -> None:
    """Take no more work in, and see what is under way to its end, or for as long as there is.

    Until then questions are answered: how it goes, what has been planned, and that another server should be asked.
    """
    _LOG.info("draining", running=len(server.planning.running), at_most_s=drain_s)
    server.keeping.is_draining = server.workshop.is_closed = True
    server.health.end()
    hurry = asyncio.create_task(now.wait())
    emptied = asyncio.create_task(server.workshop.emptied())
    await asyncio.wait([emptied, hurry], timeout=drain_s, return_when=asyncio.FIRST_COMPLETED)
    server.workshop.stop_all(GOING_DOWN if now.is_set() else STOPPING)
    stopping = asyncio.create_task(server.server.stop(LAST_WORDS_S + SAID_S))  # answers that are on their way arrive
    await asyncio.wait([stopping, hurry], timeout=LAST_WORDS_S, return_when=asyncio.FIRST_COMPLETED)
    hurry.cancel()
    emptied.cancel()
    server.farewell.end_all()
    await asyncio.wait([stopping], timeout=SAID_S)
    await server.server.stop(0.0)
    with suppress(asyncio.CancelledError):
        await stopping
    await server.planning.ended()


async def _stop_overtime(workshop: Workshop) -> None:
    while True:
        await asyncio.sleep(OVERTIME_EVERY_S)
        workshop.stop_overtime()


def _reload(known: Mapping[str, Tokens | Certificates]) -> None:
    for name, one in known.items():
        try:
            one.reload()
        except TrustError as error:  # those before stay good
            _LOG.error(f"{name} not reloaded", reason=str(error))
        else:
            _LOG.info(f"{name} reloaded")
