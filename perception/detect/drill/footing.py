"""Whether what seems to stand on a level surface has it under its foot, or only passes that height on its way down."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from perception.cleaning.neighbours import nearest
from perception.detect.drill.supports import StandingCluster
from perception.sightlines import SightIndex

_FOOT_HEIGHT = 0.05
_BESIDE = (0.015, 0.06)
_OVER, _UNDER = 0.018, 0.03
_LEAST_FALL = 0.05
_FEWEST = 4


def support_share(index: SightIndex, cluster: StandingCluster) -> float:
    """Of the rays that come down to its level right beside its foot, the share that ended there; 1 where few did.

    Rays beside a leg or a post go on below.

    Args:
        index: all rays of the scan.
        cluster: with the level it seems to stand on.
    """
    foot = cluster.points[cluster.points[:, 2] < cluster.level + _FOOT_HEIGHT, :2]
    centre = foot.mean(axis=0)
    reach = float(np.linalg.norm(foot - centre, axis=1).max()) + _BESIDE[1]
    rays = index.passing(np.append(centre, cluster.level)[None], reach)
    rays = rays.selected(rays.direction[:, 2] < -_LEAST_FALL)
    height = rays.ends[:, 2] - cluster.level
    rays, height = rays.selected(height < _OVER), height[height < _OVER]
    if not len(rays):
        return 1.0
    crossing = (cluster.level - rays.start[:, 2]) / rays.direction[:, 2]
    beside, _ = nearest(cKDTree(foot), rays.start[:, :2] + crossing[:, None] * rays.direction[:, :2], 1)
    height = height[(beside > _BESIDE[0]) & (beside < _BESIDE[1])]
    return float((height > -_UNDER).mean()) if len(height) >= _FEWEST else 1.0
