"""What a client is made with, shared by the blocking and the asynchronous one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import grpc

from service.client.clouds import CloudToSend
from service.client.connection import Connection
from service.client.errors import PlannerError
from service.client.names import CloudNames
from service.client.retry import Attempts, Retry
from service.client.steps import LastStep
from service.client.unreachable import explained

OnRetry = Callable[[PlannerError, float], None]
SLOWEST_UPLOAD = 1e6  # [bytes/s]


class ClientSettings:
    """Where the server is, and how patient the client is.

    Args:
        target: ``HOST:PORT`` or ``unix:PATH``.
        tls_ca, tls_cert, tls_key: PEM files; any of them makes it TLS (see ``Connection``).
        token: what the server knows the client by.
        timeout_s: of calls that answer at once; those that work have the server's limits, or a deadline of their own.
        retry: how often a call is tried again.
        on_retry: told the error and the wait [s] before another attempt.

    Raises:
        RequestError: they do not go together, or a file cannot be read.
    """

    def __init__(
        self,
        target: str,
        *,
        tls_ca: str | Path | None = None,
        tls_cert: str | Path | None = None,
        tls_key: str | Path | None = None,
        token: str | None = None,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        on_retry: OnRetry | None = None,
    ) -> None:
        self._connection = Connection(target, tls_ca, tls_cert, tls_key, token)
        self._credentials = self._connection.credentials()
        self._timeout_s = timeout_s
        self._retry = retry or Retry()
        self._on_retry = on_retry
        self._names = CloudNames()

    def _attempts(self, deadline_s: float | None, is_repeatable: bool = True) -> Attempts:
        return Attempts(self._retry, deadline_s, is_repeatable)

    def _upload_time_s(self, cloud: CloudToSend) -> float:
        return self._timeout_s + cloud.n_bytes / SLOWEST_UPLOAD

    def _wait_s(self, attempts: Attempts, error: PlannerError, step: LastStep | None = None) -> float:
        """Before the next attempt.

        Raises:
            PlannerError: there is none; in the words of whoever asked.
        """
        error = (step or LastStep()).told(self._names.in_words_of_here(error), attempts.deadline_s)
        if error.code is grpc.StatusCode.UNAVAILABLE:
            text = explained(error.text, self._connection)
            error = PlannerError(error.code, text, error.violations, error.retry_delay_s)
        delay = attempts.delay_s(error)
        if self._on_retry is not None:
            self._on_retry(error, delay)
        return delay

    def _call_options(self, attempts: Attempts) -> dict[str, Any]:
        """
        Raises:
            PlannerError: no time is left for another attempt.
        """
        timeout_s = attempts.timeout_s
        if timeout_s is not None and timeout_s <= 0.0:
            raise PlannerError(grpc.StatusCode.DEADLINE_EXCEEDED, "no time is left")
        return {"timeout": timeout_s, "metadata": self._connection.metadata}
