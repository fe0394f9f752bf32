"""Detection of cordless drills that stand on a shelf or table: clusters on level surfaces, held against the shape of a
drill by the rays that should end on it and those that should pass its notches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from perception.clean import voxel_downsample
from perception.detect.confidence import rising
from perception.detect.detection import Detection
from perception.detect.sightlines import SightIndex, Sightlines, sight_index
from perception.detect.supports import StandingCluster, standing_clusters
from perception.view import View

_TALL = (0.15, 0.33)
_WIDE = 0.38
_HINT_RADIUS = 0.4
_REPORTED = 0.05
# Seen from ahead or behind a drill has no notch that tells it from a bottle.
_UNSEEN_NOTCH, _UNSEEN_HINTED = 0.3, 0.9
_YAWS = np.radians(np.arange(0.0, 360.0, 15.0))
_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.006
_NEAR = 0.035
_WORST = 9.0
_MOST_RAYS = 400
_MOST_CLUSTERS = 6
_MOST_POINTS = 200
# Usual half sizes: of the battery's foot, and radii of body and grip; its base is as high as the foot [m].
_FOOT = (0.06, 0.035, 0.0275)
_BODY_RADIUS = 0.031
_NOSE_RADIUS = 0.02
_NOSE_SHARE = 0.34
_GRIP_RADIUS = 0.021


@dataclass(frozen=True)
class Shape:
    """A drill's place and sizes.

    Attributes:
        x, y: of the grip on its support [m].
        yaw: of the chuck about z [rad].
        grip: length of the grip [m].
        body: length of the body with its chuck [m].
        back: how far the body reaches behind the grip [m].
    """

    x: float
    y: float
    yaw: float
    grip: float = 0.125
    body: float = 0.2
    back: float = 0.07

    @classmethod
    def of(cls, values: Float[np.ndarray, "6"]) -> Shape:
        """From numbers in the order of the attributes."""
        x, y, yaw, grip, body, back = values.tolist()
        return cls(x, y, yaw, grip, body, back)

    @property
    def values(self) -> Float[np.ndarray, "6"]:
        """In the order of the attributes."""
        return np.array([self.x, self.y, self.yaw, self.grip, self.body, self.back])


@dataclass(frozen=True)
class Solids:
    """Parts of a drill, each what lies within a radius of a segment.

    Attributes:
        first, last: (S, 3) ends of the segments, in the drill's frame on its support [m].
        radius: (S,) [m].
    """

    first: Float[np.ndarray, "S 3"]
    last: Float[np.ndarray, "S 3"]
    radius: Float[np.ndarray, "S"]


def solids_of(shape: Shape) -> Solids:
    """Capsules: body, nose, grip and three for the battery's foot."""
    foot = 2.0 * _FOOT[2]
    top = foot + shape.grip + 0.03
    front, nose = shape.body - shape.back, _NOSE_SHARE * shape.body
    r, low = _FOOT[2], _FOOT[2]
    across = _FOOT[1] - r
    parts = [
        ((-shape.back + _BODY_RADIUS, 0.0, top), (front - nose - 0.5 * _BODY_RADIUS, 0.0, top), _BODY_RADIUS),
        ((front - nose, 0.0, top), (front - _NOSE_RADIUS, 0.0, top), _NOSE_RADIUS),
        ((0.0, 0.0, foot), (0.0, 0.0, top), _GRIP_RADIUS),
        ((-0.05 + r, -across, low), (0.07 - r, -across, low), r),
        ((-0.05 + r, across, low), (0.07 - r, across, low), r),
    ]
    first, last, radius = (np.array(column) for column in zip(*parts, strict=True))
    return Solids(first, last, radius)


def meet(rays: Sightlines, shape: Shape, level: float) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """How far outside the drill each ray passes (negative inside), and how deep along it the nearest part lies [m]."""
    rotation = _about_up(-shape.yaw)
    start = (rays.start - (shape.x, shape.y, level)) @ rotation.T
    way = rays.direction @ rotation.T
    solids = solids_of(shape)
    apart, along = _rays_to_segments(start, way, solids.first, solids.last)
    radius = solids.radius[:, None]
    beyond = apart - radius
    enters = along - np.sqrt(np.maximum(radius**2 - np.minimum(apart, radius) ** 2, 0.0))
    # Of the parts a ray meets the first counts; of those it misses the nearest.
    outside, is_hit = beyond.min(axis=0), beyond < 0.0
    nearest = np.take_along_axis(enters, beyond.argmin(axis=0)[None], axis=0)[0]
    first = np.where(is_hit, enters, np.inf).min(axis=0)
    return outside, np.where(outside < 0.0, first, nearest)


