"""Flat faces that objects are fixed to, and the rays that reach them, with heights over the face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from threadpoolctl import threadpool_limits

from costs.stopping import poll
from perception.cleaning.clean import voxel_downsample, voxel_index
from perception.convex.planes import PlaneSettings, find_planes
from perception.sightlines import SightIndex, Sightlines, sight_index
from perception.view import View

_VOXEL = 0.02
_WALL = PlaneSettings(min_size=0.3, min_points=100, max_planes=8, n_candidates=90, n_neighbours=14, distance=0.025)
_FACE = PlaneSettings(min_size=0.07, min_points=20, max_planes=3, n_candidates=40, n_neighbours=14, distance=0.025)
_LINK = 0.04
_MOST_CELLS = 5_000_000
_MOST_PATCHES = 10
_STEEPEST = 0.8
_RANGE = 2.5
_HINT_RADIUS = 0.7
_BAND = 0.06
_MOST_RAYS = 12_000
_LEAST_SLOPE = 0.1
_SIGMA = (0.0015, 0.02)
_SPACING = 0.15
_SMALL = 0.6
_FIXED = 0.2  # largest usual distance of a fixed object from its wall [m]


@dataclass(frozen=True)
class Face:
    """Flat rectangular region.

    Attributes:
        frame: (3, 3) unit rows: x (horizontal), y (as upright as possible), z (the normal, towards the sensor).
        centre: (3,) origin of the frame [m].
        low, high: (2,) corners of the region in x and y [m].
        sigma: standard deviation of its points along z [m].
    """

    frame: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    sigma: float

    @property
    def size(self) -> Float[np.ndarray, "2"]:
        """Extent along x and y [m]."""
        return np.asarray(self.high - self.low)

    def local(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Return world points in the face's frame [m]."""
        return np.asarray((points - self.centre) @ self.frame.T)

    def world(self, local: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Return points of the face's frame in the world [m]."""
        return np.asarray(self.centre + local @ self.frame)


@dataclass(frozen=True)
class FaceRays:
    """Rays that reach a face.

    Attributes:
        at: (N, 2) each ray's crossing with the face's plane, x and y [m].
        ends: (N, 3) each ray's end in the face's frame [m].
    """

    rays: Sightlines
    at: Float[np.ndarray, "N 2"]
    ends: Float[np.ndarray, "N 3"]

    def select(self, keep: Bool[np.ndarray, "N"]) -> FaceRays:
        """Return only the rays of the mask ``keep``."""
        return FaceRays(self.rays.select(keep), self.at[keep], self.ends[keep])


@dataclass(frozen=True)
class FacesInSight:
    """Faces and rays for the detectors of objects on faces, computed once for a view and hint.

    Attributes:
        faces: upright and slanting faces within 2.5 m, fitted to the rays that ended on them, largest first.
    """

    faces: tuple[Face, ...]
    index: SightIndex

    @staticmethod
    def of(view: View, hint: Float[np.ndarray, "3"] | None = None, index: SightIndex | None = None) -> FacesInSight:
        """Return the faces of a view; with a hint those near it and those of a separate search about it.

        Args:
            index: of the view's rays; None: they are indexed anew.
        """
        index = index or sight_index(view.cloud)
        with threadpool_limits(limits=1, user_api="blas"):
            faces = _find_faces(view, index, None, np.random.default_rng(0))
            if hint is not None:
                faces = [face for face in faces if _is_near(face, hint)]
                faces += _find_faces(view, index, hint, np.random.default_rng(0))
        return FacesInSight(tuple(faces), index)


def _is_near(face: Face, hint: Float[np.ndarray, "3"]) -> bool:
    """Return whether a face's region is within 0.7 m of the hint."""
    x, y, z = face.local(np.asarray(hint, dtype=float)[None])[0]
    outside = np.maximum(np.maximum(face.low - (x, y), (x, y) - face.high), 0.0)
    return float(np.linalg.norm([*outside, z])) < _HINT_RADIUS


def _find_faces(
    view: View, index: SightIndex, hint: Float[np.ndarray, "3"] | None, rng: np.random.Generator
) -> list[Face]:
    poll()
    points, starts = view.obstacles, view.starts
    near = np.linalg.norm(points - starts, axis=1) < _RANGE
    if hint is not None:
        near &= np.linalg.norm(points - hint, axis=1) < _HINT_RADIUS
    points, starts = points[near], starts[near]
    if len(points) < _FACE.min_points:
        return []
    voxel, n_voxels = voxel_index(points, _VOXEL)
    means, counts = voxel_downsample(points, _VOXEL)
    sums = [np.bincount(voxel, weights=starts[:, i], minlength=n_voxels) for i in range(3)]
    from_where = np.stack(sums, axis=1) / counts[:, None]
    planes = list(find_planes(means, counts, from_where, rng, _WALL))
    left = np.setdiff1d(np.arange(n_voxels), np.concatenate([[], *(plane.members for plane in planes)]).astype(int))
    regions = [(plane.normal, means[plane.members]) for plane in planes]
    for patch in _patches(means[left]):
        mine = left[patch]
        if planes and np.ptp(means[mine], axis=0).max() < _SMALL:
            regions += _parallel(planes[0].normal, planes[0].offset, means[mine])
        for plane in find_planes(means[mine], counts[mine], from_where[mine], rng, _FACE):
            regions.append((plane.normal, means[mine][plane.members]))
    faces = []
    for normal, members in regions:
        if abs(normal[2]) > _STEEPEST:
            continue
        frame = _frame(normal)
        centre = members.mean(axis=0)
        low, high = np.percentile((members - centre) @ frame[:2].T, [2, 98], axis=0)
        faces.append(_refine(Face(frame, centre, low - 0.01, high + 0.01, 0.01), index))
    return [face for face in faces if face is not None]


def _parallel(
    normal: Float[np.ndarray, "3"], offset: float, points: Float[np.ndarray, "N 3"]
) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "K 3"]]]:
    """Return the fullest layer parallel to the largest wall; normals do not show a face a hand wide."""
    height = np.sort(points @ normal)
    within = np.searchsorted(height, height + _FACE.distance, side="right") - np.arange(len(height))
    low = height[int(np.argmax(within))]
    layer = points[(points @ normal >= low) & (points @ normal <= low + _FACE.distance)]
    is_fixed = abs(low - offset) < _FIXED
    return [(normal, layer)] if is_fixed and len(layer) >= _FACE.min_points else []


