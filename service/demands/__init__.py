"""What a request demands of a motion, free of everything that plans: the verifier's side of a request."""

from service.demands.demand import Demands
from service.demands.differences import pace_differences
from service.demands.holding import Held, hold_to_request
from service.demands.program import ProgramDemand
from service.demands.stance import planted_feet
from service.demands.turning import turned_differences
from service.demands.world import compose_scene, has_scan, recorded_obstacles

__all__ = [
    "Demands",
    "Held",
    "ProgramDemand",
    "compose_scene",
    "has_scan",
    "hold_to_request",
    "pace_differences",
    "planted_feet",
    "recorded_obstacles",
    "turned_differences",
]
