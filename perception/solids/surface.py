"""A mesh to be asked from anywhere: the nearest place on it, and where rays meet it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from perception.solids.mesh import Mesh


class Surface:
    """Triangles prepared for many questions, in the mesh's own frame."""

    def __init__(self, mesh: Mesh) -> None:
        # open3d takes 0.7 s to import; only those who match pay for it.
        import open3d as o3d

        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        triangles = self._tensor(mesh.triangles.astype(np.uint32))
        self._scene.add_triangles(self._tensor(mesh.vertices.astype(np.float32)), triangles)

    def nearest(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
        """The nearest place on the mesh for each point, and the unit outward normal there."""
        answer = self._scene.compute_closest_points(self._tensor(points.astype(np.float32)))
        return _array(answer["points"]), _array(answer["primitive_normals"])

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Which points are inside of the mesh, which must be closed; three rays vote where one may hit an edge."""
        asked = self._tensor(points.astype(np.float32))
        return np.asarray(_array(self._scene.compute_occupancy(asked, nsamples=3)) > 0.5)

    def hits(self, starts: Float[np.ndarray, "R 3"], direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
        """Distance to where each ray of unit direction first meets the mesh [m]; infinite where it does not."""
        rays = np.concatenate([starts, direction], axis=1).astype(np.float32)
        return _array(self._scene.cast_rays(self._tensor(rays))["t_hit"])


def _array(tensor: object) -> np.ndarray:
    return np.asarray(tensor.numpy(), dtype=np.float64)  # type: ignore[attr-defined]
