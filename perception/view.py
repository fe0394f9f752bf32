"""Preprocessing of a scan: cropping, removal of the robot's own points, separation of floor and outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.progress import tell
from perception.cleaning.clean import Reach, first_of_equals, inside_hulls
from perception.cleaning.doubts import crop_doubt, high_sensor_doubt, low_sensor_doubt, nothing_left
from perception.cleaning.outliers import surface_points
from perception.cloud import Cloud
from perception.errors import CloudError
from perception.ground.floor import FloorPlane, find_floor_points
from perception.ground.levels import find_floors
from perception.ground.levels_again import are_there

_DEFAULT_REACH = Reach()
_BEYOND = 1.0
# Detectors search at least this region, so that their hits do not depend on where a smaller crop ends.
_SEARCHED = Reach(radius=5.0)


@dataclass(frozen=True)
class View:
    """Preprocessed scan, the input of the detectors and of making pieces.

    Attributes:
        cloud: the whole scan without exact copies; all its rays are evidence of free space.
        near: the points in reach, without points on the robot.
        floors: levels of the floor, the one under the robot first.
        obstacles: (M, 3) points of ``near`` that are neither floor, nor strays, nor mixed pixels [m].
        starts: (M, 3) starts of their rays [m].
        seed: seed of the random choices of floor and pieces; the same scan and seed give the same result.
        notes: sentences for the user.
        n_own: number of points in reach on the robot itself.
        is_floor: (N,) which points of ``near`` belong to the floor.
        robot_hulls: (V, 3) vertices of the robot's links in the world [m].
        soles: (S, 3) corners of the planted soles [m].
        is_surface: (N,) which points of ``near`` are obstacles; empty if strays were not dropped.
    """

    cloud: Cloud
    near: Cloud
    floors: tuple[FloorPlane, ...]
    obstacles: Float[np.ndarray, "M 3"]
    starts: Float[np.ndarray, "M 3"]
    reach: Reach
    seed: int
    notes: tuple[str, ...]
    n_own: int = 0
    is_floor: Bool[np.ndarray, "N"] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    robot_hulls: tuple[Float[np.ndarray, "V 3"], ...] = ()
    soles: tuple[Float[np.ndarray, "S 3"], ...] = ()
    is_surface: Bool[np.ndarray, "N"] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    @property
    def n_cropped(self) -> int:
        """Number of points out of reach."""
        return len(self.cloud.points) - len(self.near.points) - self.n_own

    @property
    def n_floor(self) -> int:
        """Number of points of ``near`` on the floor."""
        return int(np.count_nonzero(self.is_floor))

    @property
    def n_strays(self) -> int:
        """Number of points dropped as strays or mixed pixels."""
        return len(self.near.points) - self.n_floor - len(self.obstacles)

    @property
    def floor(self) -> FloorPlane | None:
        """Floor level under the robot; None if none was seen."""
        return self.floors[0] if self.floors else None


def make_view(
    cloud: Cloud,
    *,
    reach: Reach = _DEFAULT_REACH,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    given_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    seed: int = 0,
) -> View:
    """Drop exact copies, crop, drop the robot's own points, find the floor, drop strays and mixed pixels.

    Args:
        cloud: the scan in world coordinates (z up).
        robot_hulls: (V, 3) vertices of the robot's links in the world; points on them are dropped.
        given_hulls: (V, 3) vertices of other shapes in the world whose points are dropped.
        soles: (S, 3) corners of the planted soles; points up to 3 cm above the floor under them count as floor.

    Raises:
        CloudError: no point of the cloud lies in reach; the message includes the cloud's notes.
    """
    return view_of(crop(cloud, reach, robot_hulls, given_hulls), reach=reach, soles=soles, seed=seed)


def widen(view: View) -> View:
    """Return the view that detectors search: of the same scan, at least 5 m about the middle of the reach.

    What a detector makes of an object depends on the points around it, on its limits on candidates, and on voxels and
    samples; all of them would change with the crop.
    """
    reach = replace(
        view.reach,
        radius=max(view.reach.radius, _SEARCHED.radius),
        top=max(view.reach.top, _SEARCHED.top),
        bottom=min(view.reach.bottom, _SEARCHED.bottom),
    )
    if reach == view.reach:
        return view
    return view_of(crop(view.cloud, reach, view.robot_hulls), reach=reach, soles=view.soles, narrower=view)


@dataclass(frozen=True)
class Cropped:
    """The part of a scan that lies in reach.

    Attributes:
        cloud: the whole scan without exact copies.
        near: the points in reach, without points on the robot.
        n_own: number of points in reach on the robot itself.
        robot_hulls: (V, 3) vertices of the robot's links and of given shapes in the world [m].
    """

    cloud: Cloud
    near: Cloud
    notes: tuple[str, ...]
    n_own: int
    robot_hulls: tuple[Float[np.ndarray, "V 3"], ...] = ()


def crop(
    cloud: Cloud,
    reach: Reach,
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]],
    given_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
) -> Cropped:
    """Drop exact copies, points out of reach and points on the robot or on given shapes; see ``make_view``."""
    _check_reach(cloud, reach)
    cloud = drop_copies(cloud)
    near = cloud.select(reach.contains(cloud.points))
    hulls = (*robot_hulls, *given_hulls)
    own = inside_hulls(near.points, hulls)
    notes = (*cloud.notes, *_crop_note(cloud, near, reach))
    if own.any():
        what = "the robot itself and on given shapes" if given_hulls else "the robot itself"
        notes = (*notes, f"left out {int(own.sum())} points on {what}")
        if own.all():
            raise CloudError("all points in reach lie on the robot itself; is the robot's posture the scan's?")
        near = near.select(~own)
    return Cropped(cloud, near, notes, int(own.sum()), hulls)


def view_of(
    cropped: Cropped,
    *,
    reach: Reach,
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    seed: int = 0,
    cleaned: bool = True,
    floors: Sequence[FloorPlane] = (),
    narrower: View | None = None,
) -> View:
    """Find the floor, drop strays and mixed pixels; see ``make_view``.

    Args:
        cropped, reach, soles, seed: as for ``make_view``.
        cleaned: whether strays and mixed pixels are dropped; if not, all points off the floor are obstacles.
        floors: levels of an earlier scan, used unchanged if this scan shows them.
        narrower: view of the same scan; if its reach and floor hold the same points, so do its surfaces.
    """
    tell("find floor")
    cloud, near, notes = cropped.cloud, cropped.near, cropped.notes
    floors = tuple(floors)
    if not are_there(floors, near.points, cloud.rays, reach):
        stand = _stand(reach, soles)
        floors = find_floors(near.points, cloud.rays, stand=stand, extent=reach.radius + _BEYOND, seed=seed)
    if not floors:
        notes = (*notes, "no floor was found; nothing stands for it in the scene")
    elif len(floors) > 1:
        notes = (*notes, f"the floor has {len(floors)} levels; the robot is taken to stand on 'floor'")
    if floors:
        lowest = np.min([level.height(near.starts[:, :2]) for level in floors], axis=0)
        notes = (*notes, *low_sensor_doubt(near.starts, lowest), *high_sensor_doubt(near.starts, lowest))
    is_floor = find_floor_points(near.points, floors, soles)
    tell("drop strays")
    kept = _find_surfaces(near, is_floor, narrower) if cleaned else ~is_floor
    missing = "no floor is" if not floors else "no obstacle is" if not kept.any() else ""
    notes = (*notes, *crop_doubt(cloud.points, len(near.points) + cropped.n_own, reach, missing))
    obstacles, starts = near.points[kept], near.starts[kept]
    return View(
        *(cloud, near, floors, obstacles, starts, reach, seed, notes, cropped.n_own, is_floor),
        cropped.robot_hulls,
        tuple(soles),
        kept if cleaned else kept[:0],
    )


def _find_surfaces(near: Cloud, is_floor: Bool[np.ndarray, "N"], narrower: View | None) -> Bool[np.ndarray, "N"]:
    """Return which points lie on surfaces other than the floor; as in the narrower view if that has the same points."""
    if (
        narrower is not None
        and len(narrower.is_surface) == len(is_floor)
        and np.array_equal(narrower.is_floor, is_floor)
        and np.array_equal(narrower.near.points, near.points)
    ):
        return narrower.is_surface
    return surface_points(near.points, near.starts, ~is_floor)


def _stand(reach: Reach, soles: Sequence[Float[np.ndarray, "S 3"]]) -> Float[np.ndarray, "3"]:
    """Return the robot's position [m]: the mean of its soles, or without soles the middle of the reach at z = 0."""
    if not len(soles):
        return np.array([reach.x, reach.y, 0.0])
    return np.asarray(np.mean([np.mean(sole, axis=0) for sole in soles], axis=0))


