"""Start of a server from the options of ``scopt serve``."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import platformdirs

from service.errors import RequestError, would_do
from service.executor import Pool
from service.result.approval import Signer
from service.server.operation.executions import RobotSettings
from service.server.serve import PRELOAD, Endpoint, serve
from service.server.settings import BUDGETS_S, KINDS, ServerSettings
from service.telemetry import SentSpans, set_up_logs
from service.trust import ClientLimiter, ClientLimits, TlsFiles, Tokens, find_listen_problems, find_socket_problems
from service.work.plan import warm_up
from service.work.robot.process import POLICIES

LIGHT_WORKERS = 1  # beside those that plan: they list robots and check names while all others are busy
LOCAL, RAY = "local", "ray://"
BURST_S = 5.0  # a burst may have as many requests as the rate allows in this time
SPANS_VARIABLE = "OTEL_EXPORTER_OTLP_ENDPOINT"  # OpenTelemetry's variable for the collector's address


@dataclass(frozen=True)
class ServeOptions:
    """Options of ``scopt serve``.

    Attributes:
        listen: address of the server.
        settings: fields of ``ServerSettings``; without ``data`` the user's data folder is used.
        budgets: ``KIND=SECONDS`` each.
        tls: files of the certificate, its key and the authority of client certificates.
        tokens: file of known clients.
        sign_key: private key that signs approvals; None without.
        metrics: address of the metrics.
        is_metrics_remote: whether other machines may reach it.
        socket: Unix socket for clients of this machine, besides ``listen``.
        executor: ``local`` or ``ray://HOST:PORT``.
        requests_per_s: rate of each client in the long run; None for the default.
        robot: the robot that plans are carried out on.
    """

    listen: str
    settings: Mapping[str, Any]
    budgets: tuple[str, ...] = ()
    tls: tuple[Path | None, Path | None, Path | None] = (None, None, None)
    tokens: Path | None = None
    sign_key: Path | None = None
    metrics: str | None = None
    is_metrics_remote: bool = False
    socket: Path | None = None
    executor: str = LOCAL
    requests_per_s: float | None = None
    robot: RobotSettings = field(default_factory=RobotSettings)


async def launch(options: ServeOptions, on_ready: Callable[[str], None]) -> None:
    """Serve until a signal to stop.

    Raises:
        RequestError: an option cannot be used.
        ServiceError: the server cannot be started.
    """
    data = options.settings.get("data") or Path(platformdirs.user_data_dir("scopt")) / "service"
    settings = ServerSettings(**{**options.settings, "data": data, "budgets_s": _parse_budgets(options.budgets)})
    if settings.robots is not None and not settings.robots.is_dir():
        raise RequestError(f"--robots {settings.robots}: is no folder")
    tokens = None if options.tokens is None else Tokens(options.tokens)
    tls = _make_tls(options.tls)
    signer = None if options.sign_key is None else Signer(options.sign_key)
    if options.robot.when_alone not in POLICIES:
        expected = would_do(options.robot.when_alone, POLICIES)
        raise RequestError(f"--when-alone: unknown policy {options.robot.when_alone!r}; expected {expected}")
    problems = find_listen_problems(options.listen, tls, tokens)  # before any worker is started
    if options.socket is not None:
        problems += [line.replace("--listen unix:", "--socket ") for line in find_socket_problems(options.socket)]
    if problems:
        raise RequestError(problems)
    set_up_logs()
    spans = SentSpans() if os.environ.get(SPANS_VARIABLE) else None
    limiter = _make_limiter(options.requests_per_s)
    endpoint = Endpoint(
        options.listen,
        tls,
        tokens,
        limiter,
        options.metrics,
        options.is_metrics_remote,
        None if options.socket is None else str(options.socket),
        spans,
        signer,
        options.robot,
    )
    await serve(settings, endpoint, _make_executor(options.executor, settings), on_ready)


def _parse_budgets(given: tuple[str, ...]) -> dict[str, float]:
    budgets = dict(BUDGETS_S)
    for text in given:
        kind, _, seconds = text.partition("=")
        if kind not in KINDS:
            raise RequestError(f"--budget {text}: unknown kind {kind!r}; expected {would_do(kind, KINDS)}")
        try:
            budgets[kind] = float(seconds)
        except ValueError:
            raise RequestError(f"--budget {text}: expected KIND=SECONDS, such as egress=300") from None
        if not 0.0 < budgets[kind] <= 3600.0:
            raise RequestError(f"--budget {text}: expected more than 0 and at most 3600 seconds")
    return budgets


def _make_limiter(requests_per_s: float | None) -> ClientLimiter | None:
    if requests_per_s is None:
        return None
    return ClientLimiter(ClientLimits(requests_per_s=requests_per_s, requests_burst=BURST_S * requests_per_s))


def _make_tls(files: tuple[Path | None, Path | None, Path | None]) -> TlsFiles | None:
    cert, key, client_ca = files
    if cert is None and key is None and client_ca is None:
        return None
    if cert is None or key is None:
        raise RequestError("--tls-cert and --tls-key go together, and --client-ca needs both")
    return TlsFiles(cert, key, client_ca)


def _make_executor(name: str, settings: ServerSettings) -> Pool:
    if name == LOCAL:
        from service.executor.local_pool import LocalPool

        return LocalPool(
            settings.workers,
            warm_up=warm_up,
            preload=PRELOAD,
            max_bytes=settings.worker_bytes,
            light_workers=LIGHT_WORKERS,
        )
    if name.startswith(RAY):
        from service.executor.ray_pool import RayPool

        try:
            return RayPool(name, settings.workers, warm_up=warm_up, preload=PRELOAD, max_bytes=settings.worker_bytes)
        except ImportError:
            raise RequestError(f"--executor {name}: Ray is not installed; run pip install 'scopt[ray]'") from None
        except ConnectionError as error:
            raise RequestError(f"--executor {name}: {error}") from None
        except Exception as error:
            if type(error).__name__ != "AuthenticationError":  # a class that older versions of Ray do not have
                raise
            text = "the cluster expects its token; set RAY_AUTH_TOKEN_PATH or RAY_AUTH_TOKEN as for `ray start`"
            raise RequestError(f"--executor {name}: {text}") from None
    raise RequestError(f"--executor: expected {LOCAL} or ray://HOST:PORT, got {name!r}")