def _patches(points: Float[np.ndarray, "N 3"]) -> list[Int[np.ndarray, "K"]]:
    """Return indices of the points of each connected component, largest first."""
    poll()
    if not len(points):
        return []
    cells = np.floor((points - points.min(axis=0)) / _LINK).astype(np.int64)
    if np.prod(cells.max(axis=0) + 1.0) > _MOST_CELLS:
        return [np.arange(len(points))]
    grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    grid[tuple(cells.T)] = True
    labels, n_labels = ndimage.label(grid, structure=np.ones((3, 3, 3)))
    of_point = labels[tuple(cells.T)]
    counts = np.bincount(of_point, minlength=n_labels + 1)
    large = [k for k in np.argsort(-counts, kind="stable") if counts[k] >= _FACE.min_points][:_MOST_PATCHES]
    return [np.flatnonzero(of_point == k) for k in large]


def _frame(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a frame with rows x, y, z: x horizontal, z the normal."""
    x = np.array([-normal[1], normal[0], 0.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x), normal])


def face_rays(face: Face, index: SightIndex, beyond: float, most: int = _MOST_RAYS) -> FaceRays:
    """Return rays that cross the plane within ``beyond`` [m] of the region and end at most 25 cm before it.

    Args:
        most: if there are more about the region, every k-th of them is taken.
    """
    low, high = face.low - beyond, face.high + beyond
    steps = [np.linspace(low[i], high[i], max(2, int((high[i] - low[i]) / _SPACING) + 1)) for i in range(2)]
    x, y = (grid.ravel() for grid in np.meshgrid(*steps))
    spacing = max(float(step[1] - step[0]) for step in steps)
    places = face.world(np.column_stack([x, y, np.zeros(len(x))]))
    rays = index.passing(places, 0.75 * spacing + 0.02).thin(most)
    slope = rays.direction @ face.frame[2]
    rays = rays.select(slope < -_LEAST_SLOPE)
    height = (rays.start - face.centre) @ face.frame[2]
    crossing = -height / (rays.direction @ face.frame[2])
    at = face.local(rays.start + crossing[:, None] * rays.direction)[:, :2]
    ends = face.local(rays.ends)
    inside = ((at > low) & (at < high)).all(axis=1) & (ends[:, 2] < 0.25)
    return FaceRays(rays.select(inside), at[inside], ends[inside])


def _refine(face: Face, index: SightIndex) -> Face | None:
    """Return the face fitted to the ends of its rays, without protruding points; None if few are flat."""
    seen = face_rays(face, index, 0.0)
    return fit_face(face, seen.ends[((seen.ends[:, :2] > face.low) & (seen.ends[:, :2] < face.high)).all(axis=1)])


def fit_face(face: Face, ends: Float[np.ndarray, "K 3"]) -> Face | None:
    """Return the face fitted to the flat part of rays' ends; None when too few are flat.

    Args:
        ends: (K, 3) in the face's frame [m].
    """
    ends = ends[np.abs(ends[:, 2]) < _BAND]
    if len(ends) < 20:
        return None
    height = ends[:, 2]
    keep = np.abs(height - np.median(height)) < 0.03
    sigma = 0.01
    solution = np.zeros(3)
    for _ in range(4):
        if keep.sum() < 12:
            return None
        rows = np.column_stack([ends[:, :2], np.ones(len(ends))])
        solution = np.linalg.lstsq(rows[keep], height[keep], rcond=None)[0]
        rest = height - rows @ solution
        sigma = float(np.clip(1.48 * np.median(np.abs(rest[keep])), *_SIGMA))
        # Objects protrude from the face: points before it are rejected at a smaller residual than those behind.
        keep = (rest < 2.0 * sigma) & (rest > -2.5 * sigma)
    normal = face.frame[2] - solution[0] * face.frame[0] - solution[1] * face.frame[1]
    normal /= np.linalg.norm(normal)
    return Face(_frame(normal), face.centre + solution[2] * face.frame[2], face.low, face.high, sigma)
