"""What a mechanism opposes to the hand that moves it, as a request describes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from costs.robot import LinkInertia

ASSUMED_DENSITY = 500.0  # of bodies whose mass nobody states [kg/m^3]
SPRING_TRAVEL = 0.01  # in which the force of a preloaded spring comes, to either side of its rest [rad, m]


@dataclass(frozen=True)
class Resistance:
    """Forces on a joint of a mechanism [N m, N].

    Attributes:
        friction: dry friction in either sense; it holds the joint where nobody pushes.
        preload: of the spring that pulls the joint back to its start, once it has left it.
        stiffness: increase of the spring's force per travel [N m/rad, N/m].
        damping: [N m s/rad, N s/m].
        rest: value at which the spring pulls no way; None for the value at the motion's start [rad, m].
    """

    friction: float = 0.0
    preload: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None


@dataclass(frozen=True)
class MechanismPhysics:
    """Physics of the mechanism of a result.

    Attributes:
        joints: resistance by joint; none where a joint is missing.
        growth_m: by which the recorded bodies are larger than the mechanism itself [m].
        is_gripped: whether a closed gripper holds the mechanism: it does not slip while its load acts.
        has_assumed_spokes: whether the hand presses a spoke that the plan assumes where the record shows none.
        inertias: by joint, mass of its link in the frame of the joint; the others have an assumed mass without weight.
    """

    joints: Mapping[str, Resistance]
    growth_m: float = 0.0
    is_gripped: bool = False
    has_assumed_spokes: bool = False
    inertias: Mapping[str, LinkInertia] = field(default_factory=dict)

    def has_spring(self, joint: str) -> bool:
        """Return whether a spring pulls a joint back."""
        resistance = self.joints.get(joint)
        return resistance is not None and bool(resistance.preload or resistance.stiffness)
