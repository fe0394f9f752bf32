"""Triangles in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    Attributes:
        triangles: (F, 3) indices of their corners.
    """

    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]

    def move(self, rotation: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Mesh:
        """Turn about the origin, then shift."""
        return Mesh(self.vertices @ rotation.T + shift, self.triangles)

    def place(self, pose_world_mesh: Float[np.ndarray, "4 4"]) -> Mesh:
        """Transform to another frame; a pose that mirrors is allowed."""
        return self.move(pose_world_mesh[:3, :3], pose_world_mesh[:3, 3])

    @property
    def volume(self) -> float:
        """What a closed mesh holds, negative when it is wound inside out [m^3]."""
        a, b, c = np.moveaxis(self.vertices[self.triangles] - self.vertices.mean(axis=0), 1, 0)
        return float((a * np.cross(b, c)).sum() / 6.0)
