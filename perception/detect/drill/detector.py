"""Detection of cordless drills that stand on a shelf or table, by the rays that hit or pass a drill's shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from perception.cleaning.clean import voxel_downsample
from perception.detect.drill.shape import BODY_RADIUS, FOOT, DrillShape, about_up, meet, notch_open
from perception.detect.drill.supports import StandingCluster, dense_parts, standing_clusters, support_share
from perception.detect.shared.arithmetic import rising
from perception.detect.shared.detection import Detection
from perception.detect.shared.local import best_about
from perception.sightlines import SightIndex, Sightlines, sight_index
from perception.view import View

_TALL = (0.15, 0.33)
_WIDE = 0.38
_HINT_RADIUS = 0.4
_REPORTED = 0.05
# Without rays into its notches a drill cannot be distinguished from a bottle.
_UNSEEN_NOTCH, _UNSEEN_HINTED = 0.3, 0.9
_YAWS = np.radians(np.arange(0.0, 360.0, 15.0))
_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.006
_NEAR = 0.035
_WORST = 9.0
_MOST_RAYS, _FEW_RAYS = 2000, 400
_MOST_CLUSTERS, _MOST_FITS = 24, 6
_OVER_SUPPORT = (0.015, 0.03)
# The surface that a drill stands on extends beside its foot, on most sides.
_SUPPORTED = (0.6, 0.85)
# Cost by which the opposite direction must be worse, and rating of a drill whose direction is unknown.
_REVERSE, _EITHER_WAY = (0.0, 0.08), 0.3
_SAME = 0.15  # [m]
_MOST_POINTS = 200


def detect_drill(
    view: View, hint: Float[np.ndarray, "3"] | None = None, index: SightIndex | None = None
) -> list[Detection]:
    """Find drills, best first; origin the middle of the grip, z up along it, x along the chuck.

    Sizes are grip_length and body_length.

    Args:
        hint: (3,) a point near the drill [m]; only clusters within 0.4 m of it are searched.
        index: of the view's rays; None: they are indexed anew.
    """
    if not len(view.obstacles):
        return []
    index = index or sight_index(view.cloud)
    clusters = [part for cluster in standing_clusters(view) for part in _of_a_size(cluster)]
    if hint is not None:
        clusters = [
            cluster for cluster in clusters if np.linalg.norm(cluster.points.mean(axis=0) - hint) < _HINT_RADIUS
        ]
    held = [(cluster, share) for cluster in clusters if (share := support_share(index, cluster)) > _SUPPORTED[0]]
    begun = sorted((_begin(index, *start) for start in held[:_MOST_CLUSTERS]), key=lambda start: start.least_cost)
    hits = [_finish(begun_fit, hint is not None) for begun_fit in begun[:_MOST_FITS]]
    hits = sorted((hit for hit in hits if hit.confidence > _REPORTED), key=lambda hit: -hit.confidence)
    places = np.array([hit.pose_world_object[:3, 3] for hit in hits])
    return [hits[i] for i in best_about(places, _SAME, 1)]


def _of_a_size(cluster: StandingCluster) -> list[StandingCluster]:
    """Return the densest parts of a cluster that have the size of a drill."""
    if not _TALL[0] < _size(cluster)[0] < _TALL[1]:
        return []
    for parts in dense_parts(cluster):
        fitting = [part for part in parts if _TALL[0] < _size(part)[0] < _TALL[1] and _size(part)[1] < _WIDE]
        if fitting:
            return fitting
    return []


def _size(cluster: StandingCluster) -> tuple[float, float]:
    """Return the height over the support and the diagonal of the footprint, outliers ignored [m]."""
    low, high = np.percentile(cluster.points, [3, 97], axis=0)
    return float(high[2] - cluster.level), float(np.hypot(*(high - low)[:2]))


@dataclass(frozen=True)
class _Begun:
    """Cluster with the starts of its fit.

    Attributes:
        supported: share of the rays beside its foot that ended on its support.
        least: world z over which a ray may have ended on the drill; lower ends are on the support [m].
        rays: rays that pass near it; ``few`` is a subset for the fit.
        starts: shapes of different yaw, best first.
        least_cost: cost of the first start.
    """

    cluster: StandingCluster
    supported: float
    least: float
    rays: Sightlines
    few: Sightlines
    starts: tuple[DrillShape, ...]
    least_cost: float


def _begin(index: SightIndex, cluster: StandingCluster, supported: float) -> _Begun:
    """Return the rays and starts of a cluster's fit."""
    places, _ = voxel_downsample(cluster.points, 0.05)
    rays = index.passing(places, 0.1).thin(_MOST_RAYS)
    few = rays.thin(_FEW_RAYS)
    least = cluster.level + _over_support(rays, cluster.level)
    tall = float(np.percentile(cluster.points[:, 2], 98)) - cluster.level
    grip = float(np.clip(tall - 2.0 * FOOT[2] - 0.03 - BODY_RADIUS, 0.08, 0.17))
    costs = [(_cost(few, least, cluster.level, shape), shape) for shape in _starts(cluster, grip)]
    costs.sort(key=lambda pair: pair[0])
    starts = tuple(_drop_duplicates([shape for _, shape in costs])[:3])
    return _Begun(cluster, supported, least, rays, few, starts, costs[0][0])


