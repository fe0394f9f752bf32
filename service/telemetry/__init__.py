"""Logs, metrics and spans of a server."""

from __future__ import annotations

from service.telemetry.errors import TelemetryError
from service.telemetry.interceptor import TelemetryInterceptor
from service.telemetry.later import Later
from service.telemetry.logs import bind, log_incident, remove_secrets, set_up_logs
from service.telemetry.metrics import Metrics, MetricsServer
from service.telemetry.plan_counts import PlanCounts, sum_phases
from service.telemetry.spans import NoSpans, SentSpans, Spans

__all__ = [
    "Later",
    "Metrics",
    "MetricsServer",
    "NoSpans",
    "PlanCounts",
    "SentSpans",
    "Spans",
    "TelemetryError",
    "TelemetryInterceptor",
    "bind",
    "log_incident",
    "remove_secrets",
    "set_up_logs",
    "sum_phases",
]
