"""How a call ends that is refused: a status, a sentence, and details that programs can read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import grpc
from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.duration_pb2 import Duration
from google.protobuf.message import Message
from google.rpc.error_details_pb2 import RetryInfo
from google.rpc.status_pb2 import Status

from service.errors import RequestError, UnplannedTaskError
from service.store import (
    NotStoredError,
    ReviewRefusedError,
    StoreError,
    StoreFullError,
    TooLargeError,
    UploadRefusedError,
)
from service.wire.violations import bad_request

DETAILS_KEY = "grpc-status-details-bin"
MAX_TEXT = 1000  # of a status message: it travels in a header
_OF_STORE: dict[type[StoreError], grpc.StatusCode] = {
    NotStoredError: grpc.StatusCode.NOT_FOUND,
    ReviewRefusedError: grpc.StatusCode.FAILED_PRECONDITION,
    StoreFullError: grpc.StatusCode.RESOURCE_EXHAUSTED,
    TooLargeError: grpc.StatusCode.INVALID_ARGUMENT,
    UploadRefusedError: grpc.StatusCode.INVALID_ARGUMENT,
}


class Refusal(Exception):  # noqa: N818 - an answer, not an accident
    """Ends a call.

    Attributes:
        code: the status.
        text: one sentence for people.
        details: messages of google.rpc for programs.
    """

    def __init__(self, code: grpc.StatusCode, text: str, details: Sequence[Message] = ()) -> None:
        super().__init__(text)
        self.code, self.text, self.details = code, text[:MAX_TEXT], tuple(details)

    def metadata(self) -> tuple[tuple[str, bytes], ...]:
        """The details as trailing metadata; none where there are none."""
        if not self.details:
            return ()
        status = Status(code=self.code.value[0], message=self.text)
        for detail in self.details:
            packed = AnyMessage()
            packed.Pack(detail)
            status.details.append(packed)
        return ((DETAILS_KEY, status.SerializeToString()),)


def invalid(problems: Iterable[str], within: str = "") -> Refusal:
    """INVALID_ARGUMENT with a field violation per problem."""
    lines = tuple(problems)
    return Refusal(grpc.StatusCode.INVALID_ARGUMENT, "; ".join(lines), [bad_request(lines, within)])


def overloaded(text: str, retry_after_s: float) -> Refusal:
    """RESOURCE_EXHAUSTED with the time after which it may be tried again."""
    whole, part = divmod(max(retry_after_s, 0.0), 1.0)
    retry = RetryInfo(retry_delay=Duration(seconds=int(whole), nanos=math.floor(part * 1e9)))
    return Refusal(grpc.StatusCode.RESOURCE_EXHAUSTED, text, [retry])


def refusal_of_problems(problems: Iterable[str], is_unplanned: bool, within: str = "") -> Refusal:
    """What a client hears of a request that cannot be used, or of one for which there is no planner yet."""
    refusal = invalid(problems, within)
    return Refusal(grpc.StatusCode.UNIMPLEMENTED, refusal.text, refusal.details) if is_unplanned else refusal


def refusal_of(error: RequestError | StoreError, within: str = "") -> Refusal:
    """What a client hears of an error of ours."""
    if isinstance(error, RequestError):
        return refusal_of_problems(error.problems, isinstance(error, UnplannedTaskError), within)
    return Refusal(_OF_STORE.get(type(error), grpc.StatusCode.INTERNAL), str(error))
