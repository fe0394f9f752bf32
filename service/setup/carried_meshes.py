"""Meshes of carried bodies and movable objects, read into the request, whose hash then says everything."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from service.errors import RequestError
from service.request.attached import AttachedMesh, ConvexPart
from service.request.fields import Point
from service.request.scene import CarriedMesh, MovableMesh
from service.request.schema import PlanRequest

CONVEX_SHARE = 0.95  # of its hull that a mesh fills which fingers may hold


def inline_carried(request: PlanRequest) -> PlanRequest:
    """Return the request with the convex parts of its carried meshes and the corners of its movable ones.

    Raises:
        RequestError: one line; a file is missing or cannot be used, or a movable mesh is not convex.
    """
    attached = tuple(
        _read_parts(request, item, f"attached[{k}].file") if isinstance(item, AttachedMesh) and not item.parts else item
        for k, item in enumerate(request.attached)
    )
    objects = tuple(
        _read_corners(request, item, f"scene.objects[{k}].file")
        if isinstance(item, MovableMesh) and not item.points
        else item
        for k, item in enumerate(request.scene.objects)
    )
    if attached != request.attached:
        request = dataclasses.replace(request, attached=attached)
    if objects != request.scene.objects:
        request = dataclasses.replace(request, scene=dataclasses.replace(request.scene, objects=objects))
    return request


def _read_parts(request: PlanRequest, item: AttachedMesh, field: str) -> AttachedMesh:
    parts, _ = _split(request, item, field, decompose=item.decompose)
    return dataclasses.replace(item, parts=tuple(ConvexPart(_list_points(part)) for part in parts))


def _read_corners(request: PlanRequest, item: MovableMesh, field: str) -> MovableMesh:
    (hull,), share = _split(request, item, field, decompose=False)
    if share < CONVEX_SHARE:
        raise RequestError(
            f"{field}: {item.file} fills {100.0 * share:.0f} % of its convex hull; fingers hold only convex objects, "
            f"of at least {100.0 * CONVEX_SHARE:.0f} %: give the part that they hold as a box, cylinder or convex, "
            "or carry the mesh in `attached`"
        )
    return dataclasses.replace(item, points=_list_points(hull))


def _split(
    request: PlanRequest, item: CarriedMesh, field: str, *, decompose: bool
) -> tuple[list[Float[np.ndarray, "V 3"]], float]:
    """Return the convex parts of a mesh, and the share of its hull that it fills."""
    from service.scan.meshes import read_solid, split_convex

    path = request.resolve(item.file)
    solid = read_solid(path, field, item.scale, item.scale_xyz)
    return split_convex(solid, path.name, field, decompose=decompose), solid.hull_share


def _list_points(vertices: Float[np.ndarray, "V 3"]) -> tuple[Point, ...]:
    return tuple((x, y, z) for x, y, z in vertices.tolist())
