"""From a valve request to the wheel and the hands it is turned with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.errors import RequestError
from service.phases import PhaseSolver, TaskPlan
from service.request import ValveRequest
from service.setup import PlanSetup
from service.tasks.valve import HANDS, Hand, Wheel, plan_hook


def plan_valve(setup: PlanSetup, solver: PhaseSolver, request: ValveRequest) -> TaskPlan:
    """Turn the valve of a request: detected in the scan, or given by centre, axis and radius."""
    raise NotImplementedError
