"""Evidence that a scan shows an object and not another one: what is beside it, what of it was seen, its hull."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, QhullError, cKDTree

from perception.sightlines import Sightlines
from perception.solids.fit import MeshPose, PoseJudge, Surface, WidePlanes
from perception.solids.mesh import Mesh
from perception.solids.places import spread_samples
from perception.view import View

_SAMPLES = 300
_FACING, _CLEAR = 0.15, 0.003  # cosine; distance from the surface at which a sample's own ray starts [m]
_NEIGHBOURS, _NEIGHBOUR = 8, (0.25, 0.02)  # rays that speak for a sample; how near they meet: by the radius, and [m]
_HIDDEN = 0.06  # beyond the tolerance: a ray that ends so much before the surface says nothing about it [m]
_NOISES, _LEAST_TOLERANCE = 3.0, 0.01  # [m]
_USUAL_NOISE, _FEWEST_ON_PLANES, _MOST_ON_PLANES = 0.008, 50, 20_000  # [m]
_AT_RANGE = (0.6, 1.5)  # of an object's range: where noise is like its own
_OFF_HULL, _HOLLOW = 0.015, 0.08  # distance of a hull from the object [m], and the share of the hull that is as far
_THROUGH = 0.01  # length of a ray in the hull that counts [m]
_NEAR_ALL_ROUND, _SAME_START = 0.2, 0.01  # least cosine about the middle of a field of view; [m]
_DIRECTIONS, _OUTWARD = 100, 0.015  # [m]


@dataclass(frozen=True)
class Shape:
    """Object prepared for the weighing of its poses, in its own frame.

    Attributes:
        samples, normals: (S, 3) places spread over its surface [m], and the unit normals there.
        ends: (D, 3) places just beyond its outermost vertex in each of many directions [m].
        hull: surface of its convex hull; None if it is nearly the object's own.
    """

    surface: Surface
    centre: Float[np.ndarray, "3"]
    radius: float
    samples: Float[np.ndarray, "S 3"]
    normals: Float[np.ndarray, "S 3"]
    ends: Float[np.ndarray, "D 3"]
    hull: Surface | None

    @staticmethod
    def of(whole: Mesh, surface: Surface, centre: Float[np.ndarray, "3"], radius: float) -> Shape:
        """Return the shape of an object, given as one mesh with its surface, centre [m] and radius [m]."""
        ways = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
        outermost = whole.vertices[np.argmax(ways @ whole.vertices.T, axis=1)] - centre
        outermost *= 1.0 + _OUTWARD / np.maximum(np.linalg.norm(outermost, axis=1), 1e-6)[:, None]
        samples, normals = spread_samples(whole, _SAMPLES)
        return Shape(surface, centre, radius, samples, normals, outermost + centre, _find_hull(whole, surface))


@dataclass(frozen=True)
class Evidence:
    """Evidence for a pose.

    Attributes:
        beside: points just beyond the tolerance from the surface, by those within it: what is there has another shape.
        seen: share of the visible surface that rays reached.
        confirmed: share of that surface on which most rays end.
        telling: rays that end on the object inside its hull, or go through the hull beside the object, by those that
            end on the object: what tells it from a block; infinite for an object like its hull.
        cut: share of the directions in which the object ends out of the sensor's field of view, or at its edge.
    """

    beside: float
    seen: float
    confirmed: float
    telling: float
    cut: float


@dataclass(frozen=True)
class FieldOfView:
    """Cone of the directions that a sensor looks to, as a convex polygon in the plane at distance 1.

    Attributes:
        start: (3,) of all rays [m].
        ahead: (3,) middle direction, unit.
        across: (2, 3) directions in the plane, unit.
        sides: (E, 3) half-planes of the polygon: ``a x + b y + c <= 0``.
    """

    start: Float[np.ndarray, "3"]
    ahead: Float[np.ndarray, "3"]
    across: Float[np.ndarray, "2 3"]
    sides: Float[np.ndarray, "E 3"]

    @staticmethod
    def of(rays: Sightlines) -> FieldOfView | None:
        """Return the field of view of rays with one start; None if it has no such limits, or several starts."""
        if not len(rays) or np.abs(rays.start - rays.start[0]).max() > _SAME_START:
            return None
        ahead = rays.direction.mean(axis=0)
        ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
        depth = rays.direction @ ahead
        if depth.min() < _NEAR_ALL_ROUND:
            return None
        first = np.cross(np.eye(3)[np.argmin(np.abs(ahead))], ahead)
        first /= np.linalg.norm(first)
        across = np.stack([first, np.cross(ahead, first)])
        try:
            sides = ConvexHull((rays.direction @ across.T) / depth[:, None]).equations
        except QhullError:  # all rays in one plane
            return None
        return FieldOfView(rays.start[0], ahead, across, sides)

    def holds(self, places: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Return which places lie in it [m]."""
        depth = (places - self.start) @ self.ahead
        flat = (places - self.start) @ self.across.T / np.maximum(depth, 1e-9)[:, None]
        return np.asarray((depth > 0.0) & (flat @ self.sides[:, :2].T + self.sides[:, 2] <= 0.0).all(axis=1))


