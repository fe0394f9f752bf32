"""A request's movable objects with shape, mass and start."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from costs.primitive import make_round_shape
from costs.robot import shapes, spread_mass
from costs.robot.carried import MovableObject
from costs.rotation import pose_matrix
from service.errors import RequestError
from service.request.scene import ConvexRequest, MovableMesh, ObjectRequest
from service.request.schema import PlanRequest


def find_object(request: PlanRequest, name: str, field: str) -> tuple[ObjectRequest, MovableObject]:
    """Return one of a request's objects, as given and as a body.

    Raises:
        RequestError: there is none of that name, or its points have no volume.
    """
    for index, item in enumerate(request.scene.objects):
        if item.name == name:
            return item, make_object(item, f"scene.objects[{index}]")
    known = ", ".join(item.name for item in request.scene.objects) or "no object; give scene.objects"
    raise RequestError(f"{field}: unknown object {name!r}; the scene has {known}")


def make_object(item: ObjectRequest, field: str) -> MovableObject:
    """Return an object as a body.

    Raises:
        RequestError: its points have no volume.
    """
    if isinstance(item, ConvexRequest | MovableMesh):
        points = np.array(item.points)
        try:
            vertices = points[ConvexHull(points).vertices]
        except QhullError:
            raise RequestError(
                f"{field}.points: the {len(points)} points lie in a plane; expected four that span a volume"
            ) from None
    else:
        vertices = shapes.make_points(item.type, item.lengths)
    exact = make_round_shape(item.type, item.lengths)
    return MovableObject(
        item.name,
        vertices,
        spread_mass([vertices], item.mass_kg),
        pose_matrix(item.position, item.quaternion_wxyz),
        exact,
    )