def _finish(begun: _Begun, is_hinted: bool) -> Detection:
    """Fit a drill to the cluster from each start and return the best as a detection.

    The best drill turned about its grip is a start as well: grip and battery look alike from ahead and behind, and the
    confidence is low where the rays do not tell the chuck from the motor.
    """
    fits = [_fit(begun, start) for start in begun.starts]
    best = min(fits, key=lambda pair: pair[1])[0]
    fits.append(_fit(begun, replace(best, yaw=best.yaw + np.pi, back=best.body - best.back)))
    fits.append(_fit(begun, replace(best, yaw=best.yaw + np.pi)))
    best, cost = min(fits, key=lambda pair: pair[1])
    reversed_costs = [other for shape, other in fits if np.cos(shape.yaw - best.yaw) < 0.0]
    return _judge(begun, best, float(min(reversed_costs, default=cost + _WORST) - cost), is_hinted)


def _fit(begun: _Begun, start: DrillShape) -> tuple[DrillShape, float]:
    """Return the drill fitted to a cluster's rays from a start, and its cost on all of them."""
    level = begun.cluster.level
    steps = np.array([0.015, 0.015, 0.15, 0.012, 0.02, 0.012])

    def cost(values: Float[np.ndarray, "6"]) -> float:
        return _cost(begun.few, begun.least, level, DrillShape.of(values))

    simplex = np.concatenate([start.values[None], start.values + np.diag(steps)])
    result = minimize(
        cost,
        start.values,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 180, "xatol": 1e-3},
    )
    shape = DrillShape.of(result.x)
    return shape, _cost(begun.rays, begun.least, level, shape)


def _starts(cluster: StandingCluster, grip: float) -> list[DrillShape]:
    """Return shapes of all yaws at the cluster's middle, which is between grip and chuck."""
    low, high = np.percentile(cluster.points[:, :2], [3, 97], axis=0)
    middle = 0.5 * (low + high)
    shapes = []
    for yaw in _YAWS.tolist():
        for ahead in (0.0, 0.03):
            x, y = middle - ahead * np.array([np.cos(yaw), np.sin(yaw)])
            shapes.append(DrillShape(float(x), float(y), yaw, grip))
    return shapes


def _drop_duplicates(shapes: list[DrillShape]) -> list[DrillShape]:
    """Keep only the first of shapes with nearly the same yaw."""
    kept: list[DrillShape] = []
    for shape in shapes:
        if all(abs(np.angle(np.exp(1j * (shape.yaw - other.yaw)))) > 0.6 for other in kept):
            kept.append(shape)
    return kept


