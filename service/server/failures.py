"""How a call ends that an error has ended."""

from __future__ import annotations

from service.errors import RequestError
from service.server.disk import NO_ROOM
from service.server.refusal import OF_STORE, refusal_of
from service.store import DiskError, StoreError
from service.telemetry.logs import log_incident
from service.trust.rpc import Refusal


def refusal_for(error: Exception) -> Refusal:
    """What the client is told of an error: what it may mend; of anything else a number alone."""
    if isinstance(error, Refusal):
        return error
    if isinstance(error, RequestError) or (isinstance(error, StoreError) and type(error) in OF_STORE):
        return refusal_of(error)
    if isinstance(error, DiskError):  # whose text speaks of this disk; the log has it
        return NO_ROOM
    return log_incident(error)
