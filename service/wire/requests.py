"""Requests as messages: the wire has the keys of a request file, and one validator reads both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_request, to_json
from service.request.schema import PlanRequest
from service.wire.plain import fill, to_plain


def request_from_message(message: MotionRequest, folder: str | Path = ".") -> PlanRequest:
    """The request that a message says; relative paths start at ``folder``.

    Raises:
        RequestError: one line per problem.
    """
    return parse_request(to_plain(message), folder)


def request_to_message(request: PlanRequest) -> MotionRequest:
    """A message that says the request, defaults filled in; ``request_from_message`` gives an equal one.

    Raises:
        RequestError: the request says something the wire has no place for.
    """
    message = MotionRequest()
    fill(message, _said(to_json(request)))
    return message


def _said(data: Any) -> Any:
    """``data`` without what is null or an empty collection in it."""
    if isinstance(data, Mapping):
        kept = {key: _said(value) for key, value in data.items()}
        return {key: value for key, value in kept.items() if value is not None and value not in ([], {}, ())}
    return [_said(one) for one in data] if isinstance(data, list | tuple) else data
