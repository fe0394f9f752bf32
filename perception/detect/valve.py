"""Detection of wheel valves: circles proposed, rims fitted to the rays, evidence weighed into a confidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from perception.clean import Reach, voxel_downsample, voxel_index
from perception.cloud import Cloud
from perception.convex.planes import PlaneSettings, find_planes
from perception.detect.circles import Circle, find_circles
from perception.detect.detection import Detection
from perception.detect.wheel import Passage, Rays, Ring, fit_ring, pass_ring, rays_of, rim_hits, wheel_basis
from perception.view import View, make_view

_VOXEL = 0.015
_WALL = PlaneSettings(min_size=0.45, min_points=150, max_planes=12, n_neighbours=20)
_HINT_RADIUS = 0.5
_SECTORS = 36
_BEHIND = 0.05
_DEPTH = 0.06
_SPOKE_DEPTH = 0.04
_REPORTED = 0.05
_WALL_VOXEL = 0.03
_EXAMINED = 6
_CORRIDOR = 0.005
_HOPELESS = 0.005


@dataclass(frozen=True)
class ValveDetection:
    """A wheel valve as seen.

    Attributes:
        centre: (3,) of the rim [m].
        axis: (3,) unit, towards the sensor.
        rim_radius: of the rim's centre line [m].
        outer_radius: [m].
        tube_radius: half width of the rim along the radius [m].
        half_depth: half thickness of the rim along the axis [m].
        spoke_angles: about the axis, from ``wheel_basis(axis)[0]`` (horizontal), right-handed [rad].
        hub_radius: inside it nothing was seen through [m].
        inner_depth: lowest and highest place along the axis of what was seen inside the rim [m].
        confidence: 0 to 1.
        rms: of the rim's depth residuals [m].
        n_inliers: rays that ended on the rim.
        spoke_half_width: of the spokes [m].
        spoke_share: how much of what was seen between hub and rim the spokes explain, 0 to 1.
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    rim_radius: float
    outer_radius: float
    tube_radius: float
    half_depth: float
    spoke_angles: tuple[float, ...]
    hub_radius: float
    inner_depth: tuple[float, float]
    confidence: float
    rms: float
    n_inliers: int
    spoke_half_width: float = 0.0
    spoke_share: float = 0.0

    @property
    def ring(self) -> Ring:
        """The rim."""
        return Ring(self.centre, self.axis, self.rim_radius, self.tube_radius, self.half_depth)


def detect_valves(
    cloud: Cloud,
    hint: Float[np.ndarray, "3"] | None = None,
    reach: Reach | None = None,
    seed: int = 0,
) -> list[ValveDetection]:
    """Wheel valves, best first; a confidence of 0.5 or more is one to act on.

    Args:
        cloud: the scan.
        hint: (3,) a point near the wheel: only what lies within half a metre of it is looked at [m].
        reach: where to look; by default within 3 m.
        seed: of the hypotheses.
    """
    return detect_in(make_view(cloud, reach=reach or Reach(), seed=seed), hint)