def find_noise(view: View, wide: WidePlanes, place: Float[np.ndarray, "3"]) -> float:
    """Return the deviation of points from wide planes at about the range of a place [m]; 8 mm where none are seen."""
    ranges = np.linalg.norm(view.obstacles - view.starts, axis=1)
    here = np.linalg.norm(place - view.starts, axis=1)
    alike = np.flatnonzero((ranges > _AT_RANGE[0] * here) & (ranges < _AT_RANGE[1] * here))
    offsets = wide.measure(view.obstacles[alike[:: 1 + len(alike) // _MOST_ON_PLANES]])
    if len(offsets) < _FEWEST_ON_PLANES:
        return _USUAL_NOISE
    return float(1.48 * np.median(np.abs(offsets)))


def weigh_pose(pose: MeshPose, shape: Shape, judge: PoseJudge, noise: float, field: FieldOfView | None) -> Evidence:
    """Return the evidence for a pose.

    Args:
        noise: deviation of points from the surfaces that they lie on [m].
        field: None if the sensor looks to all sides.
    """
    tolerance = max(_LEAST_TOLERANCE, _NOISES * noise)
    points = pose.to_mesh(judge.region.points)
    distance = np.linalg.norm(points - shape.surface.nearest(points)[0], axis=1)
    n_on, n_near = (int(np.count_nonzero(distance <= times * tolerance)) for times in (1.0, 2.0))
    rays = judge.rays
    start, way = pose.to_mesh(rays.start), rays.direction @ pose.rotation
    depth = shape.surface.hits(start, way)
    seen, confirmed = _look_at_samples(shape, start, way, depth, rays.length, tolerance)
    return Evidence(
        (n_near - n_on) / max(1, n_on),
        seen,
        confirmed,
        _tell_from_hull(shape.hull, start, way, depth, rays.length, tolerance),
        0.0 if field is None else 1.0 - float(field.holds(pose.to_world(shape.ends)).mean()),
    )


def _look_at_samples(
    shape: Shape,
    start: Float[np.ndarray, "R 3"],
    way: Float[np.ndarray, "R 3"],
    depth: Float[np.ndarray, "R"],
    length: Float[np.ndarray, "R"],
    tolerance: float,
) -> tuple[float, float]:
    """Return the share of the visible samples near which rays meet the surface, and of these where most rays end."""
    met = np.flatnonzero(np.isfinite(depth) & (length > depth - tolerance - _HIDDEN))
    if not len(met):
        return 0.0, 0.0
    towards = start[met].mean(axis=0) - shape.samples
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    is_facing = np.abs((towards * shape.normals).sum(axis=1)) > _FACING
    is_visible = is_facing & ~np.isfinite(shape.surface.hits(shape.samples + _CLEAR * towards, towards))
    if not is_visible.any():
        return 0.0, 0.0
    places = start[met] + depth[met, None] * way[met]
    reach = max(_NEIGHBOUR[0] * shape.radius, _NEIGHBOUR[1])
    _, near = cKDTree(places).query(shape.samples[is_visible], k=min(_NEIGHBOURS, len(met)), distance_upper_bound=reach)
    near = near.reshape(int(is_visible.sum()), -1)
    is_there = near < len(met)
    ends = np.append(np.abs(length[met] - depth[met]) <= tolerance, False)[near]
    counts = is_there.sum(axis=1)
    is_seen = counts > 0
    is_confirmed = is_seen & (2 * ends.sum(axis=1) >= counts)
    return float(is_seen.mean()), float(is_confirmed.sum() / max(1, is_seen.sum()))


def _tell_from_hull(
    hull: Surface | None,
    start: Float[np.ndarray, "R 3"],
    way: Float[np.ndarray, "R 3"],
    depth: Float[np.ndarray, "R"],
    length: Float[np.ndarray, "R"],
    tolerance: float,
) -> float:
    """Return the rays that an object's hull would have stopped, by those that end on the object."""
    if hull is None:
        return float("inf")
    entry = hull.hits(start, way)
    is_in = np.isfinite(entry)
    start, way, depth, length, entry = start[is_in], way[is_in], depth[is_in], length[is_in], entry[is_in]
    ends = np.abs(length - depth) <= tolerance
    goes_in = (length > entry + tolerance) & (ends | ~np.isfinite(depth))
    goes_in &= hull.contains(start + (entry + _THROUGH)[:, None] * way)
    tells = goes_in & ((depth - entry > tolerance) | ~ends)
    return int(tells.sum()) / max(1, int(ends.sum()))


def _find_hull(whole: Mesh, surface: Surface) -> Surface | None:
    """Return the surface of an object's convex hull; None if the object's surface is nearly that of the hull."""
    try:
        hull = Mesh(whole.vertices, ConvexHull(whole.vertices).simplices.astype(np.int64))
    except QhullError:  # a flat mesh
        return None
    places, _ = spread_samples(hull, _SAMPLES)
    is_off = np.linalg.norm(places - surface.nearest(places)[0], axis=1) > _OFF_HULL
    return Surface(hull) if is_off.mean() > _HOLLOW else None
