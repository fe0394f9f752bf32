"""How a call ends that an error has ended."""

from __future__ import annotations

from service.errors import RequestError
from service.rpc import Refusal
from service.seen.incidents import incident
from service.server.refusal import refusal_of
from service.store import StoreError


def refusal_for(error: Exception) -> Refusal:
    """What the client is told of an error: what it may mend; of anything else a number alone."""
    if isinstance(error, Refusal):
        return error
    if isinstance(error, RequestError | StoreError):
        return refusal_of(error)
    return incident(error)
