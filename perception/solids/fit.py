"""Fit of a mesh pose to a scan by point-to-plane ICP on faces towards the sensor, and its score from the rays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from perception.convex.coarse import coarsen
from perception.convex.pieces import VOXEL
from perception.convex.planes import find_planes
from perception.sightlines import SightIndex, Sightlines
from perception.solids.mesh import Mesh
from perception.view import View

FACING = 0.05  # cosine
_FEWEST = 12
_ALONG_RAYS = 0.061  # gate from which points are compared with the place that their ray meets [m]
MOST_TURN = 0.3  # [rad] in one step
DAMPING = 1e-3
LEAST_SIZE = 1e-3  # of the matched surface, for damping [m]
MIN_AGREEING = 30
_PLANE_BAND, _PLANE_EDGE = 0.025, 0.05
_WIDE = 2.4  # width of a wide plane, by the object's radius
_ANGLES = np.linspace(0.0, np.pi, 16, endpoint=False)
_WAYS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_PART, _FEWEST_OF_PART = 0.35, 15  # size of a part by the object's radius, and rays that a part needs
_BESIDE_IT = 0.05  # beyond two tolerances: how near a point that does not lie on the object is unexplained [m]
_UNEXPLAINED = 1.0  # weight of a point near the object that does not lie on it
_TOLERANCE = (0.012, 0.03)
# Distances from an edge within which rays do not count [m], and least share of the rays that must be left.
_BESIDE_EDGE, _FIRM = (0.008, 0.005, 0.003, 0.0), 0.25


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

    def meet(
        self, starts: Float[np.ndarray, "R 3"], direction: Float[np.ndarray, "R 3"]
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Return what ``hits`` returns, and the unit outward normals there."""
        rays = np.concatenate([starts, direction], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(self._tensor(rays))
        return _array(answer["t_hit"]), _array(answer["primitive_normals"])


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
        points, starts = pose.to_mesh(region.points), pose.to_mesh(region.starts)
        place, normal = surface.nearest(points)
        if gate <= _ALONG_RAYS:
            # Noise lies along the rays, and the nearest place to a point inside a slender part may be its side or back.
            way = points - starts
            length = np.linalg.norm(way, axis=1)
            way /= np.maximum(length, 1e-9)[:, None]
            met, normal_there = surface.meet(starts, way)
            is_near = np.abs(met - length) < gate
            place[is_near] = (starts + np.where(is_near, met, 0.0)[:, None] * way)[is_near]
            normal[is_near] = normal_there[is_near]
        offset = points - place
        distance = np.linalg.norm(offset, axis=1)
        sight = starts - place
        facing = (normal * sight).sum(axis=1) > FACING * np.linalg.norm(sight, axis=1)
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
    size = max(float(np.linalg.norm(place - middle, axis=1).mean()), LEAST_SIZE)
    damping = DAMPING * weight.sum() * np.diag([size**2] * 3 + [1.0] * 3)
    step = np.linalg.solve(J.T @ (weight[:, None] * J) + damping, J.T @ (weight * residual))
    turn = step[:3] * min(1.0, MOST_TURN / max(float(np.linalg.norm(step[:3])), 1e-12))
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return MeshPose(pose.rotation @ rotation, pose.to_world(middle + step[3:] - rotation @ middle))


@dataclass(frozen=True)
class RayCounts:
    """Numbers of rays that end on the mesh, pass through it or end before it, and of unexplained points near it.

    Attributes:
        agreeing: without those that end on a wide plane, which are counted in ``on_planes``.
        held: unexplained points that are nearest to one part of the mesh, the most of any part: what carries an object
            touches it at one place, such as the stem of a wheel at its hub.
    """

    agreeing: int
    on_planes: int
    through: int
    hidden: int
    unexplained: int
    held: int
    tolerance: float
    distance: Float[np.ndarray, "K"]

    @property
    def score(self) -> float:
        """Rays that end on the mesh minus weighted contradicting ones, over the root of their number."""
        n = self.agreeing + self.through
        stray = self.unexplained - self.held
        return 0.0 if n == 0 else (self.agreeing - 2.0 * self.through - 0.5 * stray) / np.sqrt(n)


@dataclass(frozen=True)
class WidePlanes:
    """Planes wider than an object, such as tables and walls, each as far as it was seen.

    Attributes:
        normals: (P, 3) unit.
        offsets: (P,) ``normal . x == offset`` [m].
        bases: (P, 2, 3) directions in each plane.
        lower, upper: (P, 2) extent along these directions [m].
    """

    normals: Float[np.ndarray, "P 3"]
    offsets: Float[np.ndarray, "P"]
    bases: Float[np.ndarray, "P 2 3"]
    lower: Float[np.ndarray, "P 2"]
    upper: Float[np.ndarray, "P 2"]

    def hold(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Return which points lie on one of the planes."""
        on = np.zeros(len(points), dtype=bool)
        for normal, offset, basis, lower, upper in zip(
            self.normals, self.offsets, self.bases, self.lower, self.upper, strict=True
        ):
            near = np.flatnonzero(np.abs(points @ normal - offset) <= _PLANE_BAND)
            flat = points[near] @ basis.T
            on[near[((flat >= lower) & (flat <= upper)).all(axis=1)]] = True
        return on

    def measure(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "K"]:
        """Return the distances of the points that lie on the planes from the middle of each plane's points [m]."""
        offsets = [np.zeros(0)]
        for i in range(len(self.offsets)):
            on = WidePlanes(*(values[i : i + 1] for values in vars(self).values())).hold(points)
            if on.any():
                distance = points[on] @ self.normals[i]
                offsets.append(distance - np.median(distance))
        return np.concatenate(offsets)


@dataclass(frozen=True)
class PoseJudge:
    """Rays and points near a candidate position.

    Attributes:
        wide: planes larger than the object.
        part: size of the parts of its surface that are looked at one by one [m].
    """

    surface: Surface
    rays: Sightlines
    region: Region
    wide: WidePlanes
    part: float

    def count(self, pose: MeshPose, most_rays: int, most_points: int, least: float = _TOLERANCE[0]) -> RayCounts:
        """Count rays that agree with a pose and rays that contradict it, from a subset of rays and points.

        Args:
            least: smallest tolerance, for a pose that is not yet settled [m].
        """
        rays = self.rays.thin(most_rays)
        hit = self.surface.hits(pose.to_mesh(rays.start), rays.direction @ pose.rotation)
        met = np.isfinite(hit)
        beyond = rays.length[met] - hit[met]
        region = self.region.thin(most_points)
        place, _ = self.surface.nearest(pose.to_mesh(region.points))
        offset = pose.to_mesh(region.points) - place
        distance = np.linalg.norm(offset, axis=1)
        close = distance[distance < _TOLERANCE[1]]
        tolerance = float(np.clip(3.0 * 1.48 * np.median(close), least, _TOLERANCE[1])) if len(close) else least
        # Only points in the 5 cm beyond two tolerances contradict the pose: objects stand on tables.
        outside = (distance > 2.0 * tolerance) & (distance < 2.0 * tolerance + _BESIDE_IT)
        thinned = len(rays) * len(self.region.points) / max(1, len(self.rays) * len(region.points))
        # A ray that ends on a wide plane, such as a wall, is no evidence for an object beside that plane.
        agreeing = np.flatnonzero(met)[np.abs(beyond) <= tolerance]
        n_loose = int((~self.wide.hold(rays.ends[agreeing])).sum())
        return RayCounts(
            n_loose,
            len(agreeing) - n_loose,
            int((beyond > tolerance).sum()),
            int((beyond < -tolerance).sum()),
            int(thinned * _UNEXPLAINED * outside.sum()),
            int(thinned * _UNEXPLAINED * _most_about(place[outside], self.part)),
            tolerance,
            distance[distance <= tolerance],
        )

    def share_through(self, pose: MeshPose) -> tuple[float, float]:
        """Return the share of the rays towards the mesh that went on through it, and of its part where it is largest.

        Rays that graze an edge do not count.

        Rays beside an edge pass where the pose, or the width of the beam, is a few millimetres off.  A ray counts if
        the four rays beside it meet the mesh too; they are nearer to it where the mesh is slender.
        """
        start, way = pose.to_mesh(self.rays.start), self.rays.direction @ pose.rotation
        hit = self.surface.hits(start, way)
        met = np.flatnonzero(np.isfinite(hit))
        if not len(met):
            return 0.0, 0.0
        start, way, hit, length = start[met], way[met], hit[met], self.rays.length[met]
        tolerance = _TOLERANCE[0] + 0.5 * (_TOLERANCE[1] - _TOLERANCE[0])
        u = np.cross(way, np.eye(3)[np.argmin(np.abs(way), axis=1)])
        u /= np.linalg.norm(u, axis=1)[:, None]
        v = np.cross(way, u)
        firm = np.zeros(len(met), dtype=bool)
        for beside in _BESIDE_EDGE:
            offsets = [sign * beside * across for across in (u, v) for sign in (-1.0, 1.0)]
            firm = np.all([np.isfinite(self.surface.hits(start + offset, way)) for offset in offsets], axis=0)
            if firm.sum() >= max(MIN_AGREEING, _FIRM * len(met)):
                break
        beyond = (length - hit)[firm]
        through, counts = beyond > tolerance, beyond >= -tolerance
        cells = np.floor((start + hit[:, None] * way)[firm] / self.part).astype(np.int64)[counts]
        _, cell = np.unique(cells, axis=0, return_inverse=True)
        n_rays = np.bincount(cell.reshape(-1), minlength=1)
        n_through = np.bincount(cell.reshape(-1), through[counts], minlength=1)
        worst = float((n_through / np.maximum(n_rays, 1))[n_rays >= _FEWEST_OF_PART].max(initial=0.0))
        return float(through.sum() / max(1, counts.sum())), worst


def make_pose_judge(
    surface: Surface,
    index: SightIndex,
    view: View,
    place: Float[np.ndarray, "3"],
    radius: float,
    wide: WidePlanes | None = None,
) -> PoseJudge:
    """Return the rays near a position, and the points there that are not on planes larger than the object.

    Args:
        radius: of the sphere about the object [m].
        wide: these planes, found in the whole scan; None: they are found about the position.
    """
    near = np.flatnonzero(np.linalg.norm(view.obstacles - place, axis=1) <= 3.0 * radius + 0.1)
    points, starts = view.obstacles[near], view.starts[near]
    wide = wide or find_wide_planes(points, starts, radius, view.seed)
    kept = (np.linalg.norm(points - place, axis=1) <= 1.6 * radius + 0.05) & ~wide.hold(points)
    rays = index.passing(place[None], 2.0 * radius + 0.1)
    return PoseJudge(surface, rays, Region(points[kept], starts[kept]), wide, _PART * radius)


def _most_about(places: Float[np.ndarray, "K 3"], radius: float) -> int:
    """Return the greatest number of places within ``radius`` of one of them [m]."""
    if not len(places):
        return 0
    return int(cKDTree(places).query_ball_point(places, radius, return_length=True).max())


def find_wide_planes(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], radius: float, seed: int
) -> WidePlanes:
    """Return planes wider than an object of this radius [m]."""
    planes = []
    if len(points) >= MIN_AGREEING:
        coarse = coarsen(points, starts, VOXEL)
        found = find_planes(coarse.points, coarse.counts, coarse.starts, np.random.default_rng(seed), None)
        flats = [(plane, coarse.points[plane.members] @ plane.basis.T) for plane in found]
        planes = [(plane, flat) for plane, flat in flats if np.ptp(flat @ _WAYS, axis=0).max() > _WIDE * radius]
    return WidePlanes(
        np.array([plane.normal for plane, _ in planes]).reshape(-1, 3),
        np.array([plane.offset for plane, _ in planes]),
        np.array([plane.basis for plane, _ in planes]).reshape(-1, 2, 3),
        np.array([flat.min(axis=0) - _PLANE_EDGE for _, flat in planes]).reshape(-1, 2),
        np.array([flat.max(axis=0) + _PLANE_EDGE for _, flat in planes]).reshape(-1, 2),
    )
