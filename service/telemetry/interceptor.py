"""Interceptor that counts, times and logs every RPC, and records its span."""

from __future__ import annotations

import contextvars
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import grpc
import structlog

from service.telemetry.later import Later
from service.telemetry.logs import log_incident
from service.telemetry.metrics import Metrics
from service.telemetry.spans import NoSpans, Spans
from service.trust import current_caller, peer_key
from service.trust.rpc import Context, Interceptor, refuse, shorten

_LOG = structlog.get_logger("scopt.rpc")
_CODES = {code.value[0]: code for code in grpc.StatusCode}
MAX_WHY_BYTES = 300
_QUIET = ("/grpc.health.", "/grpc.reflection.", "/planner.v1.PlannerService/GetStatus")  # called all day long
_SERVER_FAULTS = {grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN, grpc.StatusCode.DATA_LOSS}


class TelemetryInterceptor(Interceptor):
    """Outermost interceptor: it also sees what the others refuse.

    A call is counted and logged a moment after its end, since its client may have sent the next one.
    An unexpected exception is logged with its traceback; the client gets only the number of the log entry.
    """

    def __init__(self, metrics: Metrics, spans: Spans | None = None, later: Later | None = None) -> None:
        self._metrics = metrics
        self._later = later or Later()
        self._spans: Spans = spans or NoSpans()

    @asynccontextmanager
    async def wrap_call(self, method: str, context: Context) -> AsyncIterator[None]:
        name = method.rpartition("/")[2]
        began = time.monotonic()
        self._metrics.request_began(name)
        with self._spans.start_rpc(method, context.invocation_metadata() or ()) as span:
            # The handler binds log keys until its end, so the context is copied again there.
            bound = contextvars.copy_context()

            def ended(_: Context) -> None:
                code, seconds = _status_of(context), time.monotonic() - began
                self._spans.end_rpc(span, code.name)
                self._later.call(self._metrics.request_ended, name, code.name, seconds)
                # Nothing is left of the context afterwards.
                self._later.call(bound.run, partial(_log, method, code, seconds, **bound.run(_describe, context, code)))

            # The status is known only now: the handler may return before it learns that the client has gone.
            context.add_done_callback(ended)  # type: ignore[arg-type]
            try:
                yield
            except grpc.aio.BaseError:  # an abort, or misuse of gRPC, which it reports itself
                raise
            except Exception as error:
                await refuse(context, log_incident(error, method=method))
            finally:
                bound = contextvars.copy_context()


def _describe(context: Context, code: grpc.StatusCode) -> dict[str, str]:
    """Return the client of an ended call, and why it failed."""
    try:
        client = current_caller().name
    except LookupError:  # the call did not pass access control
        client = peer_key(context.peer())
    why = {} if code is grpc.StatusCode.OK else {"why": shorten(_details(context), MAX_WHY_BYTES)}
    return {"client": client, **why}


def _log(method: str, code: grpc.StatusCode, seconds: float, **more: str) -> None:
    level = "error" if code in _SERVER_FAULTS else "debug" if method.startswith(_QUIET) else "info"
    getattr(_LOG, level)("rpc", method=method.rpartition("/")[2], code=code.name, ms=round(1000 * seconds, 1), **more)


def _details(context: Context) -> str:
    """Return the status message sent to the client."""
    details: Any = context.details()
    return details.decode(errors="replace") if isinstance(details, bytes) else str(details or "")


def _status_of(context: Context) -> grpc.StatusCode:
    """Return the status of an ended RPC."""
    if not context.done():  # no status was sent, since the client had gone
        return grpc.StatusCode.DEADLINE_EXCEEDED if context.time_remaining() == 0 else grpc.StatusCode.CANCELLED
    code: Any = context.code()  # a code, its number, or None for OK
    if code is None or isinstance(code, grpc.StatusCode):
        return code or grpc.StatusCode.OK
    return _CODES.get(code, grpc.StatusCode.UNKNOWN)
