"""Convex solids: bodies of the robot in the frame of their joint, pieces of the scene in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import coal
import numpy as np
from jaxtyping import Float, Int

from costs.robot import LinkBody
from costs.scene import ConvexPiece
from service.verify.convex import convex_of


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex body of the robot (in the frame of its joint) or a piece of the scene (joint 0, world frame).

    Attributes:
        name: body or piece.
        link: link of a body; empty for a piece.
        joint: pinocchio joint that carries it.
        vertices: (V, 3) its hull [m].
    """

    name: str
    link: str
    joint: int
    vertices: Float[np.ndarray, "V 3"]

    @cached_property
    def sphere(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Centre of the bounding box and the distance of the farthest vertex from it."""
        centre = 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))
        return centre, float(np.linalg.norm(self.vertices - centre, axis=1).max())

    @cached_property
    def convex(self) -> coal.Convex:
        """The solid for coal."""
        return convex_of(self.vertices)

    def distances(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P"]:
        """Distance of points in the solid's frame from it, 0 inside [m]."""
        dot, here, request, result = (
            coal.Sphere(1e-9),
            coal.Transform3s(),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        found = []
        for point in points:
            result.clear()
            found.append(coal.distance(dot, coal.Transform3s(np.eye(3), point), self.convex, here, request, result))
        return np.asarray(np.maximum(np.array(found), 0.0))

    @staticmethod
    def of_body(body: LinkBody) -> Solid:
        """The solid of a body, made once while the body lives."""
        known = _BODIES.get(body)
        if known is None:
            known = _BODIES[body] = Solid(body.name, body.link, body.joint, body.vertices)
        return known

    @staticmethod
    def of_piece(piece: ConvexPiece) -> Solid:
        """The solid of a piece."""
        return Solid(piece.name, "", 0, piece.vertices)


_BODIES: WeakKeyDictionary[LinkBody, Solid] = WeakKeyDictionary()


def supports(
    solids: Sequence[Solid], which: Int[np.ndarray, "K"], directions: Float[np.ndarray, "K 3"]
) -> Float[np.ndarray, "K"]:
    """How far each chosen solid reaches along its direction, in its own frame: ``max_v direction . v``."""
    order = np.argsort(which, kind="stable")
    sorted_directions, chosen = directions[order], which[order]
    ends = [*(np.flatnonzero(chosen[1:] != chosen[:-1]) + 1).tolist(), len(chosen)]
    reached, out, first = np.empty(len(which)), np.empty(len(which)), 0
    for last in ends if len(which) else ():
        vertices = solids[chosen[first]].vertices
        (sorted_directions[first:last] @ vertices.T).max(axis=1, out=reached[first:last])
        first = last
    out[order] = reached
    return out
