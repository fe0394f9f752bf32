"""Why a call came to nothing, read from what gRPC hands over at its end."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, cast

import grpc
from google.protobuf.message import DecodeError
from google.rpc.error_details_pb2 import BadRequest, RetryInfo
from google.rpc.status_pb2 import Status

from service.errors import ServiceError

DETAILS_KEY = "grpc-status-details-bin"
# How grpc.aio ends a call whose server answered while something was still being written to it: the answer is gone.
ANSWER_LOST = (grpc.StatusCode.INTERNAL, "Internal error from Core")


@dataclass(frozen=True)
class FieldViolation:
    """What is wrong with one field of a request; an empty field is the whole request."""

    field: str
    description: str


class PlannerError(ServiceError):
    """A call that came to nothing.

    Attributes:
        code: gRPC's.
        text: one sentence of the server's, or of gRPC's where no server was reached.
        violations: of fields, where the request is at fault.
        retry_delay_s: when the server says it may be tried again; None where it says nothing.
    """

    def __init__(
        self,
        code: grpc.StatusCode,
        text: str,
        violations: tuple[FieldViolation, ...] = (),
        retry_delay_s: float | None = None,
    ) -> None:
        super().__init__(f"{code.name}: {text}")
        self.code = code
        self.text = text
        self.violations = violations
        self.retry_delay_s = retry_delay_s

    @property
    def problems(self) -> tuple[str, ...]:
        """One line each: the violations, or the sentence where there are none."""
        lines = tuple(one.description or one.field for one in self.violations) or (self.text or self.code.name,)
        return tuple(" ".join(line.split()) for line in lines)


class _Ended(Protocol):
    """What the errors of blocking and of asynchronous calls have in common."""

    def code(self) -> grpc.StatusCode | None: ...
    def details(self) -> str | None: ...
    def trailing_metadata(self) -> Iterable[tuple[str, str | bytes]] | None: ...


def planner_error(error: grpc.RpcError) -> PlannerError:
    """The same error with all that the server told about it."""
    ended = cast(_Ended, error)
    code = ended.code() or grpc.StatusCode.UNKNOWN
    if (code, ended.details()) == ANSWER_LOST:
        return PlannerError(grpc.StatusCode.UNAVAILABLE, "the server's answer was lost while more was being sent")
    violations: list[FieldViolation] = []
    delay = None
    for detail in _status(ended.trailing_metadata() or ()).details:
        try:
            bad, retry = BadRequest(), RetryInfo()
            if detail.Unpack(bad):
                violations += [FieldViolation(one.field, one.description) for one in bad.field_violations]
            elif detail.Unpack(retry):
                delay = max(retry.retry_delay.seconds + 1e-9 * retry.retry_delay.nanos, 0.0)
        except DecodeError:
            continue  # of a later version, or damaged: code and text still hold
    return PlannerError(code, ended.details() or "", tuple(violations), delay)


def _status(metadata: Iterable[tuple[str, str | bytes]]) -> Status:
    """The rich status; an empty one where there is none that can be read."""
    for key, value in metadata:
        if key == DETAILS_KEY and isinstance(value, bytes):
            try:
                return Status.FromString(value)
            except DecodeError:
                break
    return Status()
