"""Judgement of a mesh in a pose by the rays and points of a scan about a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.convex.coarse import coarsen
from perception.convex.pieces import VOXEL
from perception.convex.planes import find_planes
from perception.sightlines import SightIndex, Sightlines
from perception.solids.fit import MeshPose, Region, Surface
from perception.view import View

MIN_AGREEING = 30
_PLANE_BAND = 0.025
_TOLERANCE = (0.012, 0.03)


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
        """Count what the rays say about a pose."""
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