def _about_up(angle: float) -> Float[np.ndarray, "3 3"]:
    """Turn about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _rays_to_segments(
    start: Float[np.ndarray, "N 3"],
    way: Float[np.ndarray, "N 3"],
    first: Float[np.ndarray, "S 3"],
    last: Float[np.ndarray, "S 3"],
) -> tuple[Float[np.ndarray, "S N"], Float[np.ndarray, "S N"]]:
    """Distance of each ray from each segment, and where along the ray it is nearest [m]."""
    side = last - first
    a, b = side @ way.T, (side**2).sum(axis=1)[:, None]
    c = (way * start).sum(axis=1) - first @ way.T
    d = side @ start.T - (side * first).sum(axis=1)[:, None]
    share = np.clip((d - a * c) / np.maximum(b - a**2, 1e-9), 0.0, 1.0)
    along = share * a - c
    square = np.zeros_like(along)
    for i in range(3):
        offset = start[:, i] - first[:, i, None] + along * way[:, i] - share * side[:, i, None]
        square += offset * offset
    return np.sqrt(square), along


def detect_drill(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Drills, best first; origin the middle of the grip, z up along it, x along the chuck.

    Sizes are grip_length and body_length.

    Args:
        view: the scan.
        hint: (3,) a point near the drill: only what stands within 0.4 m of it is looked at [m].
    """
    if not len(view.obstacles):
        return []
    index = sight_index(view.cloud)
    clusters = [one for one in standing_clusters(view) if _fits(one)]
    if hint is not None:
        clusters = [one for one in clusters if np.linalg.norm(one.points.mean(axis=0) - hint) < _HINT_RADIUS]
    found = [_examine(index, one, hint is not None) for one in clusters[:_MOST_CLUSTERS]]
    return sorted((one for one in found if one.confidence > _REPORTED), key=lambda one: -one.confidence)


def _fits(cluster: StandingCluster) -> bool:
    """Whether a cluster may be a drill by its size."""
    low, high = np.percentile(cluster.points, [3, 97], axis=0)
    return bool(_TALL[0] < high[2] - cluster.level < _TALL[1] and np.hypot(*(high - low)[:2]) < _WIDE)


def _examine(index: SightIndex, cluster: StandingCluster, is_hinted: bool) -> Detection:
    """Fit a drill to what stands there and weigh it."""
    places, _ = voxel_downsample(cluster.points, 0.05)
    rays = index.passing(places, 0.1).thinned(_MOST_RAYS)
    height = rays.ends[:, 2] - cluster.level
    # What ended on the support passed beside the drill.
    on_support = np.abs(height) < 0.015
    tall = float(np.percentile(cluster.points[:, 2], 98)) - cluster.level
    grip = float(np.clip(tall - 2.0 * _FOOT[2] - 0.03 - _BODY_RADIUS, 0.08, 0.17))

    may_end = ~on_support & (rays.ends[:, 2] > cluster.level + 0.01)

    def cost(values: Float[np.ndarray, "6"]) -> float:
        return _cost(rays, may_end, cluster.level, Shape.of(values))

    starts = _starts(cluster, grip)
    ranked = sorted(starts, key=lambda shape: cost(shape.values))
    steps = np.array([0.015, 0.015, 0.15, 0.012, 0.02, 0.012])
    results = []
    for start in _distinct(ranked)[:3]:
        simplex = np.concatenate([start.values[None], start.values + np.diag(steps)])
        results.append(
            minimize(
                cost,
                start.values,
                method="Nelder-Mead",
                options={"initial_simplex": simplex, "maxfev": 180, "xatol": 1e-3},
            )
        )
    best = min(results, key=lambda result: float(result.fun))
    return _judged(rays, on_support, cluster, Shape.of(best.x), is_hinted)


def _starts(cluster: StandingCluster, grip: float) -> list[Shape]:
    """The cluster's middle is somewhere between grip and chuck."""
    low, high = np.percentile(cluster.points[:, :2], [3, 97], axis=0)
    middle = 0.5 * (low + high)
    shapes = []
    for yaw in _YAWS.tolist():
        for ahead in (0.0, 0.03):
            x, y = middle - ahead * np.array([np.cos(yaw), np.sin(yaw)])
            shapes.append(Shape(float(x), float(y), yaw, grip))
    return shapes


def _distinct(shapes: list[Shape]) -> list[Shape]:
    """Of those that look nearly the same way only the first."""
    kept: list[Shape] = []
    for shape in shapes:
        if all(abs(np.angle(np.exp(1j * (shape.yaw - other.yaw)))) > 0.6 for other in kept):
            kept.append(shape)
    return kept


