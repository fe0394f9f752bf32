"""Refusals for wrong requests, errors of the store, overload, and a server that cannot take work."""

from __future__ import annotations

from collections.abc import Iterable

import grpc
import structlog

from service.errors import RequestError, shown
from service.store import (
    CloudStore,
    DamagedError,
    DiskError,
    NotStoredError,
    ReviewRefusedError,
    StoreError,
    StoreFullError,
    TooLargeError,
    UploadRefusedError,
)
from service.telemetry import log_incident
from service.trust.rpc import Refusal
from service.wire.violations import make_bad_request

_LOG = structlog.get_logger("scopt.server")
STATUS_OF_STORE_ERROR: dict[type[StoreError], grpc.StatusCode] = {
    DamagedError: grpc.StatusCode.DATA_LOSS,
    NotStoredError: grpc.StatusCode.NOT_FOUND,
    ReviewRefusedError: grpc.StatusCode.FAILED_PRECONDITION,
    StoreFullError: grpc.StatusCode.RESOURCE_EXHAUSTED,
    TooLargeError: grpc.StatusCode.INVALID_ARGUMENT,
    UploadRefusedError: grpc.StatusCode.INVALID_ARGUMENT,
}
DISK_FULL = Refusal(
    grpc.StatusCode.UNAVAILABLE,
    "the server's disk cannot store new results; try another server, or later",
)
STOPPING = Refusal(grpc.StatusCode.UNAVAILABLE, "the server is stopping; try another one, or later")
GOING_DOWN = Refusal(grpc.StatusCode.UNAVAILABLE, "the server is going down now; try another one, or later")


def refuse_invalid(problems: Iterable[str], within: str = "") -> Refusal:
    """Make INVALID_ARGUMENT with a field violation per problem.

    Args:
        problems: one line each, beginning with the field.
        within: field of the message that holds the request.
    """
    lines = tuple(problems)
    return Refusal(grpc.StatusCode.INVALID_ARGUMENT, "; ".join(lines), details=[make_bad_request(lines, within)])


def refuse_overload(text: str, retry_after_s: float) -> Refusal:
    """Make RESOURCE_EXHAUSTED with the delay before another try."""
    return Refusal(grpc.StatusCode.RESOURCE_EXHAUSTED, text, max(retry_after_s, 0.0))


def discard_uploads(clouds: CloudStore, ids: Iterable[str]) -> Refusal:
    """Remove uploads whose bytes on the disk are not those that were uploaded; returns DATA_LOSS, which names them."""
    ids = tuple(ids)
    for cloud_id in ids:
        _LOG.error("a stored upload is damaged and is removed", upload=cloud_id)
        clouds.discard(cloud_id)
    lines = (
        f"upload {shown(cloud_id)} was damaged on this server's disk and is removed; upload it again"
        for cloud_id in ids
    )
    return Refusal(grpc.StatusCode.DATA_LOSS, "; ".join(lines))


def refuse_error(error: Exception, within: str = "") -> Refusal:
    """Make the refusal for an error that ended a call; an unexpected error tells the client only its number."""
    if isinstance(error, Refusal):
        return error
    if isinstance(error, RequestError):
        return refuse_invalid(error.problems, within)
    if isinstance(error, DamagedError):
        _LOG.error("stored data are damaged", reason=str(error), detail=error.detail)
    if isinstance(error, StoreError) and type(error) in STATUS_OF_STORE_ERROR:
        return Refusal(STATUS_OF_STORE_ERROR[type(error)], str(error))
    if isinstance(error, DiskError):  # its text names the server's files; the log has it
        return DISK_FULL
    return log_incident(error)