def detect_in(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[ValveDetection]:
    """As :func:`detect_valves`, in a scan made ready."""
    obstacles, cloud = view.obstacles, view.cloud
    if not len(obstacles):
        return []
    rng = np.random.default_rng(view.seed)
    candidates, _ = voxel_downsample(_before_walls(obstacles, cloud.origin, rng), _VOXEL)
    if hint is not None:
        candidates = candidates[np.linalg.norm(candidates - hint, axis=1) < _HINT_RADIUS]
    rays = rays_of(cloud.origin, cloud.points)
    # The fits are many and small: with several threads BLAS spends seven times as long on handing them out.
    with threadpool_limits(limits=1, user_api="blas"):
        circles = find_circles(candidates, cloud.origin, rng)
        circles.sort(key=lambda circle: -circle.score * _promise(circle, rays))
        detections = [_examine(circle, rays) for circle in circles[:_EXAMINED]]
    detections = [d for d in detections if d.confidence >= _REPORTED]
    detections.sort(key=lambda d: -d.confidence)
    return _apart(detections)


def as_detection(valve: ValveDetection) -> Detection:
    """The valve in the words all detectors share: z of its frame is the axis, x horizontal, origin the rim's centre."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = wheel_basis(valve.axis).T, valve.centre
    sizes = {"outer_radius": valve.outer_radius, "rim_radius": valve.rim_radius, "tube_radius": valve.tube_radius}
    angle = 2.0 * np.pi * np.arange(36) / 36
    rim = valve.rim_radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(36)])
    points = rim @ pose[:3, :3].T + valve.centre
    return Detection("valve", pose, sizes, valve.confidence, {"rms": valve.rms}, points)


def _before_walls(
    obstacles: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], rng: np.random.Generator
) -> Float[np.ndarray, "M 3"]:
    """The points that no large plane explains; planes are sought in large voxels, whose means scatter less."""
    voxel, n_voxels = voxel_index(obstacles, _WALL_VOXEL)
    means, counts = voxel_downsample(obstacles, _WALL_VOXEL)
    keep = np.ones(n_voxels, dtype=bool)
    for plane in find_planes(means, counts, origin, rng, _WALL):
        keep[plane.members] = keep[plane.noise] = False
    return np.asarray(obstacles[keep[voxel]])


def _promise(circle: Circle, rays: Rays) -> float:
    """How much more often rays end on the circle than just outside it, 0 to 1; needs no exact circle."""
    near = rays.towards(circle.centre, circle.radius + 0.09)
    passage = pass_ring(near, Ring(circle.centre, circle.axis, circle.radius, 0.02, 0.02))
    behind = near.length - passage.crossing
    known = behind > -_BEHIND
    solid = np.abs(behind) < _BEHIND
    distance = np.linalg.norm(passage.place, axis=1) - circle.radius
    rim, around = known & (np.abs(distance) < 0.02), known & (distance > 0.045) & (distance < 0.08)
    if not rim.any() or not around.any():
        return 0.0
    return float(max(0.0, solid[rim].mean() - solid[around].mean()))


def _apart(detections: list[ValveDetection]) -> list[ValveDetection]:
    """Without those inside the disc of a surer one: rings about its hub or spokes are the same wheel."""
    kept: list[ValveDetection] = []
    for one in detections:
        if all(np.linalg.norm(one.centre - other.centre) > other.outer_radius for other in kept):
            kept.append(one)
    return kept


def _examine(circle: Circle, rays: Rays) -> ValveDetection:
    """Fit the rim and weigh the evidence."""
    near = rays.towards(circle.centre, 1.4 * circle.radius + 0.12)
    ring = fit_ring(near, Ring(circle.centre, circle.axis, circle.radius, 0.015, 0.012), n_rounds=1)
    first = _judged(rays, ring)
    return first if first.confidence < _HOPELESS else _judged(rays, fit_ring(near, ring, n_rounds=2))


def _judged(rays: Rays, ring: Ring) -> ValveDetection:
    """The ring as a detection, with what is inside it and how much speaks for it."""
    if ring.axis @ (rays.origin - ring.centre) < 0.0:
        ring = Ring(ring.centre, -ring.axis, ring.radius, ring.half_width, ring.half_depth)
    near = rays.towards(ring.centre, 1.4 * ring.radius + 0.12)
    passage = pass_ring(near, ring)
    hit = rim_hits(near, ring, passage)
    rms = float(np.sqrt(np.mean((near.length - passage.depth)[hit] ** 2))) if hit.any() else np.inf
    inside = _inside(near, ring, passage)
    return ValveDetection(
        ring.centre,
        ring.axis,
        ring.radius,
        ring.radius + ring.half_width,
        ring.half_width,
        ring.half_depth,
        inside.spoke_angles,
        inside.hub_radius,
        inside.depth,
        _confidence(near, ring, passage, hit, inside.open_share, rms),
        rms,
        int(hit.sum()),
        inside.spoke_half_width,
        inside.spoke_share,
    )


def _confidence(
    rays: Rays, ring: Ring, passage: Passage, hit: Bool[np.ndarray, "N"], open_share: float, rms: float
) -> float:
    """Product of: rim seen all round, air around it, openings in it, a rim's proportions, depths that agree."""
    through = rays.length > passage.depth + _BEHIND
    distance = np.linalg.norm(passage.place, axis=1)
    sector = (
        np.floor(np.arctan2(passage.place[:, 1], passage.place[:, 0]) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    )
    inside_rim = passage.level < 0.9
    rim = _shares(sector, inside_rim & hit, inside_rim & (hit | through))
    outer = ring.radius + ring.half_width
    around = (distance > outer + 0.012) & (distance < outer + 0.05)
    # Air: rays that went on, or ended well before or behind the rim's plane.
    solid = around & (np.abs(rays.length - passage.crossing) < _BEHIND)
    air = _shares(sector, around & ~solid, around)
    seen = ~np.isnan(rim)
    if seen.mean() < 0.4:
        return 0.0
    complete = float(np.nanmean(rim > 0.6) * min(1.0, np.sum(seen & (rim > 0.6)) / (0.6 * _SECTORS)))
    airy = float(np.mean(air[~np.isnan(air)] > 0.7)) if (~np.isnan(air)).any() else 0.0
    return float(
        _rising(complete, 0.55, 0.9)
        * _rising(airy, 0.45, 0.85)
        * _rising(open_share, 0.02, 0.08)
        * _rising(-ring.half_width / ring.radius, -0.5, -0.35)
        * _rising(-rms, -0.03, -0.02)
        * _rising(float(hit.sum()), 15.0, 60.0)
    )


def _shares(sector: np.ndarray, these: Bool[np.ndarray, "N"], all_of: Bool[np.ndarray, "N"]) -> Float[np.ndarray, "S"]:
    """Share per sector; NaN where there is nothing."""
    total = np.bincount(sector[all_of], minlength=_SECTORS).astype(float)
    total[total == 0.0] = np.nan
    return np.asarray(np.bincount(sector[these], minlength=_SECTORS) / total)


def _rising(value: float, low: float, high: float) -> float:
    """0 up to ``low``, 1 from ``high`` on, smooth between."""
    x = float(np.clip((value - low) / (high - low), 0.0, 1.0))
    return x * x * (3.0 - 2.0 * x)


@dataclass(frozen=True)
class _Inside:
    """What is inside the rim."""

    spoke_angles: tuple[float, ...]
    spoke_half_width: float
    spoke_share: float
    hub_radius: float
    depth: tuple[float, float]
    open_share: float


def _inside(rays: Rays, ring: Ring, passage: Passage) -> _Inside:
    """Openings, spokes and hub from which rays inside the rim ended at the wheel and which went on."""
    distance = np.linalg.norm(passage.place, axis=1)
    inner = ring.radius - ring.half_width
    behind = rays.length - passage.crossing
    solid, through = np.abs(behind) < _DEPTH, behind >= _DEPTH
    known = (distance < inner - 0.004) & (solid | through)
    if known.sum() < 5 or inner <= 0.02:
        return _Inside((), 0.0, 0.0, max(inner, 0.0), (-ring.half_depth, ring.half_depth), 0.0)
    height = (rays.ends - ring.centre) @ ring.axis
    at_wheel = known & solid
    depth = tuple(np.percentile(height[at_wheel], [4, 96])) if at_wheel.any() else (-ring.half_depth, ring.half_depth)
    open_share = float((known & through).sum() / known.sum())
    hub = _hub_radius(distance[known], solid[known], inner)
    band = known & (distance > max(1.1 * hub, 0.45 * inner))
    angles, half, explained = _spokes(passage.place[band], (np.abs(behind) < _SPOKE_DEPTH)[band])
    return _Inside(angles, half, explained, hub, (float(depth[0]), float(depth[1])), open_share)


def _hub_radius(distance: Float[np.ndarray, "N"], solid: Bool[np.ndarray, "N"], inner: float) -> float:
    """The largest radius within which four fifths of the rays ended at the wheel."""
    edges = np.linspace(0.0, inner, 13)[1:]
    radius = 0.0
    for low, high in zip(np.concatenate([[0.0], edges[:-1]]), edges, strict=True):
        ring = (distance >= low) & (distance < high)
        if ring.any() and solid[ring].mean() < 0.8:
            break
        radius = float(high)
    return radius


def _spokes(place: Float[np.ndarray, "N 2"], solid: Bool[np.ndarray, "N"]) -> tuple[tuple[float, ...], float, float]:
    """Angles of the spokes, their half width, and how much of what is solid they explain.

    A narrow corridor is turned about the axis; where most of the rays in it ended at the wheel there is a spoke.

    Args:
        place: (N, 2) where rays cross the wheel between hub and rim [m].
        solid: (N,) which of them ended at the wheel.
    """
    nothing: tuple[tuple[float, ...], float, float] = (), 0.0, 0.0
    angle = np.radians(np.arange(0.0, 360.0, 2.0))
    along = place @ np.stack([np.cos(angle), np.sin(angle)])
    apart = np.abs(place @ np.stack([-np.sin(angle), np.cos(angle)]))
    corridor = (along > 0.0) & (apart < _CORRIDOR)
    total = corridor.sum(axis=0)
    if (total < 2).mean() > 0.2 or not solid.any():
        return nothing
    hits = corridor[solid].sum(axis=0)
    share = hits / np.maximum(total, 1)
    # One or two mixed pixels make no spoke.
    is_spoke = (share > 0.4) & (hits >= 3)
    if is_spoke.all() or not is_spoke.any():
        return nothing
    start = int(np.flatnonzero(~is_spoke)[0])
    runs = np.flatnonzero(np.diff(np.concatenate([[0], np.roll(is_spoke, -start).astype(int), [0]]))).reshape(-1, 2)
    angles = []
    for low, high in runs:
        mine = (np.arange(low, high) + start) % len(angle)
        centre = np.sum(share[mine] * np.exp(1j * angle[mine]))
        angles.append(float(np.angle(centre) % (2.0 * np.pi)))
    lines = np.array(angles)
    distance = np.abs(place[solid] @ np.stack([-np.sin(lines), np.cos(lines)]))
    distance[place[solid] @ np.stack([np.cos(lines), np.sin(lines)]) <= 0.0] = np.inf
    nearest = distance.min(axis=1)
    explained = nearest < 2.0 * _CORRIDOR + 0.01
    half = float(np.percentile(nearest[explained], 90)) if explained.any() else 0.0
    return tuple(sorted(angles)), half, float(explained.mean())