def _cost(rays: Sightlines, may_end: Bool[np.ndarray, "N"], level: float, shape: Shape) -> float:
    """Mean squared residual of depth and outline, none worse than three standard deviations, and what is usual."""
    outside, depth = meet(rays, shape, level)
    gap = rays.length - depth
    ended = (np.abs(gap) < 0.12) & may_end
    on = (gap / _SIGMA_DEPTH) ** 2 + (np.maximum(outside, 0.0) / _SIGMA_EDGE) ** 2
    off = (np.maximum(-outside, 0.0) / _SIGMA_EDGE) ** 2 * (gap > 0.0)
    each = np.minimum(np.where(ended, on, off), _WORST)
    usual = ((shape.grip - 0.125) / 0.02) ** 2 + ((shape.body - 0.2) / 0.03) ** 2 + ((shape.back - 0.07) / 0.015) ** 2
    return float(each.mean() + 0.03 * usual)


def _judged(
    rays: Sightlines, on_support: Bool[np.ndarray, "N"], cluster: StandingCluster, shape: Shape, is_hinted: bool
) -> Detection:
    """The drill as a detection."""
    outside, depth = meet(rays, shape, cluster.level)
    gap = rays.length - depth
    ended = (np.abs(gap) < 0.12) & ~on_support & (rays.ends[:, 2] > cluster.level + 0.01)
    inside = (outside < -0.004) & (gap > -_NEAR)
    solid = float((ended & (np.abs(gap) < _NEAR))[inside].mean()) if inside.any() else 0.0
    explained = float((outside[ended] < 0.012).mean()) if ended.any() else 0.0
    notch_open, notch_seen = _notch(rays, shape, cluster.level)
    hit = ended & inside & (np.abs(gap) < _NEAR)
    rms = float(np.sqrt(np.mean(gap[hit] ** 2))) if hit.any() else float("inf")
    known = rising(float(notch_seen), 3.0, 12.0)
    value = (
        rising(solid, 0.7, 0.9)
        * rising(explained, 0.7, 0.9)
        * (known * rising(notch_open, 0.4, 0.8) + (1.0 - known) * (_UNSEEN_HINTED if is_hinted else _UNSEEN_NOTCH))
        * rising(-rms, -0.02, -0.014)
        * rising(float(hit.sum()), 15.0, 60.0)
    )
    foot = 2.0 * _FOOT[2]
    pose = np.eye(4)
    pose[:3, :3] = _about_up(shape.yaw)
    pose[:3, 3] = (shape.x, shape.y, cluster.level + foot + 0.5 * shape.grip)
    sizes = {"grip_length": shape.grip, "body_length": shape.body}
    residuals = {
        "rms": rms,
        "solid_share": solid,
        "explained_share": explained,
        "notch_open_share": notch_open,
        "n_notch_rays": float(notch_seen),
    }
    points = rays.ends[hit]
    confidence = float(value**0.7 if is_hinted else value)
    return Detection("drill", pose, sizes, confidence, residuals, points[:: max(1, len(points) // _MOST_POINTS)])


def _notch(rays: Sightlines, shape: Shape, level: float) -> tuple[float, int]:
    """How many of the rays between chuck and foot before the grip went on behind it, and how many there were.

    The plane of chuck and grip is crossed there by rays that come from the side; seen from ahead or behind, the
    body's overhang hides the notch and nothing can be said.
    """
    rotation = _about_up(-shape.yaw)
    start = (rays.start - (shape.x, shape.y, level)) @ rotation.T
    way = rays.direction @ rotation.T
    slope = np.where(np.abs(way[:, 1]) < 1e-3, 1e-3, way[:, 1])
    depth = -start[:, 1] / slope
    place = start + depth[:, None] * way
    foot = 2.0 * _FOOT[2]
    top = foot + shape.grip + 0.03
    inside = (np.abs(way[:, 1]) > 0.2) & (place[:, 2] > foot + 0.015) & (place[:, 2] < top - _BODY_RADIUS - 0.012)
    ahead = inside & (place[:, 0] > _GRIP_RADIUS + 0.015) & (place[:, 0] < shape.body - shape.back - 0.01)
    behind = inside & (place[:, 0] < -_GRIP_RADIUS - 0.015) & (place[:, 0] > -shape.back - 0.01)
    looked = (ahead | behind) & (rays.length > depth - 0.06)
    if not looked.any():
        return 0.0, 0
    return float((rays.length > depth + 0.04)[looked].mean()), int(looked.sum())
