"""A scan made ready to be looked at: cropped, without the robot's own points, floor and outliers told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.clean import Reach, inliers, inside_hulls
from perception.cloud import Cloud
from perception.errors import CloudError
from perception.floor import FloorPlane, find_floor, on_floor

_DEFAULT_REACH = Reach()


@dataclass(frozen=True)
class View:
    """What detectors and the making of pieces start from.

    Attributes:
        cloud: the whole scan; all its rays are evidence of what is free.
        near: the points in reach that are not the robot's own.
        floor: the floor's plane; None when none was seen.
        obstacles: (M, 3) points of ``near`` that are neither floor nor outliers [m].
        starts: (M, 3) where their rays started [m].
        reach: what matters.
        seed: of all random choices; the same scan and seed give the same result.
        notes: sentences a user should read.
    """

    cloud: Cloud
    near: Cloud
    floor: FloorPlane | None
    obstacles: Float[np.ndarray, "M 3"]
    starts: Float[np.ndarray, "M 3"]
    reach: Reach
    seed: int
    notes: tuple[str, ...]


def make_view(
    cloud: Cloud,
    *,
    reach: Reach = _DEFAULT_REACH,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    seed: int = 0,
) -> View:
    """Crop, drop the robot's own points, find the floor and drop outliers.

    Args:
        cloud: the scan in world coordinates (z up).
        reach: what matters.
        robot_hulls: (V, 3) vertices of the robot's links placed in the world; points on them are dropped.
        soles: (S, 3) corners of the planted soles; what lies up to 3 cm over the floor under them is floor.
        seed: of all random choices.

    Raises:
        CloudError: nothing of the cloud lies in reach.
    """
    near = _in_reach(cloud, reach)
    own = inside_hulls(near.points, robot_hulls)
    notes = cloud.notes
    if own.any():
        notes = (*notes, f"left out {int(own.sum())} points on the robot itself")
        if own.all():
            raise CloudError("all points in reach lie on the robot itself; is the robot's posture the scan's?")
        near = near.selected(~own)
    floor = find_floor(near.points, seed)
    if floor is None:
        notes = (*notes, "no floor was found; nothing stands for it in the scene")
    points, starts = near.points, near.starts
    if floor is not None:
        above = ~on_floor(points, floor, soles)
        points, starts = points[above], starts[above]
    kept = inliers(points, starts)
    return View(cloud, near, floor, points[kept], starts[kept], reach, seed, notes)


def _in_reach(cloud: Cloud, reach: Reach) -> Cloud:
    inside = reach.contains(cloud.points)
    if not inside.any():
        centre = np.median(cloud.points, axis=0)
        raise CloudError(
            f"none of {len(cloud.points)} points lie within {reach.radius} m of ({reach.x}, {reach.y}); their middle "
            f"is ({', '.join(f'{value:.1f}' for value in centre)}): metres in the robot's start frame are needed"
        )
    return cloud.selected(inside)
