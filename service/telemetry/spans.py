"""Spans of RPCs for an OpenTelemetry collector; optional."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Protocol

from service.telemetry.errors import TelemetryError

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import SpanExporter


class Spans(Protocol):
    """Recorder of spans."""

    def start_rpc(self, method: str, metadata: Iterable[tuple[str, str | bytes]]) -> AbstractContextManager[Any]:
        """Start the span of an RPC in the trace named by ``traceparent``; ``end_rpc`` ends it."""
        ...

    def end_rpc(self, span: Any, code: str) -> None:
        """End a span with the status of its RPC."""
        ...

    def close(self) -> None:
        """Send the remaining spans."""
        ...


class NoSpans:
    """Recorder that drops all spans."""

    def start_rpc(self, method: str, metadata: Iterable[tuple[str, str | bytes]]) -> AbstractContextManager[Any]:
        return nullcontext()

    def end_rpc(self, span: Any, code: str) -> None:
        pass

    def close(self) -> None:
        pass


class SentSpans:
    """Recorder that sends spans to a collector.

    Args:
        endpoint: address of the collector, as in ``http://127.0.0.1:4317``; http is not encrypted.
        exporter: used instead of the collector.

    Raises:
        TelemetryError: OpenTelemetry is not installed.
    """

    def __init__(self, endpoint: str = "", *, exporter: SpanExporter | None = None) -> None:
        try:
            self._provider = _provider(endpoint, exporter)
        except ImportError:
            raise TelemetryError("spans: OpenTelemetry is not installed; run pip install 'scopt[otel]'") from None
        self._tracer = self._provider.get_tracer("scopt")

    @contextmanager
    def start_rpc(self, method: str, metadata: Iterable[tuple[str, str | bytes]]) -> Iterator[Any]:
        from opentelemetry.trace import SpanKind
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        carrier = {key: str(value) for key, value in metadata if key in ("traceparent", "tracestate")}
        service, _, name = method.strip("/").rpartition("/")
        with self._tracer.start_as_current_span(
            f"{service}/{name}",
            TraceContextTextMapPropagator().extract(carrier),
            SpanKind.SERVER,
            {"rpc.system": "grpc", "rpc.service": service, "rpc.method": name},
            record_exception=False,  # its text may quote the client
            set_status_on_exception=False,
            end_on_exit=False,
        ) as span:
            yield span

    def end_rpc(self, span: Any, code: str) -> None:
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
