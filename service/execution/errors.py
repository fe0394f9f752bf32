"""Error of the executor."""

from __future__ import annotations

from service.errors import ServiceError


class ExecutionError(ServiceError):
    """Error for a plan, a robot or settings that cannot be executed; the message names field, value and reason."""
