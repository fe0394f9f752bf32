"""Distances between shapes as they were given: spheres, cylinders and capsules round, everything else by its hull."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
from jaxtyping import Float

from costs.primitive import Primitive
from costs.robot import LinkBody
from costs.scene import ConvexPiece
from service.verify.convex import convex_of

EXACT_ROUNDING_M = 1e-5
"""More than coal's distances between round shapes are off [m]."""


@dataclass(frozen=True)
class ExactShape:
    """A shape for coal, in the frame of what it belongs to.

    Attributes:
        geometry: the shape.
        pose: (4, 4) of the shape in the frame of the body's joint, or in the world for a piece.
        is_round: whether it differs from the hull that stands for it in planning.
    """

    geometry: coal.CollisionGeometry
    pose: Float[np.ndarray, "4 4"]
    is_round: bool

    @staticmethod
    def of(thing: LinkBody | ConvexPiece) -> ExactShape:
        """The shape that was given for a body or a piece."""
        if thing.exact is None:
            return ExactShape.of_hull(thing)
        return ExactShape(_geometry(thing.exact), thing.exact.pose, True)

    @staticmethod
    def of_hull(thing: LinkBody | ConvexPiece) -> ExactShape:
        """The hull that stands for a body or a piece in planning and in the certificate."""
        return ExactShape(convex_of(thing.vertices), np.eye(4), False)

    def depth_in(
        self, other: ExactShape, pose: Float[np.ndarray, "4 4"] | None = None, pose_other: np.ndarray | None = None
    ) -> float:
        """How far one of the two would have to be moved to be free of the other, negative when apart [m].

        The poses place the frames of what the shapes belong to in the world; without one, a frame is the world's.
        """
        return penetration(self.geometry, other.geometry, _at(pose, self.pose), _at(pose_other, other.pose))


def penetration(
    first: coal.CollisionGeometry,
    second: coal.CollisionGeometry,
    pose_first: coal.Transform3s | None = None,
    pose_second: coal.Transform3s | None = None,
) -> float:
    """How far one of two shapes would have to be moved to be free of the other, negative when apart [m].

    The poses place them in the world; without one a shape is there already.
    """
    result, here = coal.DistanceResult(), coal.Transform3s()
    poses = (pose_first or here, pose_second or here)
    return -float(coal.distance(first, poses[0], second, poses[1], coal.DistanceRequest(), result))


def _geometry(exact: Primitive) -> coal.CollisionGeometry:
    match exact.kind:
        case "sphere":
            # coal.Sphere takes a shortcut to a cylinder's distance that is metres off where its centre is inside.
            return coal.Capsule(exact.radius, 0.0)
        case "cylinder":
            return coal.Cylinder(exact.radius, exact.length)
        case "capsule":
            return coal.Capsule(exact.radius, exact.length)


def _at(pose: Float[np.ndarray, "4 4"] | None, pose_inside: Float[np.ndarray, "4 4"]) -> coal.Transform3s:
    placed = pose_inside if pose is None else pose @ pose_inside
    return coal.Transform3s(placed[:3, :3], placed[:3, 3])
