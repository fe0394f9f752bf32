"""How a hand pulls a door open that stands ajar: its rod behind the free edge of the leaf, at the edge's back corner.

The rod reaches around the edge, points to the hinge and leans off the leaf's back, so that it touches nothing but the
corner; the hand stays beyond the edge.  The force is square to the rod, and nearly along the way of the corner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from perception.detect.door.bodies import LEAF_LINK
from perception.detect.door.geometry import UP, DoorGeometry
from service.demands.hands import Hand
from service.demands.phase import FrameMotion
from service.verify import HandLoad

if TYPE_CHECKING:
    from service.demands.door.phases import Push

EDGE_LEAN, EDGE_TILT = np.deg2rad(6.0), np.deg2rad(5.0)  # of the rod off the leaf's back, and from its place
TILT_RESERVE = np.deg2rad(2.0)
MOST_SLANT = np.deg2rad(40.0)  # of the rod against the horizontal
SLANT_DIGITS = 6  # decimals of the slant [rad]
EDGE_SPACE = 1e-3  # between the rod and the corner [m]
PLACE_TOLERANCE = 5e-3  # [m]
LINE_OUT, LINE_BEHIND = 0.09, 0.03  # of the line that leads to the edge: beyond it, and behind the leaf [m]
GAP_RESERVE = 0.02  # beside the hand in the gap between edge and frame [m]


def hold_edge(geometry: DoorGeometry, push: Push) -> tuple[FrameMotion, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the hold of the edge, the offset of the line that leads there, and the unit normal of the contact.

    All are in the leaf's link.

    Args:
        geometry: leaf and handle.
        push: height and slant of the rod, and the hand.
    """
    slant = round(push.slant or 0.0, SLANT_DIGITS) + 0.0  # a record gives it up to rounding
    level = -np.cos(EDGE_LEAN) * geometry.along - np.sin(EDGE_LEAN) * geometry.normal
    axis = np.cos(slant) * level + np.sin(slant) * UP
    normal = np.cross(level, UP)
    normal = normal * np.sign(normal @ geometry.normal)
    corner = find_corner(geometry) + push.up * UP
    place = corner - (push.hand.peg_radius + EDGE_SPACE) * normal
    motion = FrameMotion(
        push.hand.peg, LEAF_LINK, place, axis, tolerance_m=PLACE_TOLERANCE, tilt_rad=float(EDGE_TILT),
        aim_rad=float(EDGE_TILT - TILT_RESERVE),
    )  # fmt: skip
    return motion, -LINE_OUT * axis - LINE_BEHIND * geometry.normal, normal


def find_corner(geometry: DoorGeometry) -> Float[np.ndarray, "3"]:
    """Return the back corner of the leaf's free edge at its lower end, from the hinge, with the leaf shut [m]."""
    return np.asarray(geometry.width * geometry.along + (geometry.face - geometry.thickness) * geometry.normal)


def make_edge_load(
    geometry: DoorGeometry, motion: FrameMotion, normal: Float[np.ndarray, "3"], hinge_nm: float
) -> HandLoad:
    """Return the force at the edge that opens the leaf against a torque at its hinge."""
    arm = float(np.cross(motion.place, normal) @ geometry.hinge_axis)
    return HandLoad(motion.tool, LEAF_LINK, motion.place, hinge_nm / arm * normal)


def measure_edge_gap(geometry: DoorGeometry, opening: float) -> float:
    """Return the width of the gap behind the free edge's back corner, out of the plane of the shut leaf's back [m]."""
    back = geometry.thickness - geometry.face  # of the leaf behind the hinge axis
    return float(geometry.width * np.sin(opening) + back * (1.0 - np.cos(opening)))


def measure_edge_room(robot: RobotModel, hand: Hand) -> float:
    """Return the width of the gap that a hand needs beyond the edge, its rod on the way to the back corner [m]."""
    model = robot.model
    stub = model.frames[model.getFrameId(hand.stub)]
    widest = hand.peg_radius
    for body in robot.bodies:
        if body.link in (hand.link, hand.hook) and body.joint == stub.parentJoint:
            local = (body.vertices - stub.placement.translation) @ stub.placement.rotation
            widest = max(widest, float(np.hypot(local[:, 0], local[:, 1]).max()))
    return hand.peg_radius + EDGE_SPACE + LINE_BEHIND + widest + GAP_RESERVE
