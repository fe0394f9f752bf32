"""Errors of calls, read from gRPC's status."""

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
# Status of grpc.aio for a call whose server answered while the client was still sending; the answer is lost.
ANSWER_LOST = (grpc.StatusCode.INTERNAL, "Internal error from Core")


@dataclass(frozen=True)
class FieldViolation:
    """Wrong field of a request; an empty ``field`` stands for the whole request."""

    field: str
    description: str


class PlannerError(ServiceError):
    """Failed call.

    Attributes:
        code: gRPC's status code.
        text: sentence of the server, or of the client if no server was reached.
        violations: wrong fields of the request.
        retry_delay_s: delay [s] after which the server allows another attempt; None if it names none.
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
        """One line per violation, or the sentence if there are none."""
        lines = tuple(violation.description or violation.field for violation in self.violations) or (
            self.text or self.code.name,
        )
        return tuple(" ".join(line.split()) for line in lines)


class _Status(Protocol):
    """Methods that the errors of blocking and of asynchronous calls share."""

    def code(self) -> grpc.StatusCode | None: ...
    def details(self) -> str | None: ...
    def trailing_metadata(self) -> Iterable[tuple[str, str | bytes]] | None: ...


def read_error(error: grpc.RpcError) -> PlannerError:
    """Return the error with the wrong fields and the delay from the server's rich status."""
    status = cast(_Status, error)
    code = status.code() or grpc.StatusCode.UNKNOWN
    if (code, status.details()) == ANSWER_LOST:
        return PlannerError(grpc.StatusCode.UNAVAILABLE, "the server's answer was lost while more was being sent")
    violations: list[FieldViolation] = []
    delay = None
    for detail in _read_rich_status(status.trailing_metadata() or ()).details:
        try:
            bad, retry = BadRequest(), RetryInfo()
            if detail.Unpack(bad):
                violations += [FieldViolation(wrong.field, wrong.description) for wrong in bad.field_violations]
            elif detail.Unpack(retry):
                delay = max(retry.retry_delay.seconds + 1e-9 * retry.retry_delay.nanos, 0.0)
        except DecodeError:
            continue  # from a later version, or damaged; code and text remain
    return PlannerError(code, status.details() or "", tuple(violations), delay)


def _read_rich_status(metadata: Iterable[tuple[str, str | bytes]]) -> Status:
    """Return the rich status; an empty one if none can be read."""
    for key, value in metadata:
        if key == DETAILS_KEY and isinstance(value, bytes):
            try:
                return Status.FromString(value)
            except DecodeError:
                break
    return Status()
