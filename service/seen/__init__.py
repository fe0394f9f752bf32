"""What is seen of a server from outside: logs, metrics, spans."""

from __future__ import annotations

from service.seen.errors import SeenError
from service.seen.logs import bind, set_up_logs
from service.seen.metrics import Metrics, MetricsServer, phases
from service.seen.secrets import without_secrets
from service.seen.spans import NoSpans, SentSpans, Spans
from service.seen.watcher import Watcher

__all__ = [
    "Metrics",
    "MetricsServer",
    "NoSpans",
    "SeenError",
    "SentSpans",
    "Spans",
    "Watcher",
    "bind",
    "phases",
    "set_up_logs",
    "without_secrets",
]