def _over_support(rays: Sightlines, level: float) -> float:
    """Return the height over a support that its noise reaches [m]."""
    height = np.abs(rays.ends[:, 2] - level)
    near = height[height < 2.0 * _OVER_SUPPORT[1]]
    noise = 1.4826 * float(np.median(near)) if len(near) else 0.0
    return float(np.clip(2.5 * noise, *_OVER_SUPPORT))


def _may_end(rays: Sightlines, least: float) -> Bool[np.ndarray, "N"]:
    return np.asarray(rays.start[:, 2] + rays.length * rays.direction[:, 2] > least)


def _cost(rays: Sightlines, least: float, level: float, shape: DrillShape) -> float:
    """Return the mean squared residual of depth and outline, each bounded at 3 sigma, plus the prior's cost."""
    outside, depth = meet(rays, shape, level)
    gap = rays.length - depth
    ended = (np.abs(gap) < 0.12) & _may_end(rays, least)
    on = (gap / _SIGMA_DEPTH) ** 2 + (np.maximum(outside, 0.0) / _SIGMA_EDGE) ** 2
    off = (np.maximum(-outside, 0.0) / _SIGMA_EDGE) ** 2 * (gap > 0.0)
    each = np.minimum(np.where(ended, on, off), _WORST)
    usual = ((shape.grip - 0.125) / 0.02) ** 2 + ((shape.body - 0.2) / 0.03) ** 2 + ((shape.back - 0.07) / 0.015) ** 2
    return float(each.mean() + 0.03 * usual)


def _judge(begun: _Begun, shape: DrillShape, reverse: float, is_hinted: bool) -> Detection:
    """Return the fitted drill as a detection, with its confidence.

    Args:
        reverse: cost of the best drill in the opposite direction, over that of this one.
    """
    rays, cluster = begun.rays, begun.cluster
    outside, depth = meet(rays, shape, cluster.level)
    gap = rays.length - depth
    ended = (np.abs(gap) < 0.12) & _may_end(rays, begun.least)
    inside = (outside < -0.004) & (gap > -_NEAR)
    solid = float((ended & (np.abs(gap) < _NEAR))[inside].mean()) if inside.any() else 0.0
    explained = float((outside[ended] < 0.012).mean()) if ended.any() else 0.0
    notch_open_share, notch_seen = notch_open(rays, shape, cluster.level)
    hit = ended & inside & (np.abs(gap) < _NEAR)
    rms = float(np.sqrt(np.mean(gap[hit] ** 2))) if hit.any() else float("inf")
    known = rising(float(notch_seen), 3.0, 12.0)
    value = (
        rising(solid, 0.7, 0.9)
        * rising(explained, 0.7, 0.9)
        * (
            known * rising(notch_open_share, 0.4, 0.8)
            + (1.0 - known) * (_UNSEEN_HINTED if is_hinted else _UNSEEN_NOTCH)
        )
        * rising(-rms, -0.02, -0.014)
        * rising(begun.supported, *_SUPPORTED)
        * (_EITHER_WAY + (1.0 - _EITHER_WAY) * rising(reverse, *_REVERSE))
        * rising(float(hit.sum()), 15.0, 60.0)
    )
    foot = 2.0 * FOOT[2]
    pose = np.eye(4)
    pose[:3, :3] = about_up(shape.yaw)
    pose[:3, 3] = (shape.x, shape.y, cluster.level + foot + 0.5 * shape.grip)
    sizes = {"grip_length": shape.grip, "body_length": shape.body}
    residuals = {
        "rms": rms,
        "solid_share": solid,
        "explained_share": explained,
        "notch_open_share": notch_open_share,
        "n_notch_rays": float(notch_seen),
        "supported_share": begun.supported,
        "reverse_ratio": reverse,
    }
    points = rays.ends[hit]
    confidence = float(value**0.7 if is_hinted else value)
    return Detection("drill", pose, sizes, confidence, residuals, points[:: max(1, len(points) // _MOST_POINTS)])
