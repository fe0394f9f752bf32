"""The wheel of a valve task: its contact surface, its collision bodies, and the wheel as a joint.

The contact surface is the wheel as it was seen or given; the collision bodies contain it grown by ``GROWTH_M``.  A hand
presses the surface, so that it is as deep in a body as the body is grown; everything else keeps clear of the bodies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism, MechanismJoint
from service.request.names import VALVE_JOINT, VALVE_LINK

if TYPE_CHECKING:
    from perception import ValveDetection

Mode = Literal["hook", "grasp"]

WHEEL_SPEED = 1.0  # [rad/s]
WHEEL_ACCELERATION = 2.0  # [rad/s^2]
GROWTH_M = 4e-3  # of the collision bodies beyond the contact surface [m]
TOUCH_DEPTH = GROWTH_M + 2e-3  # allowed in a grown body: at most 2 mm beyond the contact surface [m]
MIN_HUB = 0.01  # [m]
GAPS_WITHOUT_SPOKES = np.deg2rad([0.0, 90.0, 180.0, 270.0])
LEAST_RANGE = 2.5 * np.pi  # of the wheel's joint to either side [rad]
RANGE_BEYOND = 0.5 * np.pi  # the turn [rad]
# From the rim's inner edge inwards, free for the hand where spokes were not seen clearly [m].
ROOMS: Mapping[Mode, float] = {"hook": 0.034, "grasp": 0.036}


@dataclass(frozen=True)
class Spoke:
    """A spoke of a wheel.

    Attributes:
        angle: about the axis, in the wheel [rad].
        half_width: of its contact surface, to either side of its middle [m].
        body: name of its collision body.
    """

    angle: float
    half_width: float
    body: str


@dataclass(frozen=True)
class Wheel:
    """Wheel of a valve.

    Attributes:
        centre: (3,) of the rim's centre-line circle, in the world [m].
        axis: (3,) unit, towards the robot.
        radius: radius of the centre line [m].
        tube_radius: half the rim's thickness [m].
        start_direction: (3,) unit, perpendicular to the axis, where the angle about it is zero.
        gaps: angles at which there is no spoke, best first [rad].
        bodies: vertices of the collision bodies in the world by name.
        rim: names of the bodies that are the rim.
        spokes: best first; empty where they were not seen clearly.
        hub: largest distance of the hub's body from the axis [m].
        front: highest place of a body along the axis, from the rim's centre [m].
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    tube_radius: float
    start_direction: Float[np.ndarray, "3"]
    gaps: tuple[float, ...]
    bodies: Mapping[str, Float[np.ndarray, "V 3"]]
    rim: tuple[str, ...]
    spokes: tuple[Spoke, ...] = ()
    hub: float = 0.0
    front: float = 0.0

    @property
    def inner_radius(self) -> float:
        """Radius of the rim's inner edge [m]."""
        return self.radius - self.tube_radius

    def radial(self, angle: float) -> Float[np.ndarray, "3"]:
        """Return the unit direction from the axis to an angle, in the world."""
        third = np.cross(self.axis, self.start_direction)
        return np.asarray(np.cos(angle) * self.start_direction + np.sin(angle) * third)

    def rim_point(self, angle: float) -> Float[np.ndarray, "3"]:
        """Return the point of the centre line at an angle, in the world [m]."""
        return np.asarray(self.centre + self.radius * self.radial(angle))

    def list_entries(self, mode: Mode) -> tuple[float, ...]:
        """Return the angles at which a hand may enter: spokes that a hook presses, else the gaps [rad]."""
        if mode == "hook" and self.spokes:
            return tuple(spoke.angle for spoke in self.spokes)
        return self.gaps


def make_wheel(valve: ValveDetection, mode: Mode) -> Wheel:
    """Return the wheel of a detected or given valve; spokes and gaps in the order of their angles."""
    from perception import (  # slow to import, and needed for valves only
        has_clear_spokes,
        rim_bodies,
        valve_bodies,
        wheel_basis,
    )

    first, _, axis = wheel_basis(valve.axis)
    solids = valve_bodies(valve, margin=GROWTH_M)
    spokes: tuple[Spoke, ...] = ()
    if has_clear_spokes(valve):
        spokes = tuple(
            Spoke(float(angle), valve.spoke_half_width, f"{VALVE_LINK}/spoke/{index}")
            for index, angle in enumerate(valve.spoke_angles)
        )
    else:
        free = valve.rim_radius - valve.tube_radius - ROOMS[mode]
        solids["hub"] = _within(solids["hub"], valve, max(free, MIN_HUB))
    heights = np.concatenate([(vertices - valve.centre) @ axis for vertices in solids.values()])
    offset = solids["hub"] - valve.centre
    hub = float(np.linalg.norm(offset - (offset @ axis)[:, None] * axis, axis=1).max())
    return Wheel(
        valve.centre,
        axis,
        valve.rim_radius,
        valve.tube_radius,
        first,
        _gaps(valve),
        {f"{VALVE_LINK}/{name}": vertices for name, vertices in solids.items()},
        tuple(f"{VALVE_LINK}/{name}" for name in rim_bodies(valve)),
        spokes,
        hub,
        float(heights.max()),
    )


def make_wheel_mechanism(wheel: Wheel, turn: float) -> Mechanism:
    """Return the wheel as a mechanism whose only coordinate is its angle, with room for a turn [rad]."""
    most = max(LEAST_RANGE, abs(turn) + RANGE_BEYOND)
    joint = MechanismJoint(
        VALVE_JOINT,
        VALVE_LINK,
        wheel.centre,
        wheel.axis,
        wheel.bodies,
        lower=-most,
        upper=most,
        velocity=WHEEL_SPEED,
        acceleration=WHEEL_ACCELERATION,
    )
    return Mechanism(VALVE_LINK, (joint,))


def wrap_angle(angle: float) -> float:
    """Return an angle between -pi and pi [rad]."""
    return float(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi)


def _within(disc: Float[np.ndarray, "V 3"], valve: ValveDetection, radius: float) -> Float[np.ndarray, "V 3"]:
    """Return a body of the wheel, scaled towards the axis until it fits within a radius."""
    offset = disc - valve.centre
    height = (offset @ valve.axis)[:, None] * valve.axis
    flat = offset - height
    largest = float(np.linalg.norm(flat, axis=1).max())
    return np.asarray(valve.centre + height + flat * min(1.0, radius / largest))


def _gaps(valve: ValveDetection) -> tuple[float, ...]:
    """Return the angles half-way between neighbouring spokes."""
    if not valve.spoke_angles:
        return tuple(float(angle) for angle in GAPS_WITHOUT_SPOKES)
    spokes = np.sort(np.mod(valve.spoke_angles, 2.0 * np.pi))
    widths = np.diff(np.append(spokes, spokes[0] + 2.0 * np.pi))
    return tuple(float(angle) for angle in spokes + 0.5 * widths)
