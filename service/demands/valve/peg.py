"""Where a hook's peg holds a wheel: between two spokes, its side on the one that it pushes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from service.demands.hands import FREE_BEFORE, PEG_FROM_END, Hand
from service.demands.valve.wheel import TOUCH_DEPTH, Spoke, Wheel, wrap_angle
from service.request.tasks.valve import VALVE_LINK

PEG_SPACE = 5e-4  # between the peg and the spoke that it presses: the hand leans a little [m]
RIM_SPACE, LEAST_RIM_SPACE = 0.006, 0.003  # between the peg and the rim's inner edge, wanted and least [m]
HUB_SPACE, LEAST_HUB_SPACE = 0.008, 0.005  # between the peg and the hub's body, wanted and least [m]
LEAST_GAP = 0.012  # free beside the peg, towards the next spoke [m]
AWAY, AWAY_SHARE = 0.05, 0.5  # of the line that leads to the spoke, sideways: most, and of what is free [m]
FRONT_SPACE = 0.012  # between the hand's front and the wheel's bodies [m]
LEAST_BEYOND = 5e-3  # of the peg's end beyond the rim's plane [m]
BEYOND_BAR = 4e-3  # of the peg's end beyond a lever, towards what is behind it [m]
ABOVE = 0.03  # of the peg's end before the wheel's bodies, where the line begins [m]


@dataclass(frozen=True)
class PegPlace:
    """Place of a peg in a wheel; with the wheel at 0 its axes are those of the world.

    Attributes:
        place: (3,) of the peg's middle, from the wheel's centre [m].
        push: (3,) unit, direction of the force on the wheel.
        arm: distance of the force from the axis [m].
        offset: (3,) from which a straight line leads to the place without touching the spoke before [m].
        spoke: the spoke that is pressed; None where spokes are not known.
    """

    place: Float[np.ndarray, "3"]
    push: Float[np.ndarray, "3"]
    arm: float
    offset: Float[np.ndarray, "3"]
    spoke: Spoke | None


def place_peg(wheel: Wheel, hand: Hand, entry: float, sense: float) -> PegPlace | str:
    """Return where a peg pushes a wheel, or a sentence why it cannot.

    The peg passes through the wheel near the rim.  Where spokes are known, its side lies on the face of the spoke at
    ``entry`` that it moves towards; elsewhere it is at ``entry`` itself, and the spoke that it meets is assumed.

    Args:
        wheel, hand: the wheel, and the hand with its peg.
        entry: one of the wheel's entries in hook mode [rad].
        sense: 1 if the wheel turns right-handed about its axis, else -1.
    """
    if wheel.is_lever:
        return _place_beside_lever(wheel, hand, sense)
    radius = hand.peg_radius
    farthest = wheel.inner_radius - radius - LEAST_RIM_SPACE
    nearest = wheel.hub + radius + LEAST_HUB_SPACE
    if farthest < nearest:
        room = max(farthest - nearest + 2.0 * radius, 0.0)
        return f"between hub and rim are {1e3 * room:.0f} mm, the peg of the hook needs {2e3 * radius:.0f} mm"
    distance = min(max(wheel.inner_radius - radius - RIM_SPACE, wheel.hub + radius + HUB_SPACE), farthest)
    height = max(0.0, wheel.front + FRONT_SPACE - FREE_BEFORE)
    if height > PEG_FROM_END - LEAST_BEYOND:
        return f"the wheel stands {wheel.front:.3f} m out before its rim; the peg of the hook does not reach behind it"
    out = (wheel.front + PEG_FROM_END + ABOVE - height) * wheel.axis
    spoke = next((spoke for spoke in wheel.spokes if spoke.angle == entry), None)
    if spoke is None:
        direction = wheel.radial(entry)
        push = sense * np.cross(wheel.axis, direction)
        return PegPlace(distance * direction + height * wheel.axis, push, distance, out, None)
    aside = spoke.half_width + radius + PEG_SPACE
    if distance <= aside:
        return f"the spokes are too wide for the peg of the hook: {2e3 * spoke.half_width:.0f} mm"
    free = distance * _free_angle(wheel, spoke, sense) - 2.0 * (aside + radius)
    if free < LEAST_GAP:
        return f"beside the peg of the hook would be {1e3 * max(free, 0.0):.0f} mm to the next spoke; too little"
    off = np.arcsin(aside / distance)
    away = min(AWAY, AWAY_SHARE * free) / distance
    flat = distance * wheel.radial(entry - sense * off)
    apart = distance * wheel.radial(entry - sense * (off + away))
    push = sense * np.cross(wheel.axis, wheel.radial(entry))
    arm = float(np.sqrt(distance**2 - aside**2))
    return PegPlace(flat + height * wheel.axis, push, arm, apart - flat + out, spoke)


def _place_beside_lever(wheel: Wheel, hand: Hand, sense: float) -> PegPlace | str:
    """Return where a peg pushes a lever near its end, or a crank's grip; a sentence where it cannot."""
    radius, (bar,) = hand.peg_radius, wheel.spokes
    aside = bar.half_width + radius + PEG_SPACE
    nearest = wheel.hub + radius + LEAST_HUB_SPACE
    if wheel.radius < nearest:
        return f"the lever leaves {1e3 * wheel.radius:.0f} mm from its spindle to push at; expected {1e3 * nearest:.0f}"
    least = max(0.0, wheel.front + FRONT_SPACE - FREE_BEFORE)  # the hand's front stays before the lever
    height = least if wheel.grip > 0.0 else max(least, PEG_FROM_END - bar.half_width - BEYOND_BAR)
    if wheel.grip == 0.0 and height > PEG_FROM_END - LEAST_BEYOND:
        return f"the valve stands {wheel.front:.3f} m out before its lever; the peg of the hook does not reach it"
    direction = wheel.radial(bar.angle)
    push = sense * np.cross(wheel.axis, direction)
    out = (wheel.front + PEG_FROM_END + ABOVE - height) * wheel.axis
    place = wheel.radius * direction - aside * push + height * wheel.axis
    return PegPlace(place, push, wheel.radius, out - AWAY * push, bar)


def make_peg_allowances(wheel: Wheel, hand: Hand, held: PegPlace) -> tuple[Allowance, ...]:
    """Return the allowances of a peg at its place: the spoke that it presses, and the rim."""
    bodies = (*([] if held.spoke is None else [held.spoke.body]), *wheel.rim)
    hook = BodyRef.of_link(hand.hook)
    return tuple(Allowance(hook, BodyRef("mechanism", VALVE_LINK, body), TOUCH_DEPTH) for body in bodies)


def _free_angle(wheel: Wheel, spoke: Spoke, sense: float) -> float:
    """Return the angle between the middle of a spoke and that of the next one against the sense of the turn [rad]."""
    others = [sense * wrap_angle(spoke.angle - other.angle) for other in wheel.spokes if other is not spoke]
    return min((angle if angle > 0.0 else angle + 2.0 * np.pi for angle in others), default=2.0 * np.pi)
