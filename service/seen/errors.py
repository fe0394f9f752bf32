"""Errors of what makes a server seen from outside."""

from __future__ import annotations

from service.errors import ServiceError


class SeenError(ServiceError):
    """Logs, metrics or spans that cannot be had as they were asked for."""
