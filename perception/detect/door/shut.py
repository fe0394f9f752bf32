"""Geometry of a door with its leaf shut, from its leaf and handle as they were seen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from perception.detect.door.bodies import HOUSING_HALF_WIDTH
from perception.detect.door.frame import Frame
from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry, Opens
from perception.detect.door.handle import Handle
from perception.detect.door.leaf import Leaf
from perception.detect.door.model import USUAL_THICKNESS

_OVER_FLOOR = 0.008
_KNOB_DEPTH = 0.04


def shut_leaf(
    leaf: Leaf,
    frame: Frame | None,
    handle: Handle | None,
    pose: Float[np.ndarray, "4 4"],
    sizes: Mapping[str, float],
    opens: Opens | None,
    ground: float,
) -> DoorGeometry:
    """Return the door with its leaf shut.

    Args:
        handle: on the seen face.
        pose, sizes: of the detection.
        ground: height of the floor [m].
    """
    is_ajar = frame is not None and frame.hinge != 0
    along, normal = pose[:3, 0], sizes["side"] * pose[:3, 1]
    shows_far_face = False  # the one that is away from the robot when the leaf is shut
    if frame is not None and is_ajar:
        along = frame.plane.along * np.sign(frame.plane.along @ along)
        normal = frame.plane.normal
        out = -1.0 if frame.opens_away else 1.0
        opened = np.cos(frame.ajar) * normal - out * np.sin(frame.ajar) * along
        shows_far_face = bool(opened @ leaf.plane.normal < 0.0)
    thickness = USUAL_THICKNESS
    # The hinge pin is on the face to which the leaf turns.
    face = thickness if opens == "push" else 0.0
    corner = pose[:3, 3] - [0.0, 0.0, pose[2, 3] - ground - _OVER_FLOOR]
    pin = corner - (thickness - face if shows_far_face else face) * leaf.plane.normal
    held = None
    if handle is not None and not shows_far_face:
        below = pin + face * normal - [0.0, 0.0, _OVER_FLOOR]
        held = _handle_geometry(handle, sizes, below, along, normal)
    width, height = sizes["width"], sizes["height"] - _OVER_FLOOR
    ajar = sizes["ajar"] if is_ajar else 0.0
    turn = sizes.get("handle_turn_rad", 0.0) if held is not None else 0.0
    return DoorGeometry(pin, along, normal, face, width, height, thickness, opens, ajar, held, turn)


def _handle_geometry(
    handle: Handle,
    sizes: Mapping[str, float],
    corner: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> HandleGeometry:
    """Return the handle on the shut leaf, whose hinge edge meets the floor at ``corner``."""
    centre = corner + sizes["handle_x"] * along + handle.out * normal + sizes["handle_z"] * UP
    bar = handle.bar
    if bar is None:
        width, height = handle.high - handle.low
        # The measured extent leaves off 2 % at each end, and holds both housings.
        length = float(width / 0.96) - 2.0 * HOUSING_HALF_WIDTH
        return HandleGeometry("push_bar", centre, along, length, 0.5 * min(float(height), 0.03), float(height))
    if handle.is_lever:
        direction = along * sizes["lever_direction"]
        return HandleGeometry("lever", centre, direction, sizes["handle_length"], bar.radius)
    if handle.is_pull:
        return HandleGeometry("pull", centre, UP, bar.length, bar.radius)
    return HandleGeometry("knob", centre, normal, _KNOB_DEPTH, bar.radius + 0.5 * bar.axis_length)
