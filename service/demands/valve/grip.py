"""How a gripper holds the rim of a wheel: a finger on either side of it, in a gap between spokes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot.atlas.gripper import FINGER_WIDTH, LARGEST_OPENING, LEAST_OPENING, TOOL_FROM_END
from service.demands.hands import Hand
from service.demands.valve.wheel import TOUCH_DEPTH, Wheel
from service.request.tasks.valve import VALVE_LINK
from service.verify import RelativePoseTarget

OPEN_BESIDE = 0.014  # between a pad and the rim while the hand comes and goes [m]
CLOSED_BESIDE = 2.5e-3  # the same while it holds: the rim's bodies are polygons [m]
HUB_SPACE = 4e-3  # between the inner finger and the hub's body [m]
FINGER_TOLERANCE = 1e-3  # of a finger's place on its palm [m]
ABOVE = 0.03  # of the fingers' ends before the wheel's bodies, where the line begins [m]


@dataclass(frozen=True)
class GripPlace:
    """Place of a gripper on the rim; with the wheel at 0 its axes are those of the world.

    Attributes:
        place: (3,) of the tool, from the wheel's centre [m].
        rotation: (3, 3) rotation_wheel_tool: the fingers move along the radius.
        push: (3,) unit, direction of the force on the wheel, when it turns right-handed.
        arm: distance of the force from the axis [m].
        offset: (3,) from which a straight line leads to the place [m].
        opened, closed: values of each finger's joint [m].
    """

    place: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    push: Float[np.ndarray, "3"]
    arm: float
    offset: Float[np.ndarray, "3"]
    opened: float
    closed: float


def place_grip(wheel: Wheel, entry: float, is_flipped: bool) -> GripPlace | str:
    """Return where a gripper holds the rim, or a sentence why it cannot.

    Args:
        wheel: the wheel.
        entry: a gap of the wheel [rad].
        is_flipped: whether the hand is turned by half a turn: its first finger is then inside the rim.
    """
    opened = wheel.tube_radius + OPEN_BESIDE
    if opened > LARGEST_OPENING:
        return f"the rim is {2e3 * wheel.tube_radius:.0f} mm thick; the gripper opens to {2e3 * LARGEST_OPENING:.0f} mm"
    room = wheel.radius - opened - FINGER_WIDTH - wheel.hub
    if room < HUB_SPACE:
        return f"between hub and rim are {1e3 * (wheel.inner_radius - wheel.hub):.0f} mm; too little for a finger"
    radial = wheel.radial(entry)
    x = -radial if is_flipped else radial
    z = -wheel.axis
    reach = wheel.front + TOOL_FROM_END + ABOVE
    return GripPlace(
        wheel.radius * radial,
        np.stack([x, np.cross(z, x), z], axis=1),
        np.cross(wheel.axis, radial),
        wheel.radius,
        reach * wheel.axis,
        opened - LEAST_OPENING,
        max(wheel.tube_radius + CLOSED_BESIDE - LEAST_OPENING, 0.0),
    )


def make_grip_allowances(wheel: Wheel, hand: Hand) -> tuple[Allowance, ...]:
    """Return the allowances of fingers on the rim."""
    return tuple(
        Allowance(BodyRef.of_link(finger), BodyRef("mechanism", VALVE_LINK, body), TOUCH_DEPTH)
        for finger in hand.fingers
        for body in wheel.rim
    )


def make_finger_targets(hand: Hand, value: float) -> tuple[RelativePoseTarget, ...]:
    """Return the promises that both fingers stay on their palm where a value of their joints has them [m]."""
    return tuple(
        RelativePoseTarget(
            finger, hand.palm, np.array([sign * value, 0.0, 0.0]), np.eye(3), FINGER_TOLERANCE, FINGER_TOLERANCE
        )
        for finger, sign in zip(hand.fingers, (1.0, -1.0), strict=True)
    )
