"""Triangles moved onto points: point-to-plane ICP on the sides of a mesh that face the sensor."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from perception.solids.mesh import Mesh

_FACING = 0.05  # cosine
_FEWEST = 12
_MOST_TURN = 0.3  # [rad] in one step
_DAMPING = 1e-3
_LEAST_SIZE = 1e-3  # of what points are held against [m]


class Surface:
    """Triangles prepared for distances and rays, in the mesh's own frame."""

    def __init__(self, mesh: Mesh) -> None:
        # open3d takes 0.7 s to import.
        import open3d as o3d

        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        triangles = self._tensor(mesh.triangles.astype(np.uint32))
        self._scene.add_triangles(self._tensor(mesh.vertices.astype(np.float32)), triangles)

    def nearest(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
        """Find the nearest place on the mesh for each point, and the unit outward normal there."""
        answer = self._scene.compute_closest_points(self._tensor(points.astype(np.float32)))
        return _array(answer["points"]), _array(answer["primitive_normals"])

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Find the points inside of the mesh, which must be closed; three rays vote, since one may hit an edge."""
        places = self._tensor(points.astype(np.float32))
        return np.asarray(_array(self._scene.compute_occupancy(places, nsamples=3)) > 0.5)

    def hits(self, starts: Float[np.ndarray, "R 3"], direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
        """Return the distance at which each ray of unit direction first meets the mesh [m]; infinite for a miss."""
        rays = np.concatenate([starts, direction], axis=1).astype(np.float32)
        return _array(self._scene.cast_rays(self._tensor(rays))["t_hit"])


def _array(tensor: object) -> np.ndarray:
    return np.asarray(tensor.numpy(), dtype=np.float64)  # type: ignore[attr-defined]


@dataclass(frozen=True)
class MeshPose:
    """World from mesh: ``rotation`` (3, 3) and ``shift`` (3,) [m]."""

    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """As a homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.shift
        return matrix

    def to_world(self, points: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
        """Points of the mesh's frame in the world."""
        return np.asarray(points @ self.rotation.T + self.shift)

    def to_mesh(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Points of the world in the mesh's frame."""
        return np.asarray((points - self.shift) @ self.rotation)

    def rotate(self, turn: Float[np.ndarray, "3"], about: Float[np.ndarray, "3"]) -> MeshPose:
        """Turned by a rotation vector about a point of the world."""
        rotation = Rotation.from_rotvec(turn).as_matrix()
        return MeshPose(rotation @ self.rotation, rotation @ (self.shift - about) + about)

    def translate(self, by: Float[np.ndarray, "3"]) -> MeshPose:
        """Moved in the world."""
        return MeshPose(self.rotation, self.shift + by)


@dataclass(frozen=True)
class Region:
    """Measured points (N, 3) and where their rays started (N, 3) [m]."""

    points: Float[np.ndarray, "N 3"]
    starts: Float[np.ndarray, "N 3"]

    def thin(self, most: int) -> Region:
        """Every k-th, so that at most ``most`` are left."""
        step = max(1, -(-len(self.points) // most))
        return Region(self.points[::step], self.starts[::step])


def fit_pose(surface: Surface, region: Region, start: MeshPose, gates: Iterable[float]) -> MeshPose:
    """Take one Gauss-Newton step of point-to-plane ICP (Chen and Medioni, 1992) for each gate.

    Args:
        gates: points farther from the mesh than this have no weight, nearer ones Tukey's biweight [m].
    """
    pose = start
    for gate in gates:
        points = pose.to_mesh(region.points)
        place, normal = surface.nearest(points)
        offset = points - place
        distance = np.linalg.norm(offset, axis=1)
        sight = pose.to_mesh(region.starts) - place
        facing = (normal * sight).sum(axis=1) > _FACING * np.linalg.norm(sight, axis=1)
        used = (distance < gate) & facing
        if used.sum() < _FEWEST:
            return pose
        weight = (1.0 - (distance[used] / gate) ** 2) ** 2
        pose = _take_step(pose, place[used], normal[used], offset[used], weight)
    return pose


def _take_step(
    pose: MeshPose,
    place: Float[np.ndarray, "K 3"],
    normal: Float[np.ndarray, "K 3"],
    offset: Float[np.ndarray, "K 3"],
    weight: Float[np.ndarray, "K"],
) -> MeshPose:
    """Turn and shift the mesh so that its planes meet the points, all in its own frame."""
    middle = place.mean(axis=0)
    J = np.concatenate([np.cross(place - middle, normal), normal], axis=1)
    residual = (normal * offset).sum(axis=1)
    # Points that are all nearest to one corner do not determine the orientation.
    size = max(float(np.linalg.norm(place - middle, axis=1).mean()), _LEAST_SIZE)
    damping = _DAMPING * weight.sum() * np.diag([size**2] * 3 + [1.0] * 3)
    step = np.linalg.solve(J.T @ (weight[:, None] * J) + damping, J.T @ (weight * residual))
    turn = step[:3] * min(1.0, _MOST_TURN / max(float(np.linalg.norm(step[:3])), 1e-12))
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return MeshPose(pose.rotation @ rotation, pose.to_world(middle + step[3:] - rotation @ middle))
