"""Solids of objects that a user gives by parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from service.errors import RequestError
from service.request.object_file import read_object_file
from service.request.shapes import (
    BoxPart,
    CapsulePart,
    CylinderPart,
    LeverPart,
    ObjectRequest,
    PartRequest,
    WheelPart,
)

if TYPE_CHECKING:
    from perception.solids.mesh import Mesh, Solid


def read_object(path: Path, scale: float | Float[np.ndarray, "3"] = 1.0) -> Solid:
    """Read an object file.

    Args:
        scale: metres per unit of its lengths, one number or one for each axis; negative ones mirror.

    Raises:
        RequestError: one line per problem.
    """
    return make_object(read_object_file(path), path.name, scale)


def make_object(request: ObjectRequest, name: str, scale: float | Float[np.ndarray, "3"] = 1.0) -> Solid:
    """Return the solid of an object [m].

    Raises:
        RequestError: its sizes contradict each other.
    """
    from perception import PerceptionError, rigid_pose
    from perception.solids.shapes import unite_meshes

    meshes: list[Mesh] = []
    try:
        for part in request.parts:
            pose = rigid_pose((*part.position, *part.quaternion_wxyz))
            meshes += [mesh.place(pose) for mesh in _make_meshes(part)]
        return unite_meshes([mesh.stretch(scale) for mesh in meshes], name)
    except PerceptionError as error:
        raise RequestError(str(error)) from None


def _make_meshes(part: PartRequest) -> list[Mesh]:
    """Return the meshes of a part in its own frame [m]."""
    from perception.solids import shapes

    match part:
        case BoxPart():
            return shapes.make_box(part.size)
        case CylinderPart():
            return shapes.make_cylinder(part.radius, part.height)
        case CapsulePart():
            return shapes.make_capsule(part.radius, part.height)
        case WheelPart():
            return shapes.make_wheel(part.radius, part.rim_radius, part.spokes, part.spoke_radius, part.hub_radius)
        case LeverPart():
            return shapes.make_lever(part.length, part.radius, part.grip_length, part.grip_radius)
