"""Mesh poses in a scan: fitted by point-to-plane ICP on the sides that face the sensor, judged by the rays."""

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
_LEAST_SIZE = 1e-3  # of what points are held against [m]
MIN_AGREEING = 30
_PLANE_BAND = 0.025
_TOLERANCE = (0.012, 0.03)


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


@dataclass(frozen=True)
class RayCounts:
    """Counts of rays that agree with a pose and that contradict it."""

    agreeing: int
    through: int
    hidden: int
    unexplained: int
    tolerance: float
    distance: Float[np.ndarray, "K"]

    @property
    def score(self) -> float:
        """Rays that end on it, less those that go through it."""
        n = self.agreeing + self.through
        return 0.0 if n == 0 else (self.agreeing - 2.0 * self.through - 0.5 * self.unexplained) / np.sqrt(n)


@dataclass(frozen=True)
class PoseJudge:
    """The rays and points about a place; ``wide`` are planes (P, 4) that reach farther than the object does."""

    surface: Surface
    rays: Sightlines
    region: Region
    wide: Float[np.ndarray, "P 4"]

    def count(self, pose: MeshPose, most_rays: int, most_points: int) -> RayCounts:
        """Count the rays that agree with a pose and those that contradict it."""
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
        # Things stand on tables: only what is well before the surface and far from its base is held against it.
        outside = (distance > 2.0 * tolerance) & (distance < 2.0 * tolerance + 0.05)
        share = len(rays) / max(1, len(region.points))
        # A ray that ends on a wall is no evidence of an object whose side lies in that wall.
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
    """Collect the rays about a place, and the points that may be the object's: not those of planes wider than it is."""
    near = np.flatnonzero(np.linalg.norm(view.obstacles - place, axis=1) <= 3.0 * radius + 0.1)
    points, starts = view.obstacles[near], view.starts[near]
    wide = find_wide_planes(points, starts, radius, view.seed)
    kept = (np.linalg.norm(points - place, axis=1) <= 1.6 * radius + 0.05) & ~lie_on_planes(points, wide)
    rays = index.passing(place[None], 2.0 * radius + 0.1)
    return PoseJudge(surface, rays, Region(points[kept], starts[kept]), wide)


def find_wide_planes(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], radius: float, seed: int
) -> Float[np.ndarray, "P 4"]:
    """Find planes (unit normal, offset) that reach farther than an object of this radius: tables, walls."""
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
