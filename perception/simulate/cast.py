"""Ray casting: first hits of rays on triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.solids.primitives import Mesh


@dataclass(frozen=True)
class Hits:
    """First hit of each ray on a surface.

    Attributes:
        distance: (R,) range along the ray [m]; infinite without a hit.
        cosine: (R,) cosine of the angle between ray and surface normal, 0 (grazing) to 1; 0 without a hit.
    """

    distance: Float[np.ndarray, "R"]
    cosine: Float[np.ndarray, "R"]


class Caster:
    """Triangle mesh prepared for casting many rays."""

    def __init__(self, world: Mesh) -> None:
        # open3d takes 0.7 s to import; only simulations need it.
        import open3d as o3d

        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        triangles = self._tensor(world.triangles.astype(np.uint32))
        self._scene.add_triangles(self._tensor(world.vertices.astype(np.float32)), triangles)

    def hits(self, origin: Float[np.ndarray, "*R 3"], direction: Float[np.ndarray, "R 3"]) -> Hits:
        """Return the first hits of rays with unit directions."""
        rays = np.concatenate([np.broadcast_to(origin, direction.shape), direction], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        distance = np.asarray(answer["t_hit"].numpy(), dtype=np.float64)
        normal = np.asarray(answer["primitive_normals"].numpy(), dtype=np.float64)
        cosine = np.abs((normal * direction).sum(axis=1))
        return Hits(distance, np.where(np.isfinite(distance), np.minimum(cosine, 1.0), 0.0))

    def distance(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return the distance from each point to the nearest triangle [m]."""
        queries = self._tensor(points.astype(np.float32))
        return np.asarray(self._scene.compute_distance(queries, nthreads=1).numpy(), dtype=float)


def cast(world: Mesh, origin: Float[np.ndarray, "*R 3"], direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
    """Return the distance to the first surface along each unit direction [m]; infinite without a hit."""
    return Caster(world).hits(origin, direction).distance
