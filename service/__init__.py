"""What a user asks and gets: request, planner, verifier, result files, command line.

Names are imported when they are first used, so that ``scopt --help`` need not load the libraries behind them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.errors import RequestError, ResultError, ServiceError
    from service.planner import plan
    from service.request.file import load_request, parse_request, request_hash
    from service.request.schema import PlanRequest
    from service.result.folder import read_result
    from service.result.output import write_result
    from service.result.result import PlanResult
    from service.setup.prepare import PlanSetup, prepare

_HOME = {
    "PlanRequest": "service.request.schema",
    "PlanResult": "service.result.result",
    "PlanSetup": "service.setup.prepare",
    "RequestError": "service.errors",
    "ResultError": "service.errors",
    "ServiceError": "service.errors",
    "load_request": "service.request.file",
    "parse_request": "service.request.file",
    "plan": "service.planner",
    "prepare": "service.setup.prepare",
    "read_result": "service.result.folder",
    "request_hash": "service.request.file",
    "write_result": "service.result.output",
}

__all__ = [
    "PlanRequest",
    "PlanResult",
    "PlanSetup",
    "RequestError",
    "ResultError",
    "ServiceError",
    "load_request",
    "parse_request",
    "plan",
    "prepare",
    "read_result",
    "request_hash",
    "write_result",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'service' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
