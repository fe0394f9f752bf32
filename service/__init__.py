"""Requests, planner, verifier and result files as a library; ``dir(service)`` lists the public names.

A name is imported when it is first used, so that ``scopt --help`` need not load the libraries behind it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.bench.batch import BatchRow, plan_many
    from service.errors import ExecutionError, RequestError, ResultError, ServiceError
    from service.execution.driver import JointCommand, RobotDriver, RobotReading
    from service.execution.execution import Execution
    from service.execution.machine import Order
    from service.execution.reference import PlannedReference
    from service.execution.session import ReachSession
    from service.execution.settings import ExecutionSettings
    from service.execution.tracking import Action, track
    from service.planner import plan
    from service.replay.exchange.certify import CertifiedTrajectory, certify
    from service.replay.exchange.joint_trajectory import JointTrajectory
    from service.replay.exchange.read import read_trajectory
    from service.request.file import load_request, parse_request, request_hash
    from service.request.region import RegionRequest
    from service.request.schema import PlanRequest
    from service.request.tasks.reach import GoalPartRequest, GoalRequest, PoseGoalRequest
    from service.result.folder import read_result
    from service.result.output import write_result
    from service.result.result import PlanResult
    from service.setup.prepare import PlanSetup, prepare
    from service.simulation.options import SimulationOptions
    from service.simulation.simulate import simulate
    from service.tasks.queries import IkSolution, PoseClearance, SweepClearance, clearance, solve_ik, sweep_clearance
    from service.tasks.stances.search import StanceSearch, find_stance

__all__ = [
    "Action",
    "BatchRow",
    "CertifiedTrajectory",
    "Execution",
    "ExecutionError",
    "ExecutionSettings",
    "GoalPartRequest",
    "GoalRequest",
    "IkSolution",
    "JointCommand",
    "JointTrajectory",
    "Order",
    "PlanRequest",
    "PlanResult",
    "PlanSetup",
    "PlannedReference",
    "PoseClearance",
    "PoseGoalRequest",
    "ReachSession",
    "RegionRequest",
    "RequestError",
    "ResultError",
    "RobotDriver",
    "RobotReading",
    "ServiceError",
    "SimulationOptions",
    "StanceSearch",
    "SweepClearance",
    "certify",
    "clearance",
    "find_stance",
    "load_request",
    "parse_request",
    "plan",
    "plan_many",
    "prepare",
    "read_result",
    "read_trajectory",
    "request_hash",
    "simulate",
    "solve_ik",
    "sweep_clearance",
    "track",
    "write_result",
]

_MODULES = {
    "bench.batch": ("BatchRow", "plan_many"),
    "errors": ("ExecutionError", "RequestError", "ResultError", "ServiceError"),
    "replay.exchange.certify": ("CertifiedTrajectory", "certify"),
    "replay.exchange.joint_trajectory": ("JointTrajectory",),
    "replay.exchange.read": ("read_trajectory",),
    "execution.driver": ("JointCommand", "RobotDriver", "RobotReading"),
    "execution.execution": ("Execution",),
    "execution.settings": ("ExecutionSettings",),
    "execution.machine": ("Order",),
    "execution.reference": ("PlannedReference",),
    "execution.session": ("ReachSession",),
    "execution.tracking": ("Action", "track"),
    "planner": ("plan",),
    "request.file": ("load_request", "parse_request", "request_hash"),
    "tasks.queries": ("IkSolution", "PoseClearance", "SweepClearance", "clearance", "solve_ik", "sweep_clearance"),
    "request.schema": ("PlanRequest",),
    "request.region": ("RegionRequest",),
    "request.tasks.reach": ("GoalPartRequest", "GoalRequest", "PoseGoalRequest"),
    "result.folder": ("read_result",),
    "result.output": ("write_result",),
    "result.result": ("PlanResult",),
    "setup.prepare": ("PlanSetup", "prepare"),
    "simulation.options": ("SimulationOptions",),
    "simulation.simulate": ("simulate",),
    "tasks.stances.search": ("StanceSearch", "find_stance"),
}


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            try:
                return getattr(importlib.import_module(f"service.{module}"), name)
            except ModuleNotFoundError as error:
                if str(error.name).startswith("service."):
                    raise ImportError(f"service.{name} is not part of scopt-client; pip install scopt has it") from None
                raise
    raise AttributeError(f"module 'service' has no attribute {name!r}")
