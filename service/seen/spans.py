"""Spans for an OpenTelemetry collector; nothing at all where they were not asked for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Protocol

from service.seen.errors import SeenError

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import SpanExporter


class Spans(Protocol):
    """Where spans go."""

    def of_rpc(self, method: str, metadata: Iterable[tuple[str, str | bytes]]) -> AbstractContextManager[Any]:
        """A span that lasts until the RPC has ended, and is part of the trace that ``traceparent`` names."""
        ...

    def ended(self, span: Any, code: str) -> None:
        """Say how the RPC of a span has ended."""
        ...

    def close(self) -> None:
        """Send what is left."""
        ...


class NoSpans:
    """They go nowhere."""

    def of_rpc(self, method: str, metadata: Iterable[tuple[str, str | bytes]]) -> AbstractContextManager[Any]:
        return nullcontext()

    def ended(self, span: Any, code: str) -> None:
        pass

    def close(self) -> None:
        pass


class SentSpans:
    """They go to a collector.

    Args:
        endpoint: of the collector, as in ``http://127.0.0.1:4317``; http is not encrypted.
        exporter: where they go instead.

    Raises:
        SeenError: OpenTelemetry is not installed.
    """

    def __init__(self, endpoint: str = "", *, exporter: SpanExporter | None = None) -> None:
        try:
            self._provider = _provider(endpoint, exporter)
        except ImportError:
            raise SeenError("spans need a further library: pip install 'scopt[otel]'") from None
        self._tracer = self._provider.get_tracer("scopt")

    @contextmanager
    def of_rpc(self, method: str, metadata: Iterable[tuple[str, str | bytes]]) -> Iterator[Any]:
        from opentelemetry.trace import SpanKind
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        carrier = {key: str(value) for key, value in metadata if key in ("traceparent", "tracestate")}
        service, _, name = method.strip("/").rpartition("/")
        with self._tracer.start_as_current_span(
            f"{service}/{name}",
            TraceContextTextMapPropagator().extract(carrier),
            SpanKind.SERVER,
            {"rpc.system": "grpc", "rpc.service": service, "rpc.method": name},
            record_exception=False,  # its text may be the client's
            set_status_on_exception=False,
            end_on_exit=False,
        ) as span:
            yield span

    def ended(self, span: Any, code: str) -> None:
        from opentelemetry.trace import StatusCode

        span.set_attribute("rpc.grpc.status_code", code)
        if code in ("INTERNAL", "UNKNOWN", "DATA_LOSS", "UNIMPLEMENTED", "UNAVAILABLE", "DEADLINE_EXCEEDED"):
            span.set_status(StatusCode.ERROR, code)
        span.end()

    def close(self) -> None:
        self._provider.shutdown()


def _provider(endpoint: str, exporter: SpanExporter | None) -> TracerProvider:
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor, SimpleSpanProcessor

    provider = TracerProvider(resource=Resource.create({"service.name": "scopt"}))
    if exporter is not None:
        provider.add_span_processor(SimpleSpanProcessor(exporter))
    else:
        from opentelemetry.exporter.otlp.proto.grpc.trace_exporter import OTLPSpanExporter

        sent = OTLPSpanExporter(endpoint=endpoint, insecure=not endpoint.startswith("https://"))
        provider.add_span_processor(BatchSpanProcessor(sent))
    return provider
