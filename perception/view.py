"""A scan made ready to be looked at: cropped, without the robot's own points, floor and outliers told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.clean import Reach, first_of_equals, inside_hulls
from perception.cloud import Cloud
from perception.errors import CloudError
from perception.floor import FloorPlane, on_floors
from perception.levels import find_floors
from perception.outliers import surface_points

_DEFAULT_REACH = Reach()
_BEYOND = 1.0


@dataclass(frozen=True)
class View:
    """What detectors and the making of pieces start from.

    Attributes:
        cloud: the whole scan without exact copies; all its rays are evidence of what is free.
        near: the points in reach that are not the robot's own.
        floors: levels of the floor, the one under the robot first.
        obstacles: (M, 3) points of ``near`` that are neither floor, nor strays, nor mixed pixels [m].
        starts: (M, 3) where their rays started [m].
        reach: what matters.
        seed: of all random choices; the same scan and seed give the same result.
        notes: sentences a user should read.
    """

    cloud: Cloud
    near: Cloud
    floors: tuple[FloorPlane, ...]
    obstacles: Float[np.ndarray, "M 3"]
    starts: Float[np.ndarray, "M 3"]
    reach: Reach
    seed: int
    notes: tuple[str, ...]

    @property
    def floor(self) -> FloorPlane | None:
        """The level under the robot; None when none was seen."""
        return self.floors[0] if self.floors else None


def make_view(
    cloud: Cloud,
    *,
    reach: Reach = _DEFAULT_REACH,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    seed: int = 0,
) -> View:
    """Drop exact copies, crop, drop the robot's own points, find the floor, drop strays and mixed pixels.

    Args:
        cloud: the scan in world coordinates (z up).
        reach: what matters.
        robot_hulls: (V, 3) vertices of the robot's links placed in the world; points on them are dropped.
        soles: (S, 3) corners of the planted soles; what lies up to 3 cm over the floor under them is floor.
        seed: of all random choices.

    Raises:
        CloudError: nothing of the cloud lies in reach.
    """
    _check_reach(cloud, reach)
    cloud = without_copies(cloud)
    near = cloud.selected(reach.contains(cloud.points))
    own = inside_hulls(near.points, robot_hulls)
    notes = cloud.notes
    if own.any():
        notes = (*notes, f"left out {int(own.sum())} points on the robot itself")
        if own.all():
            raise CloudError("all points in reach lie on the robot itself; is the robot's posture the scan's?")
        near = near.selected(~own)
    floors = find_floors(near.points, cloud.rays, stand=_stand(reach, soles), extent=reach.radius + _BEYOND, seed=seed)
    if not floors:
        notes = (*notes, "no floor was found; nothing stands for it in the scene")
    elif len(floors) > 1:
        notes = (*notes, f"the floor has {len(floors)} levels; the robot is taken to stand on 'floor'")
    above = ~on_floors(near.points, floors, soles)
    kept = surface_points(near.points, near.starts, above)
    return View(cloud, near, floors, near.points[kept], near.starts[kept], reach, seed, notes)


def _stand(reach: Reach, soles: Sequence[Float[np.ndarray, "S 3"]]) -> Float[np.ndarray, "3"]:
    """Where the robot stands: between its soles, else at zero height in the middle of the reach."""
    if not len(soles):
        return np.array([reach.x, reach.y, 0.0])
    return np.asarray(np.mean([np.mean(sole, axis=0) for sole in soles], axis=0))


def without_copies(cloud: Cloud) -> Cloud:
    """The cloud with exact copies of points left out and counted in its notes."""
    is_first = first_of_equals(cloud.points, cloud.starts)
    n_copies = int(len(is_first) - is_first.sum())
    if not n_copies:
        return cloud
    share = 100.0 * n_copies / len(is_first)
    note = f"dropped {n_copies} exact copies among {len(is_first)} points ({share:.1f} %)"
    return replace(cloud.selected(is_first), notes=(*cloud.notes, note))


def _check_reach(cloud: Cloud, reach: Reach) -> None:
    if not reach.contains(cloud.points).any():
        centre = np.median(cloud.points, axis=0)
        raise CloudError(
            f"none of {len(cloud.points)} points lie within {reach.radius} m of ({reach.x}, {reach.y}); their middle "
            f"is ({', '.join(f'{value:.1f}' for value in centre)}): metres in the robot's start frame are needed"
        )
