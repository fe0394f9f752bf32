"""The scan that a simulated sensor takes of meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from perception.cloud import Cloud
from perception.simulate.cast import Caster
from perception.simulate.mesh import Mesh, join_meshes
from perception.simulate.sensor import Pose, Scanner, Sensor

_SCANNER = Scanner()


def scan(
    meshes: Sequence[Mesh],
    pose: Pose | None = None,
    sensor: Sensor = _SCANNER,
    seed: int = 0,
    *,
    misses: bool = False,
) -> Cloud:
    """Return what a sensor gives of the meshes, in world coordinates.

    Every ray stops at the first surface (real occlusion), and may be mixed up with what is beside it.

    Args:
        misses: whether rays that met nothing in range are given, as places at ``max_range``; sensors that cannot tell
            them from failures give none.
    """
    pose = pose or Pose()
    rng = np.random.default_rng(seed)
    origin = np.array(pose.position)
    direction = sensor.directions() @ pose.rotation.T
    caster = Caster(join_meshes(meshes))
    hits = caster.hits(origin, direction)
    beside = caster.hits(origin, _aside(direction, sensor.footprint_deg, rng)).distance
    ranges = sensor.measure(hits, beside, rng)
    seen = np.isfinite(ranges) & (ranges > sensor.nearest) & (ranges < sensor.max_range)
    points = origin + ranges[seen, None] * direction[seen]
    if not misses or not sensor.tells_misses:
        return Cloud(points, origin)
    nothing = ~seen & (hits.distance > sensor.max_range) & (beside > sensor.max_range)
    return Cloud(points, origin, misses=origin + sensor.max_range * direction[nothing])


def _aside(
    direction: Float[np.ndarray, "R 3"], footprint_deg: float, rng: np.random.Generator
) -> Float[np.ndarray, "R 3"]:
    """Move each direction to its footprint's edge."""
    aside = rng.normal(size=direction.shape)
    aside -= (aside * direction).sum(axis=1, keepdims=True) * direction
    aside *= np.tan(np.radians(footprint_deg)) / np.linalg.norm(aside, axis=1, keepdims=True)
    return np.asarray((direction + aside) / np.linalg.norm(direction + aside, axis=1, keepdims=True))
