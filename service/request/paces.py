"""Paces of a motion: how fast it goes, and what it has to leave of torques and of the balance point's room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class PaceRules:
    """What a pace means.

    Attributes:
        velocity_scale, acceleration_scale: shares of the robot's limits that are used.
        torque_share: largest share of a joint's torque that the motion may need.
        zmp_inside_m: distance that the ZMP of the full dynamics keeps inside the feet [m].
        zmp_reserve_m: that the planner aims at, at most half of what the resting robot has [m].
    """

    velocity_scale: float
    acceleration_scale: float
    torque_share: float
    zmp_inside_m: float
    zmp_reserve_m: float


PACES: Mapping[str, PaceRules] = MappingProxyType({
    "careful": PaceRules(0.25, 0.12, 0.85, 0.008, 0.020),
    "normal": PaceRules(0.5, 0.3, 0.92, 0.005, 0.015),
    "fast": PaceRules(0.95, 0.8, 0.97, 0.002, 0.010),
})  # fmt: skip
