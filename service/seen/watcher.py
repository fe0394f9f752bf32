"""Every RPC seen: counted, timed, logged with its end, and a span if spans are asked for."""

from __future__ import annotations

import contextvars
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import structlog

from service.rpc import Context, Interceptor, refuse, shortened
from service.seen.incidents import incident
from service.seen.metrics import Metrics
from service.seen.spans import NoSpans, Spans
from service.trust import current_caller, peer_key

_LOG = structlog.get_logger("scopt.rpc")
_CODES = {code.value[0]: code for code in grpc.StatusCode}
MAX_WHY_BYTES = 300
_QUIET = ("/grpc.health.", "/grpc.reflection.", "/planner.v1.PlannerService/GetStatus")  # asked for all day long
_OURS = {grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN, grpc.StatusCode.DATA_LOSS}


class Watcher(Interceptor):
    """Stands before all other interceptors, so that it sees what they refuse too.

    An exception that nobody expected is logged whole; the client is told the number it is logged under.
    """

    def __init__(self, metrics: Metrics, spans: Spans | None = None) -> None:
        self._metrics = metrics
        self._spans: Spans = spans or NoSpans()

    @asynccontextmanager
    async def through(self, method: str, context: Context) -> AsyncIterator[None]:
        name = method.rpartition("/")[2]
        began = time.monotonic()
        self._metrics.request_began(name)
        with self._spans.of_rpc(method, context.invocation_metadata() or ()) as span:
            # By its end the handler has bound what the log shall say of it.
            said = contextvars.copy_context()

            def ended(_: Context) -> None:
                code, seconds = _end_of(context), time.monotonic() - began
                self._metrics.request_ended(name, code.name, seconds)
                self._spans.ended(span, code.name)
                said.run(_log, method, context, code, seconds)

            # Only then is known how it ended: the handler may be through before it hears that nobody listens any more.
            context.add_done_callback(ended)  # type: ignore[arg-type]
            try:
                async with _told(method, context):
                    yield
            finally:
                said = contextvars.copy_context()


@asynccontextmanager
async def _told(method: str, context: Context) -> AsyncIterator[None]:
    """An exception that nobody expected becomes INTERNAL, without a word of it to the client."""
    try:
        yield
    except grpc.aio.BaseError:  # an abort, and misuse of gRPC that it tells of itself
        raise
    except Exception as error:
        await refuse(context, incident(error, method=method))


def _log(method: str, context: Context, code: grpc.StatusCode, seconds: float) -> None:
    level = "error" if code in _OURS else "debug" if method.startswith(_QUIET) else "info"
    try:
        client = current_caller().name
    except LookupError:  # it did not come through the gate
        client = peer_key(context.peer())
    why = {} if code is grpc.StatusCode.OK else {"why": shortened(_details(context), MAX_WHY_BYTES)}
    getattr(_LOG, level)(
        "rpc", method=method.rpartition("/")[2], code=code.name, ms=round(1000 * seconds, 1), client=client, **why
    )


def _details(context: Context) -> str:
    """What the client was told of why."""
    details: Any = context.details()
    return details.decode(errors="replace") if isinstance(details, bytes) else str(details or "")


def _end_of(context: Context) -> grpc.StatusCode:
    """How an RPC has ended that has."""
    if not context.done():  # no status was sent: the client had gone
        return grpc.StatusCode.DEADLINE_EXCEEDED if context.time_remaining() == 0 else grpc.StatusCode.CANCELLED
    code: Any = context.code()  # a code, its number, or nothing where all is well
    if code is None or isinstance(code, grpc.StatusCode):
        return code or grpc.StatusCode.OK
    return _CODES.get(code, grpc.StatusCode.UNKNOWN)
