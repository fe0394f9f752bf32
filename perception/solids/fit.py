"""Fit of a mesh pose to a scan by point-to-plane ICP on faces towards the sensor, and its score from the rays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from perception.convex.coarse import coarsen
from perception.convex.pieces import VOXEL
from perception.convex.planes import find_planes
from perception.sightlines import SightIndex, Sightlines
from perception.solids.mesh import Mesh
from perception.view import View

_FACING = 0.05  # cosine
_FEWEST = 12
_MOST_TURN = 0.3  # [rad] in one step
_DAMPING = 1e-3
_LEAST_SIZE = 1e-3  # of the matched surface, for damping [m]
MIN_AGREEING = 30
_PLANE_BAND = 0.025
_TOLERANCE = (0.012, 0.03)


class Surface:
    """Mesh prepared for distance and ray queries, in the mesh's own frame."""

    def __init__(self, mesh: Mesh) -> None:
        # open3d takes 0.7 s to import.
        import open3d as o3d

        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        triangles = self._tensor(mesh.triangles.astype(np.uint32))
        self._scene.add_triangles(self._tensor(mesh.vertices.astype(np.float32)), triangles)

    def nearest(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
        """Return the nearest position on the mesh to each point [m], and the unit outward normal there."""
        answer = self._scene.compute_closest_points(self._tensor(points.astype(np.float32)))
        return _array(answer["points"]), _array(answer["primitive_normals"])

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Return which points are inside the mesh, which must be closed; three rays vote, since one may hit an edge."""
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
    """Transform from the mesh frame to the world: ``rotation`` (3, 3) and ``shift`` (3,) [m]."""

    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """Homogeneous matrix ``pose_world_mesh`` (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.shift
        return matrix

    def to_world(self, points: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
        """Transform points from the mesh frame to the world [m]."""
        return np.asarray(points @ self.rotation.T + self.shift)

    def to_mesh(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Transform points from the world to the mesh frame [m]."""
        return np.asarray((points - self.shift) @ self.rotation)

    def rotate(self, turn: Float[np.ndarray, "3"], about: Float[np.ndarray, "3"]) -> MeshPose:
        """Return the pose rotated by a rotation vector [rad] about a point, both in the world."""
        rotation = Rotation.from_rotvec(turn).as_matrix()
        return MeshPose(rotation @ self.rotation, rotation @ (self.shift - about) + about)

    def translate(self, by: Float[np.ndarray, "3"]) -> MeshPose:
        """Return the pose moved by a vector in the world [m]."""
        return MeshPose(self.rotation, self.shift + by)


@dataclass(frozen=True)
class Region:
    """Measured points (N, 3) and the starts of their rays (N, 3), in the world [m]."""

    points: Float[np.ndarray, "N 3"]
    starts: Float[np.ndarray, "N 3"]

    def thin(self, most: int) -> Region:
        """Return every k-th point, at most ``most`` in all."""
        step = max(1, -(-len(self.points) // most))
        return Region(self.points[::step], self.starts[::step])


def fit_pose(surface: Surface, region: Region, start: MeshPose, gates: Iterable[float]) -> MeshPose:
    """Return the pose after one Gauss-Newton step of point-to-plane ICP (Chen and Medioni, 1992) per gate.

    Args:
        gates: inlier distance of each step; nearer points have Tukey's biweight, farther ones no weight [m].
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
    """Return the pose after one damped least-squares step on the point-to-plane residuals, in the mesh frame."""
    middle = place.mean(axis=0)
    J = np.concatenate([np.cross(place - middle, normal), normal], axis=1)
    residual = (normal * offset).sum(axis=1)
    # Damping: points that are all nearest to one corner do not determine the orientation.
    size = max(float(np.linalg.norm(place - middle, axis=1).mean()), _LEAST_SIZE)
    damping = _DAMPING * weight.sum() * np.diag([size**2] * 3 + [1.0] * 3)
    step = np.linalg.solve(J.T @ (weight[:, None] * J) + damping, J.T @ (weight * residual))
    turn = step[:3] * min(1.0, _MOST_TURN / max(float(np.linalg.norm(step[:3])), 1e-12))
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return MeshPose(pose.rotation @ rotation, pose.to_world(middle + step[3:] - rotation @ middle))


@dataclass(frozen=True)
class RayCounts:
    """Numbers of rays that end on the mesh, pass through it or end before it, and of unexplained points near it."""

    agreeing: int
    through: int
    hidden: int
    unexplained: int
    tolerance: float
    distance: Float[np.ndarray, "K"]

    @property
    def score(self) -> float:
        """Rays that end on the mesh minus weighted contradicting ones, over the root of their number."""
        n = self.agreeing + self.through
        return 0.0 if n == 0 else (self.agreeing - 2.0 * self.through - 0.5 * self.unexplained) / np.sqrt(n)


@dataclass(frozen=True)
class PoseJudge:
    """Rays and points near a candidate position; ``wide`` (P, 4) are planes larger than the object."""

    surface: Surface
    rays: Sightlines
    region: Region
    wide: Float[np.ndarray, "P 4"]

    def count(self, pose: MeshPose, most_rays: int, most_points: int) -> RayCounts:
        """Count rays that agree with a pose and rays that contradict it, from a subset of rays and points."""
        rays = self.rays.thin(most_rays)
        hit = self.surface.hits(pose.to_mesh(rays.start), rays.direction @ pose.rotation)
        met = np.isfinite(hit)
        beyond = rays.length[met] - hit[met]
        region = self.region.thin(most_points)
        place, _ = self.surface.nearest(pose.to_mesh(region.points))
        offset = pose.to_mesh(region.points) - place
        distance = np.linalg.norm(offset, axis=1)
        close = distance[distance < _TOLERANCE[1]]
        tolerance = float(np.clip(3.0 * 1.48 * np.median(close), *_TOLERANCE)) if len(close) else _TOLERANCE[0]
        # Only points in the 5 cm beyond two tolerances contradict the pose: objects stand on tables.
        outside = (distance > 2.0 * tolerance) & (distance < 2.0 * tolerance + 0.05)
        share = len(rays) / max(1, len(region.points))
        # A ray that ends on a wide plane, such as a wall, is no evidence for an object beside that plane.
        agreeing = np.flatnonzero(met)[np.abs(beyond) <= tolerance]
        return RayCounts(
            int((~lie_on_planes(rays.ends[agreeing], self.wide)).sum()),
            int((beyond > tolerance).sum()),
            int((beyond < -tolerance).sum()),
            int(share * 0.2 * outside.sum()),
            tolerance,
            distance[distance <= tolerance],
        )


def make_pose_judge(
    surface: Surface, index: SightIndex, view: View, place: Float[np.ndarray, "3"], radius: float
) -> PoseJudge:
    """Return the rays near a position, and the points there that are not on planes larger than the object."""
    near = np.flatnonzero(np.linalg.norm(view.obstacles - place, axis=1) <= 3.0 * radius + 0.1)
    points, starts = view.obstacles[near], view.starts[near]
    wide = find_wide_planes(points, starts, radius, view.seed)
    kept = (np.linalg.norm(points - place, axis=1) <= 1.6 * radius + 0.05) & ~lie_on_planes(points, wide)
    rays = index.passing(place[None], 2.0 * radius + 0.1)
    return PoseJudge(surface, rays, Region(points[kept], starts[kept]), wide)


def find_wide_planes(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], radius: float, seed: int
) -> Float[np.ndarray, "P 4"]:
    """Return planes (unit normal, offset) larger than an object of this radius [m], such as tables and walls."""
    if len(points) < MIN_AGREEING:
        return np.zeros((0, 4))
    coarse = coarsen(points, starts, VOXEL)
    planes = find_planes(coarse.points, coarse.counts, coarse.starts, np.random.default_rng(seed), None)
    reaches = [np.linalg.norm(np.ptp(coarse.points[plane.members] @ plane.basis.T, axis=0)) for plane in planes]
    wide = [
        np.append(plane.normal, plane.offset)
        for plane, reach in zip(planes, reaches, strict=True)
        if reach > 2.4 * radius
    ]
    return np.array(wide).reshape(-1, 4)


def lie_on_planes(points: Float[np.ndarray, "N 3"], planes: Float[np.ndarray, "P 4"]) -> Bool[np.ndarray, "N"]:
    return np.asarray((np.abs(points @ planes[:, :3].T - planes[:, 3]) <= _PLANE_BAND).any(axis=1))
