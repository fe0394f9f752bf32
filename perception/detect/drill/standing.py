"""Places of drills that stand on a shelf or table, from clusters of points: proposals for the engine."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.detect.drill.supports import StandingCluster, dense_parts, standing_clusters, support_share
from perception.detect.engine.refine import Hypotheses
from perception.detect.engine.region import Mounting
from perception.detect.engine.search import Site
from perception.detect.engine.templates.drill import DRILL, SOLE
from perception.sightlines import SightIndex
from perception.view import View

_TALL = (0.15, 0.33)
_WIDE = 0.38
_HINT_RADIUS = 0.4
_YAWS = np.radians(np.arange(0.0, 360.0, 15.0))
_AHEAD = (0.0, 0.03)  # of the grip, the middle of a cluster [m]
_SUPPORTED = 0.6  # least share of the surface beside a drill's foot on which it stands
_LEVEL_SIGMA = 0.004  # of the points of a board [m]


def cluster_sites(view: View, hint: Float[np.ndarray, "3"] | None, index: SightIndex) -> list[Site]:
    """Return sites at clusters of the size of a drill, with hypotheses of all yaws.

    Args:
        hint: (3,) a point near the drill [m]; only clusters within 0.4 m of it are searched.
    """
    clusters = [part for cluster in standing_clusters(view) for part in _of_a_size(cluster)]
    if hint is not None:
        clusters = [
            cluster for cluster in clusters if np.linalg.norm(cluster.points.mean(axis=0) - hint) < _HINT_RADIUS
        ]
    return [_begin(cluster) for cluster in clusters if support_share(index, cluster) > _SUPPORTED]


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
    return float(high[2] - cluster.level), float(np.linalg.norm(high[:2] - low[:2]))


def _begin(cluster: StandingCluster) -> Site:
    """Return the site of a cluster, whose middle is between grip and chuck, with a grip of its height."""
    low, high = np.percentile(cluster.points[:, :2], [3, 97], axis=0)
    tall = float(np.percentile(cluster.points[:, 2], 98)) - cluster.level
    yaws = np.repeat(_YAWS, len(_AHEAD))
    rotation = Rotation.from_rotvec(np.outer(yaws, [0.0, 0.0, 1.0])).as_matrix()
    sizes = np.repeat(DRILL.usual[None], len(yaws), axis=0)
    named = DRILL.named(sizes)
    sizes[:, 0] = tall - SOLE - 2.0 * named["body_radius"]
    place = np.array([*(0.5 * (low + high)), cluster.level])
    origin = place - np.tile(_AHEAD, len(_YAWS))[:, None] * rotation[:, :, 0]
    begun = Hypotheses.of(rotation, origin, DRILL.clip(sizes), np.array([0.0, 0.0, 1.0]))
    return Site(place + np.array([0.0, 0.0, 0.5 * tall]), Mounting(np.eye(3), place, _LEVEL_SIGMA), begun)
