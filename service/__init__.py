"""What a user asks and gets: request, planner, verifier, result files, command line.

Names are imported when they are first used, so that ``scopt --help`` need not load the libraries behind them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.errors import RequestError, ResultError, ServiceError
    from service.output import write_result
    from service.planner import plan
    from service.request import PlanRequest
    from service.request_file import load_request, parse_request, request_hash
    from service.result import PlanResult
    from service.result_folder import read_result
    from service.setup import PlanSetup, prepare

_HOME = {
    "PlanRequest": "service.request",
    "PlanResult": "service.result",
    "PlanSetup": "service.setup",
    "RequestError": "service.errors",
    "ResultError": "service.errors",
    "ServiceError": "service.errors",
    "load_request": "service.request_file",
    "parse_request": "service.request_file",
    "plan": "service.planner",
    "prepare": "service.setup",
    "read_result": "service.result_folder",
    "request_hash": "service.request_file",
    "write_result": "service.output",
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
