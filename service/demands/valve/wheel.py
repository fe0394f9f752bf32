"""The wheel of a valve task: its contact surface, its collision bodies, and the wheel as a joint.

The contact surface is the wheel as it was seen or given; the collision bodies contain it grown by ``GROWTH_M``.  A hand
presses the surface, so that it is as deep in a body as the body is grown; everything else keeps clear of the bodies.
The lever of a valve is a wheel with one spoke, without a rim, between its stops; a crank has a grip at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism, MechanismJoint
from service.request.tasks.valve import VALVE_JOINT, VALVE_LINK, ValveRequest

if TYPE_CHECKING:
    from perception import LeverDetection, SeenPart, ValveDetection

Mode = Literal["hook", "grasp"]

WHEEL_SPEED = 1.0  # [rad/s]
WHEEL_ACCELERATION = 2.0  # [rad/s^2]
GROWTH_M = 4e-3  # of the collision bodies beyond the contact surface [m]
TOUCH_DEPTH = GROWTH_M + 2e-3  # allowed in a grown body: at most 2 mm beyond the contact surface [m]
MIN_HUB = 0.01  # [m]
GAPS_WITHOUT_SPOKES = np.deg2rad([0.0, 90.0, 180.0, 270.0])
LEAST_RANGE = 2.5 * np.pi  # of the wheel's joint to either side [rad]
RANGE_BEYOND = 0.5 * np.pi  # the turn [rad]
QUARTER = 0.5 * np.pi  # by which a lever turns between its stops [rad]
STOP_ROUNDING = 2e-3  # by which a lever may pass its stop [rad]
FROM_END = 0.03  # of the peg at a lever's side, from the lever's end [m]
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
        stops: least and largest angle of a lever from where it is; None for what turns freely [rad].
        is_lever: whether it is a lever or a crank; ``radius`` is then where the hand presses the only spoke, the bar
            or the crank's grip, and ``rim`` is what else the hand may touch.
        grip: length of a crank's grip along the axis, from the bar; 0 without one [m].
        seen: parts of it that the scan shows, with their counts; None where the request gives the wheel.
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
    stops: tuple[float, float] | None = None
    is_lever: bool = False
    grip: float = 0.0
    seen: tuple[SeenPart, ...] | None = None

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


def make_wheel(
    valve: ValveDetection | LeverDetection, request: ValveRequest, seen: tuple[SeenPart, ...] | None = None
) -> Wheel:
    """Return the wheel, or the lever, of a detected or given valve; spokes and gaps in the order of their angles.

    Args:
        valve, request: the valve and the task.
        seen: parts that the scan shows; None where the request gives the valve.
    """
    from perception import (  # slow to import, and needed for valves only
        LeverDetection,
        has_clear_spokes,
        rim_bodies,
        valve_bodies,
        wheel_basis,
    )

    if isinstance(valve, LeverDetection):
        return replace(_make_lever(valve, request), seen=seen)
    mode = request.mode
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
        seen=seen,
    )


def _make_lever(lever: LeverDetection, request: ValveRequest) -> Wheel:
    """Return a lever or a crank as a wheel with one spoke."""
    from perception import lever_bodies, wheel_basis

    first, _, axis = wheel_basis(lever.axis)
    solids = lever_bodies(lever, margin=GROWTH_M)
    has_grip = lever.grip_length > 0.0
    heights = np.concatenate([(vertices - lever.centre) @ axis for vertices in solids.values()])
    half = max(lever.radius, lever.grip_radius) if has_grip else lever.radius
    return Wheel(
        lever.centre,
        axis,
        lever.length if has_grip else lever.length - FROM_END,
        0.0,
        first,
        (),
        {f"{VALVE_LINK}/{name}": vertices for name, vertices in solids.items()},
        (f"{VALVE_LINK}/bar",) if has_grip else (),
        (Spoke(lever.angle, half, f"{VALVE_LINK}/{'grip' if has_grip else 'bar'}"),),
        lever.hub_radius + GROWTH_M,
        float(heights.max()),
        find_stops(request, has_grip=has_grip),
        is_lever=True,
        grip=lever.grip_length,
    )


def find_stops(request: ValveRequest, *, has_grip: bool) -> tuple[float, float] | None:
    """Return the angles at which a lever stops, from where it is; None for a crank without stops [rad].

    Stops that the request does not state are a quarter turn from where the lever is: on the side of the turn, or on
    both sides where it is tried or rocked against the turn as well.
    """
    if request.stops_deg is not None:
        low, high = np.deg2rad(request.stops_deg).tolist()
        return low, high
    if has_grip:
        return None
    is_both = request.sense == "unknown" or request.stuck
    return (
        -QUARTER if is_both or request.turn_deg < 0.0 else 0.0,
        QUARTER if is_both or request.turn_deg > 0.0 else 0.0,
    )


def make_wheel_mechanism(wheel: Wheel, turn: float) -> Mechanism:
    """Return the wheel as a mechanism whose only coordinate is its angle.

    It has room for a turn [rad]; a lever turns between its stops.
    """
    most = max(LEAST_RANGE, abs(turn) + RANGE_BEYOND)
    low, high = (-most, most) if wheel.stops is None else wheel.stops
    beyond = 0.0 if wheel.stops is None else STOP_ROUNDING
    joint = MechanismJoint(
        VALVE_JOINT,
        VALVE_LINK,
        wheel.centre,
        wheel.axis,
        wheel.bodies,
        lower=low - beyond,
        upper=high + beyond,
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
