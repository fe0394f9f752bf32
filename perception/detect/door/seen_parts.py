"""Rays of a scan at the parts of a door that a hand presses: the bar of its handle, and its leaf."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry
from perception.detect.door.model import find_leaf_axes
from perception.detect.shared.bars import Bar
from perception.detect.shared.seen_part import SeenPart, count_on_bar, count_on_face
from perception.sightlines import SightIndex

HANDLE_NAMES = {"lever": "lever", "pull": "pull handle", "push_bar": "push bar"}


def count_on_door(geometry: DoorGeometry, index: SightIndex, within: float) -> tuple[SeenPart, ...]:
    """Count the rays at leaf and handle in the pose in which they were seen.

    Places on the leaf are from its hinge axis and from its lower edge; on the bar of a lever from its spindle, on
    another bar from its middle.

    Args:
        within: distance from a surface, along the ray, within which a point lies on it [m].
    """
    along, normal = find_leaf_axes(geometry)
    to_seen = np.column_stack([along, normal, UP]) @ np.stack([geometry.along, geometry.normal, UP])
    corner = geometry.hinge + geometry.face * normal
    parts = [
        count_on_face("leaf", index, np.stack([along, UP, normal]), corner, (geometry.width, geometry.height), within)
    ]
    handle = geometry.handle
    if handle is not None and handle.kind in HANDLE_NAMES:
        bar = _place_bar(geometry, handle, to_seen)
        parts.append(count_on_bar(HANDLE_NAMES[handle.kind], index, bar, within))
    return tuple(parts)


def _place_bar(geometry: DoorGeometry, handle: HandleGeometry, to_seen: Float[np.ndarray, "3 3"]) -> Bar:
    """Return the bar of a handle where it was seen; ``to_seen`` turns the shut leaf to where it was seen."""
    direction, normal = handle.direction, geometry.normal
    if handle.kind == "lever":  # turned down from rest
        down = -np.sign(np.cross(normal, direction) @ UP) or 1.0
        direction = Rotation.from_rotvec(down * geometry.handle_turn * normal).apply(direction)
    centre = geometry.hinge + to_seen @ (handle.centre - geometry.hinge)
    frame = np.stack([direction, np.cross(normal, direction), normal]) @ to_seen.T
    if handle.kind == "push_bar":
        half = (0.5 * handle.height if handle.height is not None else handle.radius), handle.radius
        return Bar(frame, centre, half, -0.5 * handle.length, 0.5 * handle.length, "box")
    first, last = (0.0, handle.length) if handle.kind == "lever" else (-0.5 * handle.length, 0.5 * handle.length)
    return Bar(frame, centre, (handle.radius, handle.radius), first, last, "round")
