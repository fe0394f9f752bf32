"""What should not have happened: the log gets all of it, the client a number by which it is found there."""

from __future__ import annotations

import secrets

import grpc
import structlog

from service.errors import RequestError
from service.rpc import Refusal
from service.server.refusal import refusal_of
from service.store import StoreError

_LOG = structlog.get_logger("scopt.server")


def refusal_for(error: Exception) -> Refusal:
    """How a call ends that an error has ended."""
    if isinstance(error, Refusal):
        return error
    if isinstance(error, RequestError | StoreError):
        return refusal_of(error)
    number = secrets.token_hex(4)
    _LOG.error("incident", incident=number, exc_info=error)
    return Refusal(grpc.StatusCode.INTERNAL, f"internal error {number}, please report it; the server's log tells more")
