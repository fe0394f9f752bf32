"""Requests as messages: the wire has the keys of a request file, and the same validator reads both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_request, to_json
from service.request.schema import PlanRequest
from service.wire.plain import fill, to_plain


def request_from_message(message: MotionRequest, folder: str | Path = ".") -> PlanRequest:
    """Read a request; relative paths start at ``folder``.

    Raises:
        RequestError: one line per problem.
    """
    return parse_request(to_plain(message), folder)


def request_to_message(request: PlanRequest) -> MotionRequest:
    """Write a request with its defaults; ``request_from_message`` reads an equal one.

    Raises:
        RequestError: the wire has no field for a part of the request.
    """
    message = MotionRequest()
    fill(message, _drop_empty(to_json(request)))
    return message


def _drop_empty(data: Any) -> Any:
    """Return ``data`` without nulls and empty collections."""
    if isinstance(data, Mapping):
        kept = {key: _drop_empty(value) for key, value in data.items()}
        return {key: value for key, value in kept.items() if value is not None and value not in ([], {}, ())}
    return [_drop_empty(entry) for entry in data] if isinstance(data, list | tuple) else data