def drop_copies(cloud: Cloud) -> Cloud:
    """Drop exact copies of points; their number becomes a note."""
    is_first = first_of_equals(cloud.points, cloud.starts)
    n_copies = int(len(is_first) - is_first.sum())
    if not n_copies:
        return cloud
    share = 100.0 * n_copies / len(is_first)
    note = f"dropped {n_copies} exact copies among {len(is_first)} points ({share:.1f} %)"
    return replace(cloud.select(is_first), notes=(*cloud.notes, note))


def _crop_note(cloud: Cloud, near: Cloud, reach: Reach) -> tuple[str, ...]:
    """Return a note with the number of points out of reach, and on which side they lie; empty if there are none."""
    n_cropped = len(cloud.points) - len(near.points)
    if not n_cropped:
        return ()
    x, y, z = cloud.points.T
    beside = (x - reach.x) ** 2 + (y - reach.y) ** 2 > reach.radius**2
    places = {
        f"farther than {reach.radius:g} m from ({reach.x:g}, {reach.y:g})": beside,
        f"above {reach.top:g} m": ~beside & (z > reach.top),
        f"below {reach.bottom:g} m": ~beside & (z < reach.bottom),
    }
    where = ", ".join(f"{int(mask.sum())} {place}" for place, mask in places.items() if mask.any())
    share = 100.0 * n_cropped / len(cloud.points)
    return (f"left out {n_cropped} of {len(cloud.points)} points ({share:.1f} %) out of reach: {where}",)


def _check_reach(cloud: Cloud, reach: Reach) -> None:
    if not reach.contains(cloud.points).any():
        raise CloudError("; ".join([nothing_left(cloud.points, reach), *cloud.notes]))
