"""Requests, planner, verifier and result files as a library; ``dir(service)`` lists the public names.

A name is imported when it is first used, so that ``scopt --help`` need not load the libraries behind it.
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
    from service.simulation.options import SimulationOptions
    from service.simulation.simulate import simulate
    from service.tasks.stance import StanceSearch, find_stance

__all__ = [
    "PlanRequest",
    "PlanResult",
    "PlanSetup",
    "RequestError",
    "ResultError",
    "ServiceError",
    "SimulationOptions",
    "StanceSearch",
    "find_stance",
    "load_request",
    "parse_request",
    "plan",
    "prepare",
    "read_result",
    "request_hash",
    "simulate",
    "write_result",
]

_MODULES = {
    "errors": ("RequestError", "ResultError", "ServiceError"),
    "planner": ("plan",),
    "request.file": ("load_request", "parse_request", "request_hash"),
    "request.schema": ("PlanRequest",),
    "result.folder": ("read_result",),
    "result.output": ("write_result",),
    "result.result": ("PlanResult",),
    "setup.prepare": ("PlanSetup", "prepare"),
    "simulation.options": ("SimulationOptions",),
    "simulation.simulate": ("simulate",),
    "tasks.stance": ("StanceSearch", "find_stance"),
}


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"service.{module}"), name)
    raise AttributeError(f"module 'service' has no attribute {name!r}")
