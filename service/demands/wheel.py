"""Demands of a valve task: the wheel as a joint, the hands that may turn it, and what they may touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import RobotModel, with_revolute
from service.request.names import VALVE_JOINT, VALVE_LINK
from service.verify import CircleTarget, JointTarget, RelativePoseTarget, Target

if TYPE_CHECKING:
    from perception import ValveDetection

WHEEL_SPEED = 1.0  # [rad/s]
WHEEL_ACCELERATION = 2.0  # [rad/s^2]
HAND_AXIS = np.array([0.0, 0.0, 1.0])  # in the tool frame
RIM_TOLERANCE = 5e-3  # largest distance of the tool from its point of the rim [m]
AXIS_TOLERANCE = np.deg2rad(3.0)  # largest angle between the hand axis and the valve's
ANGLE_TOLERANCE = 1e-3  # largest error of the wheel's angle at the end of a stroke [rad]
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


@dataclass(frozen=True)
class Hand:
    """Hand with its hook.

    Attributes:
        side: ``left`` or ``right``.
        tool: frame at the hook's end, z along the hand axis outwards.
        hook: link that may touch the rim.
    """

    side: str
    tool: str
    hook: str


HANDS = {"left": Hand("left", "l_tool", "l_hook"), "right": Hand("right", "r_tool", "r_hook")}


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


def add_wheel_joint(robot: RobotModel, wheel: Wheel) -> RobotModel:
    """Return the robot with the wheel's angle as its last coordinate."""
    return with_revolute(
        robot,
        name=VALVE_JOINT,
        origin=wheel.centre,
        axis=wheel.axis,
        bodies=wheel.bodies,
        link=VALVE_LINK,
        lower=-2.5 * np.pi,
        upper=2.5 * np.pi,
        velocity=WHEEL_SPEED,
        acceleration=WHEEL_ACCELERATION,
    )


def make_hook_allowances(wheel: Wheel, hand: Hand) -> tuple[Allowance, ...]:
    """Return the allowances of a hook on the rim."""
    hook, depth = BodyRef.of_link(hand.hook), wheel.tube_radius + TOUCH_RESERVE
    return tuple(Allowance(hook, BodyRef("mechanism", VALVE_LINK, body), depth) for body in wheel.rim)


def make_stroke_targets(
    wheel: Wheel, hand: Hand, entry: float, angle: float, at: float, grasp: Float[np.ndarray, "3 3"] | None = None
) -> tuple[Target, ...]:
    """Return the targets of a stroke: the tool moves with its point of the rim, and the wheel ends at an angle.

    Args:
        entry: angle of the hook's gap, in the wheel [rad].
        angle: angle of the wheel at the end of the stroke [rad].
        at: path parameter of that end.
        grasp: rotation_valve_tool of a hand that turns with the wheel; None for one that may turn about its axis.
    """
    # At angle 0 the wheel's frame has the axes of the world and its origin in the centre.
    along = find_rotation_onto(HAND_AXIS, -wheel.axis) if grasp is None else grasp
    free = HAND_AXIS if grasp is None else None
    place = wheel.rim_point(entry) - wheel.centre
    return (
        CircleTarget(hand.tool, wheel.centre, wheel.axis, wheel.radius, RIM_TOLERANCE, -HAND_AXIS, AXIS_TOLERANCE),
        RelativePoseTarget(hand.tool, VALVE_LINK, place, along, RIM_TOLERANCE, AXIS_TOLERANCE, free),
        JointTarget(VALVE_JOINT, angle, ANGLE_TOLERANCE, at),
    )


def find_rotation_onto(axis: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation that takes the unit vector ``axis`` to the unit vector ``direction``."""
    if axis @ direction < 0.0:  # half a turn first: the formula fails for opposite vectors
        side = np.eye(3)[int(np.abs(axis).argmin())]
        normal = np.cross(axis, side) / np.linalg.norm(np.cross(axis, side))
        flip = 2.0 * np.outer(normal, normal) - np.eye(3)
        return np.asarray(find_rotation_onto(flip @ axis, direction) @ flip)
    w = np.cross(axis, direction)
    skew = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + axis @ direction))


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
