"""From what a command line says to a server that runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import platformdirs

from service.errors import RequestError, would_do
from service.executor import CancellableExecutor
from service.server.serve import PRELOAD, Port, serve
from service.server.settings import BUDGETS_S, KINDS, ServerSettings
from service.telemetry import SentSpans, set_up_logs
from service.trust import ClientLimits, Limits, TlsFiles, Tokens, listen_problems
from service.work.plan import warm_up

LOCAL, RAY = "local", "ray://"
BURST_S = 5.0  # of a client's rate that may come at once
SPANS_VARIABLE = "OTEL_EXPORTER_OTLP_ENDPOINT"  # of OpenTelemetry: where spans go, if anywhere


@dataclass(frozen=True)
class Launch:
    """What ``scopt serve`` was told.

    Attributes:
        listen: where.
        settings: fields of ``ServerSettings``; its ``data`` may be None for the user's own folder.
        budgets: ``KIND=SECONDS`` each.
        tls: certificate, key and authority of clients.
        tokens: file of who may do what.
        metrics: where metrics are served.
        executor: ``local`` or ``ray://HOST:PORT``.
        requests_per_s: that each client may send in the long run, five times as many at once; None for the usual.
    """

    listen: str
    settings: Mapping[str, Any]
    budgets: tuple[str, ...] = ()
    tls: tuple[Path | None, Path | None, Path | None] = (None, None, None)
    tokens: Path | None = None
    metrics: str | None = None
    executor: str = LOCAL
    requests_per_s: float | None = None


async def launch(told: Launch, on_ready: Callable[[str], None]) -> None:
    """Serve until a signal to stop.

    Raises:
        RequestError: an option cannot be used; ServiceError: the server cannot be started so.
    """
    data = told.settings.get("data") or Path(platformdirs.user_data_dir("scopt")) / "service"
    settings = ServerSettings(**{**told.settings, "data": data, "budgets_s": _budgets(told.budgets)})
    if settings.robots is not None and not settings.robots.is_dir():
        raise RequestError(f"--robots {settings.robots}: is no folder")
    tokens = None if told.tokens is None else Tokens(told.tokens)
    tls = _tls(told.tls)
    problems = listen_problems(told.listen, tls, tokens)  # before any worker is started
    if problems:
        raise RequestError(problems)
    set_up_logs()
    spans = SentSpans() if os.environ.get(SPANS_VARIABLE) else None
    port = Port(told.listen, tls, tokens, _limiter(told.requests_per_s), told.metrics, spans)
    await serve(settings, port, _executor(told.executor, settings), on_ready)


def _budgets(given: tuple[str, ...]) -> dict[str, float]:
    budgets = dict(BUDGETS_S)
    for text in given:
        kind, _, seconds = text.partition("=")
        if kind not in KINDS:
            raise RequestError(f"--budget {text}: unknown kind {kind!r}; {would_do(kind, KINDS)} would do")
        try:
            budgets[kind] = float(seconds)
        except ValueError:
            raise RequestError(f"--budget {text}: KIND=SECONDS would do, such as egress=300") from None
        if not 0.0 < budgets[kind] <= 3600.0:
            raise RequestError(f"--budget {text}: more than 0 and at most 3600 seconds would do")
    return budgets


def _limiter(requests_per_s: float | None) -> Limits | None:
    if requests_per_s is None:
        return None
    return Limits(ClientLimits(requests_per_s=requests_per_s, requests_burst=BURST_S * requests_per_s))


def _tls(files: tuple[Path | None, Path | None, Path | None]) -> TlsFiles | None:
    cert, key, client_ca = files
    if cert is None and key is None and client_ca is None:
        return None
    if cert is None or key is None:
        raise RequestError("--tls-cert and --tls-key go together, and --client-ca needs both")
    return TlsFiles(cert, key, client_ca)


def _executor(name: str, settings: ServerSettings) -> CancellableExecutor:
    if name == LOCAL:
        from service.executor.local_pool import LocalPool

        return LocalPool(settings.workers, warm_up=warm_up, preload=PRELOAD, max_bytes=settings.worker_bytes)
    if name.startswith(RAY):
        try:
            from service.executor.ray_pool import RayPool
        except ImportError:
            raise RequestError(f"--executor {name}: Ray is not installed; pip install 'scopt[ray]' would do") from None
        try:
            return RayPool(name, settings.workers, warm_up=warm_up, preload=PRELOAD, max_bytes=settings.worker_bytes)
        except ConnectionError as error:
            raise RequestError(f"--executor {name}: {error}") from None
    raise RequestError(f"--executor: {LOCAL} or ray://HOST:PORT would do, got {name!r}")
