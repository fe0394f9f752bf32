"""Demands of a request on its motion, and a recorded motion held to them; imports nothing that plans."""

from service.demands.demand import Demands
from service.demands.differences import compare_pace
from service.demands.holding import HeldMotion, hold_to_request
from service.demands.program import ProgramDemand
from service.demands.recorded_turn import compare_turn
from service.demands.scene import compose_scene, find_recorded_obstacles, has_scan
from service.demands.stance import list_planted_feet

__all__ = [
    "Demands",
    "HeldMotion",
    "ProgramDemand",
    "compare_pace",
    "compare_turn",
    "compose_scene",
    "find_recorded_obstacles",
    "has_scan",
    "hold_to_request",
    "list_planted_feet",
]
