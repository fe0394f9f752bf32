"""Requests as messages: the wire has the keys of a request file, and the same validator reads both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.request.versions import write_given
from service.wire.plain import fill, to_plain


def request_from_message(message: MotionRequest, folder: str | Path = ".") -> PlanRequest:
    """Read a request; relative paths start at ``folder``.

    Raises:
        RequestError: one line per problem.
    """
    return parse_request(to_plain(message), folder)


def request_to_message(request: PlanRequest) -> MotionRequest:
    """Write a request; ``request_from_message`` reads an equal one.

    Defaults that are not the same in every version are left to the server, so that a request that is sent again after
    an upgrade is the same.

    Raises:
        RequestError: the wire has no field for a part of the request.
    """
    message = MotionRequest()
    fill(message, _drop_empty(write_given(request)))
    return message


def _drop_empty(data: Any) -> Any:
    """Return ``data`` without nulls and empty collections."""
    if isinstance(data, Mapping):
        kept = {key: _drop_empty(value) for key, value in data.items()}
        return {key: value for key, value in kept.items() if value is not None and value not in ([], {}, ())}
    return [_drop_empty(entry) for entry in data] if isinstance(data, list | tuple) else data
