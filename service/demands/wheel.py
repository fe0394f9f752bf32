"""Demands of a valve task: the wheel as a joint, the hands that may turn it, and what they may touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import Mechanism, MechanismJoint
from service.demands.hands import Hand
from service.demands.phase_spec import AXIS, LINE_WAYPOINTS, REACH_WAYPOINTS, HandMotion, PhaseSpec
from service.request.names import VALVE_JOINT, VALVE_LINK
from service.verify import CircleTarget, HandLoad

if TYPE_CHECKING:
    from perception import ValveDetection

WHEEL_SPEED = 1.0  # [rad/s]
WHEEL_ACCELERATION = 2.0  # [rad/s^2]
RIM_TOLERANCE = 5e-3  # largest distance of the tool from its point of the rim [m]
AXIS_TOLERANCE = np.deg2rad(3.0)  # largest angle between the hand axis and the valve's
STANDOFF = 0.07  # of the tool from the wheel's plane before it is inserted, beyond the rim's tube [m]
TURN_STEP = np.deg2rad(20.0)  # between waypoints
TOUCH_RESERVE = 0.015  # the hook may be this much deeper in the rim than its half thickness [m]
HOOK_ROOM = 0.03  # from the rim's centre line inwards, free for the hook where spokes were not seen clearly [m]
MIN_HUB = 0.01  # [m]
GAPS_WITHOUT_SPOKES = np.deg2rad([0.0, 90.0, 180.0, 270.0])


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
        bodies: vertices in the world by body name.
        rim: names of the bodies that are the rim, which may be touched.
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    tube_radius: float
    start_direction: Float[np.ndarray, "3"]
    gaps: tuple[float, ...]
    bodies: Mapping[str, Float[np.ndarray, "V 3"]]
    rim: tuple[str, ...]

    def rim_point(self, angle: float) -> Float[np.ndarray, "3"]:
        """Return the point of the centre line at an angle, in the world [m]."""
        third = np.cross(self.axis, self.start_direction)
        return np.asarray(self.centre + self.radius * (np.cos(angle) * self.start_direction + np.sin(angle) * third))


def make_wheel(valve: ValveDetection) -> Wheel:
    """Return the wheel of a detected or given valve; its gaps in the order of their angles."""
    from perception import (  # slow to import, and needed for valves only
        has_clear_spokes,
        rim_bodies,
        valve_bodies,
        wheel_basis,
    )

    first, _, axis = wheel_basis(valve.axis)
    solids = valve_bodies(valve)
    if not has_clear_spokes(valve):
        solids["hub"] = _within(solids["hub"], valve, max(valve.rim_radius - HOOK_ROOM, MIN_HUB))
    bodies = {f"{VALVE_LINK}/{name}": vertices for name, vertices in solids.items()}
    rim = tuple(f"{VALVE_LINK}/{name}" for name in rim_bodies(valve))
    return Wheel(valve.centre, axis, valve.rim_radius, valve.tube_radius, first, _gaps(valve), bodies, rim)


def make_wheel_mechanism(wheel: Wheel) -> Mechanism:
    """Return the wheel as a mechanism whose only coordinate is its angle."""
    joint = MechanismJoint(
        VALVE_JOINT,
        VALVE_LINK,
        wheel.centre,
        wheel.axis,
        wheel.bodies,
        lower=-2.5 * np.pi,
        upper=2.5 * np.pi,
        velocity=WHEEL_SPEED,
        acceleration=WHEEL_ACCELERATION,
    )
    return Mechanism(VALVE_LINK, (joint,))


def make_hook_allowances(wheel: Wheel, hand: Hand) -> tuple[Allowance, ...]:
    """Return the allowances of a hook on the rim."""
    hook, depth = BodyRef.of_link(hand.hook), wheel.tube_radius + TOUCH_RESERVE
    return tuple(Allowance(hook, BodyRef("mechanism", VALVE_LINK, body), depth) for body in wheel.rim)


def make_stroke_phases(
    wheel: Wheel,
    hand: Hand,
    entry: float,
    turn: tuple[float, float],
    suffix: str = "",
    grasp: Grasp | None = None,
    torque_nm: float = 0.0,
    reach_waypoints: int = REACH_WAYPOINTS,
) -> tuple[PhaseSpec, ...]:
    """Return the phases of a stroke: reach, insert, turn, retract; the turn is solved first.

    Args:
        wheel, hand: the wheel and the hand that turns it.
        entry: angle of the hook's gap, in the wheel [rad].
        turn: angles of the wheel at the beginning and the end of the stroke [rad].
        suffix: ends the names of the phases; empty for a single stroke.
        grasp: of a hand that turns with the wheel; None for one that may turn about its axis.
        torque_nm: that turns the wheel.
        reach_waypoints: number of the first phase.
    """
    first, last = np.array(turn[:1]), np.array(turn[1:])
    place = wheel.rim_point(entry) - wheel.centre  # at angle 0 the wheel's frame has the axes of the world
    touches = make_hook_allowances(wheel, hand)
    off = (wheel.tube_radius + STANDOFF) * wheel.axis
    held = HandMotion(
        hand.tool, VALVE_LINK, place, -wheel.axis, tolerance_m=RIM_TOLERANCE, tilt_rad=AXIS_TOLERANCE,
        is_rigid=grasp is not None, rotation=None if grasp is None else grasp.rotation,
    )  # fmt: skip
    line = replace(held, offset=off, is_rigid=False, rotation=None)
    circle = CircleTarget(
        hand.tool, wheel.centre, wheel.axis, wheel.radius, RIM_TOLERANCE, -AXIS, AXIS_TOLERANCE
    )  # fmt: skip
    count = max(int(np.ceil(abs(turn[1] - turn[0]) / TURN_STEP)) + 1, 3)
    wrist = grasp or Grasp()
    turning = np.sign(turn[1] - turn[0]) * np.cross(wheel.axis, place) / (place @ place)
    load = HandLoad(hand.tool, VALVE_LINK, place, torque_nm * turning)
    return (
        PhaseSpec(f"reach{suffix}", first, first, n_waypoints=reach_waypoints),
        PhaseSpec(f"insert{suffix}", first, first, line, touches, n_waypoints=LINE_WAYPOINTS),
        PhaseSpec(
            f"turn{suffix}", first, last, held, touches, is_anchor=True, step="pose at the wheel", n_waypoints=count,
            loads=(load,), also=(circle,), fixed=wrist.fixed, guess_rates=wrist.rates,
        ),
        PhaseSpec(f"retract{suffix}", last, last, replace(line, leaves=True), touches, n_waypoints=LINE_WAYPOINTS),
    )  # fmt: skip


@dataclass(frozen=True)
class Grasp:
    """A hand that turns with the wheel.

    Attributes:
        rotation: (3, 3) rotation_valve_tool; None until the first pose decides it.
        fixed: value of the wrist's joint at the first pose [rad].
        rates: rate of the wrist's joint per angle of the wheel, for the first guess.
    """

    rotation: Float[np.ndarray, "3 3"] | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)


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
