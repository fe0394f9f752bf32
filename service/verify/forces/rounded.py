"""Convex bodies as rounded cores: smaller shapes within, whose distances and normals do not jump between facets."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import coal
import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from costs.robot import LinkBody
from service.verify.solids import make_coal_convex

MOST_ROUNDING_M = 5e-3  # of an edge of a polytope, which may stand for something round
ROUND_ROUNDING_M = 2e-3  # of an edge of a shape that is known to be round
BOX_ROUNDING_M = 2e-3  # of an edge of a box, and of what has no more corners
BOX_CORNERS = 8
ROUNDED_SHARE = 0.45  # of a body's least thickness


@dataclass(frozen=True, eq=False)
class RoundedBody:
    """A body as all points within ``radius`` of a core, but for its edges, which this rounds.

    The direction to the core from a point outside is the normal of the body's surface there: of a face the plane's, of
    a round shape the radius, whatever polytope stands for it elsewhere.

    Attributes:
        core: shape of coal.
        pose: of the core in the frame of the body's joint.
        radius: [m].
    """

    core: coal.ShapeBase
    pose: coal.Transform3s
    radius: float

    @staticmethod
    def of_body(body: LinkBody) -> RoundedBody:
        """Return the rounded body of a link's body, cached while that exists."""
        known = _BODIES.get(body)
        if known is None:
            known = _BODIES[body] = _round_body(body)
        return known


_BODIES: WeakKeyDictionary[LinkBody, RoundedBody] = WeakKeyDictionary()


def _round_body(body: LinkBody) -> RoundedBody:
    exact = body.exact
    if exact is None:
        points, radius = shrink_hull(body.vertices)
        return RoundedBody(make_coal_convex(points), coal.Transform3s(), radius)
    thickness = 2.0 * exact.radius if exact.kind != "cylinder" else min(2.0 * exact.radius, exact.length)
    radius = min(ROUND_ROUNDING_M, ROUNDED_SHARE * thickness)
    within = exact.radius - radius
    pose = coal.Transform3s(exact.pose[:3, :3], exact.pose[:3, 3])
    if exact.kind == "sphere":
        return RoundedBody(coal.Sphere(within), pose, radius)
    if exact.kind == "capsule":
        return RoundedBody(coal.Capsule(within, exact.length), pose, radius)
    return RoundedBody(coal.Cylinder(within, exact.length - 2.0 * radius), pose, radius)


def shrink_hull(vertices: Float[np.ndarray, "V 3"]) -> tuple[Float[np.ndarray, "W 3"], float]:
    """Return the points of a hull whose faces are moved inwards, and by how much [m]; a flat hull stays as it is."""
    try:
        planes = ConvexHull(vertices).equations
    except QhullError:
        return vertices, 0.0
    middle = vertices.mean(axis=0)
    width = np.ptp(vertices @ planes[:, :3].T, axis=0).min()
    room = -(planes[:, :3] @ middle + planes[:, 3]).max()
    most = BOX_ROUNDING_M if len(vertices) <= BOX_CORNERS else MOST_ROUNDING_M
    radius = float(min(most, ROUNDED_SHARE * width, 0.9 * room))
    moved = planes.copy()
    moved[:, 3] += radius
    corners = HalfspaceIntersection(moved, middle).intersections
    return corners[ConvexHull(corners).vertices], radius


def measure_beyond_hull(points: Float[np.ndarray, "K 3"], vertices: Float[np.ndarray, "V 3"]) -> float:
    """Return how far the outermost of some points is beyond the faces of a hull; negative inside [m]."""
    try:
        planes = ConvexHull(vertices).equations
    except QhullError:
        return float("inf")
    return float((points @ planes[:, :3].T + planes[:, 3]).max())
