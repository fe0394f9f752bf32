"""What a client hears of what is wrong with a request, with the store, or with the load."""

from __future__ import annotations

from collections.abc import Iterable

import grpc

from service.errors import RequestError, UnplannedTaskError
from service.store import (
    NotStoredError,
    ReviewRefusedError,
    StoreError,
    StoreFullError,
    TooLargeError,
    UploadRefusedError,
)
from service.trust.rpc import Refusal
from service.wire.violations import bad_request

OF_STORE: dict[type[StoreError], grpc.StatusCode] = {
    NotStoredError: grpc.StatusCode.NOT_FOUND,
    ReviewRefusedError: grpc.StatusCode.FAILED_PRECONDITION,
    StoreFullError: grpc.StatusCode.RESOURCE_EXHAUSTED,
    TooLargeError: grpc.StatusCode.INVALID_ARGUMENT,
    UploadRefusedError: grpc.StatusCode.INVALID_ARGUMENT,
}


def invalid(problems: Iterable[str], within: str = "") -> Refusal:
    """INVALID_ARGUMENT with a field violation per problem."""
    lines = tuple(problems)
    return Refusal(grpc.StatusCode.INVALID_ARGUMENT, "; ".join(lines), details=[bad_request(lines, within)])


def overloaded(text: str, retry_after_s: float) -> Refusal:
    """RESOURCE_EXHAUSTED with the time after which it may be tried again."""
    return Refusal(grpc.StatusCode.RESOURCE_EXHAUSTED, text, max(retry_after_s, 0.0))


def refusal_of_problems(problems: Iterable[str], is_unplanned: bool, within: str = "") -> Refusal:
    """What a client hears of a request that cannot be used, or of one for which there is no planner yet."""
    refusal = invalid(problems, within)
    return Refusal(grpc.StatusCode.UNIMPLEMENTED, refusal.text, details=refusal.details) if is_unplanned else refusal


def refusal_of(error: RequestError | StoreError, within: str = "") -> Refusal:
    """What a client hears of an error of ours, if of the store, one of ``OF_STORE``."""
    if isinstance(error, RequestError):
        return refusal_of_problems(error.problems, isinstance(error, UnplannedTaskError), within)
    return Refusal(OF_STORE[type(error)], str(error))
