"""Convex bodies as rounded cores: smaller shapes within, whose distances and normals do not jump between facets."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import coal
import numpy as np
from jaxtyping import Float

from costs.robot import LinkBody
from service.verify.solids import make_coal_convex

MOST_ROUNDING_M = 5e-3  # of an edge of a polytope, which may stand for something round
ROUND_ROUNDING_M = 2e-3  # of an edge of a shape that is known to be round
BOX_ROUNDING_M = 2e-3  # of an edge of a box, and of what has no more corners
BOX_CORNERS = 8
SAME_FACE = 1e-6  # sine of the angle between facets of one face
FLAT_END = 0.7  # cosine between a cylinder's axis and the normal of a contact from which its end is touched
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
        planes: of a core with flat faces, unit normals outwards and offsets, negative inside [m].
    """

    core: coal.ShapeBase
    pose: coal.Transform3s
    radius: float
    planes: Float[np.ndarray, "F 4"]

    @staticmethod
    def of_body(body: LinkBody) -> RoundedBody:
        """Return the rounded body of a link's body, cached while that exists."""
        known = _BODIES.get(body)
        if known is None:
            known = _BODIES[body] = _round_body(body)
        return known

    def list_faces(self) -> Float[np.ndarray, "F 4"]:
        """Return the planes of the core's flat faces, in the frame of the body's joint [m]."""
        if not isinstance(self.core, coal.Cylinder):
            return self.planes
        axis, middle = np.array(self.pose.getRotation())[:, 2], np.array(self.pose.getTranslation())
        normals = np.array([axis, -axis])
        return np.column_stack([normals, -normals @ middle - self.core.halfLength])

    def measure_inside(self, points: Float[np.ndarray, "N 3"], face: Float[np.ndarray, "4"]) -> Float[np.ndarray, "N"]:
        """Return how far points are from the border of a flat face, seen along its normal; negative outside [m]."""
        if isinstance(self.core, coal.Cylinder):
            beside = points - np.array(self.pose.getTranslation())
            return np.asarray(self.core.radius - np.linalg.norm(np.cross(beside, face[:3]), axis=1))
        normal = face[:3]
        on_face = points - (points @ normal + face[3])[:, None] * normal
        along = self.planes[:, :3] - (self.planes[:, :3] @ normal)[:, None] * normal
        slope = np.linalg.norm(along, axis=1)
        others = slope > SAME_FACE
        inside = -(on_face @ self.planes[others, :3].T + self.planes[others, 3]) / slope[others]
        return np.asarray(inside.min(axis=1))

    def find_bar(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], float] | None:
        """Return middle, axis and half length of a core's round side; None where it has none [m]."""
        if not isinstance(self.core, coal.Cylinder | coal.Capsule):
            return None
        axis, middle = np.array(self.pose.getRotation())[:, 2], np.array(self.pose.getTranslation())
        return middle, axis, float(self.core.halfLength)


_BODIES: WeakKeyDictionary[LinkBody, RoundedBody] = WeakKeyDictionary()


def _round_body(body: LinkBody) -> RoundedBody:
    exact = body.exact
    if exact is None:
        points, radius = shrink_hull(body.vertices)
        return RoundedBody(make_coal_convex(points), coal.Transform3s(), radius, _list_planes(points))
    thickness = 2.0 * exact.radius if exact.kind != "cylinder" else min(2.0 * exact.radius, exact.length)
    radius = min(ROUND_ROUNDING_M, ROUNDED_SHARE * thickness)
    within = exact.radius - radius
    none = np.zeros((0, 4))
    pose = coal.Transform3s(exact.pose[:3, :3], exact.pose[:3, 3])
    if exact.kind == "sphere":
        return RoundedBody(coal.Sphere(within), pose, radius, none)
    if exact.kind == "capsule":
        return RoundedBody(coal.Capsule(within, exact.length), pose, radius, none)
    return RoundedBody(coal.Cylinder(within, exact.length - 2.0 * radius), pose, radius, none)


def _list_planes(points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "F 4"]:
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return np.asarray(ConvexHull(points).equations)
    except QhullError:  # flat: it has no inside
        return np.zeros((0, 4))


def shrink_hull(vertices: Float[np.ndarray, "V 3"]) -> tuple[Float[np.ndarray, "W 3"], float]:
    """Return the points of a hull whose faces are moved inwards, and by how much [m]; a flat hull stays as it is."""
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError  # slow to import

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


def list_round_contact(
    body: LinkBody, normal: Float[np.ndarray, "3"], depth_m: float
) -> Float[np.ndarray, "P 3"] | None:
    """Return the points of a round side that something flat touches; None where what it touches is flat.

    Args:
        body: that is touched.
        normal: (3,) unit, into the body.
        depth_m: by which what touches gives way, so that a line becomes a strip [m].
    """
    exact = body.exact
    if exact is None:
        return None
    axis = exact.pose[:3, 2]
    if exact.kind == "cylinder" and abs(axis @ normal) > FLAT_END:
        return None
    inwards = normal if exact.kind == "sphere" else normal - (normal @ axis) * axis
    inwards = inwards / np.linalg.norm(inwards)
    along = np.zeros((1, 3)) if exact.kind == "sphere" else 0.5 * exact.length * np.array([[-1.0], [1.0]]) * axis
    half = np.sqrt(max(2.0 * exact.radius * depth_m - depth_m**2, 0.0))
    aside = half * np.cross(axis, inwards)
    middle = exact.pose[:3, 3] - exact.radius * inwards
    return np.asarray(np.concatenate([middle + along - aside, middle + along + aside]))


def measure_beyond_hull(points: Float[np.ndarray, "K 3"], vertices: Float[np.ndarray, "V 3"]) -> float:
    """Return how far the outermost of some points is beyond the faces of a hull; negative inside [m]."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        planes = ConvexHull(vertices).equations
    except QhullError:
        return float("inf")
    return float((points @ planes[:, :3].T + planes[:, 3]).max())
