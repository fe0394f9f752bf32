"""Errors of logs, metrics and spans."""

from __future__ import annotations

from service.errors import ServiceError


class TelemetryError(ServiceError):
    """A setting of logs, metrics or spans that cannot be used."""
