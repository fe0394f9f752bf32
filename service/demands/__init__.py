"""Demands of a request on its motion, and a recorded motion held to them; imports nothing that plans."""

from service.demands.distances import Distances, check_padding
from service.demands.held_motion import Demands, HeldMotion, compare_pace, hold_to_request
from service.demands.scene import compose_scene, find_recorded_obstacles, has_scan
from service.demands.stance import list_planted_feet
from service.demands.task_demand import TaskDemand, World

__all__ = [
    "Demands",
    "Distances",
    "HeldMotion",
    "TaskDemand",
    "World",
    "check_padding",
    "compare_pace",
    "compose_scene",
    "find_recorded_obstacles",
    "has_scan",
    "hold_to_request",
    "list_planted_feet",
]
