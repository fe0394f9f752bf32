"""Exact round shapes, which planning replaces by polytopes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

RoundKind = Literal["sphere", "cylinder", "capsule"]


@dataclass(frozen=True, eq=False)
class Primitive:
    """A round shape in the frame of its link's joint, or in the world.

    Attributes:
        kind: ``sphere``, ``cylinder`` or ``capsule``; the latter two lie along their own z.
        radius: [m].
        length: of a cylinder, or of a capsule without its caps [m]; 0 for a sphere.
        pose: (4, 4) the shape in that frame.
    """

    kind: RoundKind
    radius: float
    length: float
    pose: Float[np.ndarray, "4 4"]

    def move(self, pose: Float[np.ndarray, "4 4"]) -> Primitive:
        """Return the same shape in another frame, in which its present frame has the given pose."""
        return replace(self, pose=pose @ self.pose)


def make_round_shape(kind: str, size: Float[np.ndarray, "k"] | tuple[float, ...]) -> Primitive | None:
    """Make a round shape of a kind and size (radius, then length) at its own origin; None for any other kind."""
    if kind not in ("sphere", "cylinder", "capsule"):
        return None
    radius, length = float(size[0]), 0.0 if kind == "sphere" else float(size[1])
    return Primitive(kind, radius, length, np.eye(4))  # type: ignore[arg-type]


def measure_outside_round(points: Float[np.ndarray, "C 3"], shape: Primitive) -> Float[np.ndarray, "C"]:
    """Return the distances of points from a round shape, in the frame of its pose; 0 inside [m]."""
    own = (points - shape.pose[:3, 3]) @ shape.pose[:3, :3]
    beyond = np.maximum(np.abs(own[:, 2]) - 0.5 * shape.length, 0.0)
    across = np.linalg.norm(own[:, :2], axis=1)
    if shape.kind == "cylinder":
        return np.asarray(np.hypot(np.maximum(across - shape.radius, 0.0), beyond))
    return np.asarray(np.maximum(np.hypot(across, beyond) - shape.radius, 0.0))


def find_round_normals(points: Float[np.ndarray, "C 3"], shape: Primitive) -> Float[np.ndarray, "C 3"]:
    """Return the outward unit normals of a round shape near points; zero at its middle.

    A cylinder's normal is that of its end where a point is nearer to the end than to the side.
    """
    own = (points - shape.pose[:3, 3]) @ shape.pose[:3, :3]
    end = np.abs(own[:, 2]) - 0.5 * shape.length
    outwards = own.copy()
    if shape.kind == "cylinder":
        is_end = end > np.linalg.norm(own[:, :2], axis=1) - shape.radius
        outwards[is_end, :2] = 0.0
        outwards[~is_end, 2] = 0.0
    else:
        outwards[:, 2] = np.sign(own[:, 2]) * np.maximum(end, 0.0)
    length = np.linalg.norm(outwards, axis=1, keepdims=True)
    return np.asarray(outwards / np.maximum(length, 1e-12) @ shape.pose[:3, :3].T)
