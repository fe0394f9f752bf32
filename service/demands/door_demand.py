"""What a door task demands of any motion: the door itself, and the choices that a plan may make."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry
from service.request.door import DoorRequest, HandleRequest

DEFAULT_LENGTHS = {"lever": 0.12, "pull": 0.3, "push_bar": 0.7, "knob": 0.06}


def read_given_door(request: DoorRequest, robot: Float[np.ndarray, "3"]) -> DoorGeometry | None:
    """Return the door that a request gives; None where the scan must show it.

    Args:
        request: the task.
        robot: (3,) place of the robot's base in the world, which tells the sides of the leaf apart [m].
    """
    leaf = request.leaf
    if leaf is None:
        return None
    hinge, edge = np.array(leaf.hinge), np.array(leaf.edge)
    along = (edge - hinge) * [1.0, 1.0, 0.0]
    width = float(np.linalg.norm(along))
    along = along / width
    normal = np.cross(UP, along)
    normal = normal if (robot - hinge) @ normal > 0.0 else -normal
    is_push = request.opens == "push"
    face = leaf.face_m if leaf.face_m is not None else (leaf.thickness_m if is_push else 0.0)
    return DoorGeometry(
        hinge,
        along,
        normal,
        face,
        width,
        leaf.height_m,
        leaf.thickness_m,
        "push" if is_push else "pull",
        float(np.deg2rad(leaf.ajar_deg)),
        None if request.handle is None else _read_handle(request.handle, along),
        0.0 if request.handle is None else float(np.deg2rad(request.handle.turned_deg)),
    )


def _read_handle(handle: HandleRequest, along: Float[np.ndarray, "3"]) -> HandleGeometry:
    default = {"lever": -along, "pull": UP, "push_bar": along, "knob": np.cross(UP, along)}[handle.kind]
    direction = default if handle.direction is None else np.array(handle.direction)
    length = DEFAULT_LENGTHS[handle.kind] if handle.length_m is None else handle.length_m
    direction = direction / np.linalg.norm(direction)
    return HandleGeometry(handle.kind, np.array(handle.centre), direction, length, handle.radius_m)
