"""The point cloud: finite points, their rays, and notes from reading it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.cleaning.doubts import find_doubts
from perception.errors import CloudError
from perception.limits import MAX_INVALID_FRACTION, MAX_POINTS


def _no_points() -> Float[np.ndarray, "0 3"]:
    return np.zeros((0, 3))


@dataclass(frozen=True)
class Cloud:
    """Points of one scan, or of several merged into one frame.

    Attributes:
        points: (N, 3) finite coordinates [m], N >= 1.
        origin: (3,) common start of all rays, or (N, 3) start of each, in the frame of the points [m].
        notes: sentences about the cloud for the user.
        misses: (M, 3) ends of rays without a return: space up to there is free, but there is no surface [m].
        miss_origin: (3,) or (M, 3) starts of the rays without a return; None: ``origin``, which must then be (3,).
        sensor: kind of sensor, a name of ``noise.MODELS``; empty if unknown.
        origin_sigma: standard deviation of the start of the rays [m].
    """

    points: Float[np.ndarray, "N 3"]
    origin: Float[np.ndarray, "*N 3"]
    notes: tuple[str, ...] = ()
    misses: Float[np.ndarray, "M 3"] = field(default_factory=_no_points)
    miss_origin: Float[np.ndarray, "*M 3"] | None = None
    sensor: str = ""
    origin_sigma: float = 0.0

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise CloudError(f"points have shape {self.points.shape}; expected (N, 3)")
        if not len(self.points):
            raise CloudError("the cloud has no points; expected at least one")
        if not np.isfinite(self.points).all():
            raise CloudError("points hold NaN or infinite values; make_cloud() drops and counts them")
        if self.misses.ndim != 2 or self.misses.shape[1] != 3 or not np.isfinite(self.misses).all():
            raise CloudError(f"misses have shape {self.misses.shape}; expected (M, 3) finite numbers")
        _check_origin(self.origin, len(self.points))
        if self.miss_origin is not None:
            _check_origin(self.miss_origin, len(self.misses))
        elif len(self.misses) and self.origin.ndim == 2:
            raise CloudError("with one origin per point, misses need a miss_origin of their own")

    @property
    def starts(self) -> Float[np.ndarray, "N 3"]:
        """Start of each point's ray [m]."""
        return np.broadcast_to(self.origin, self.points.shape)

    @property
    def rays(self) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
        """Starts and ends of all rays, including rays without a return [m]."""
        if not len(self.misses):
            return self.starts, self.points
        behind = self.origin if self.miss_origin is None else self.miss_origin
        starts = np.concatenate([self.starts, np.broadcast_to(behind, self.misses.shape)])
        return starts, np.concatenate([self.points, self.misses])

    def select(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> Cloud:
        """Return the cloud with only these points and with all rays without a return."""
        origin = self.origin if self.origin.ndim == 1 else self.origin[keep]
        return replace(self, points=self.points[keep], origin=origin)


def _check_origin(origin: Float[np.ndarray, "*N 3"], n_points: int) -> None:
    if origin.shape not in ((3,), (n_points, 3)) or not np.isfinite(origin).all():
        what = origin.tolist() if origin.size <= 3 else f"of shape {origin.shape}"
        raise CloudError(f"ray origin {what} is invalid; expected 3 or ({n_points}, 3) finite numbers")


def make_cloud(
    points: Float[np.ndarray, "N 3"],
    origin: Float[np.ndarray, "*N 3"],
    notes: tuple[str, ...] = (),
    name: str = "cloud",
    *,
    misses: Float[np.ndarray, "M 3"] | None = None,
    miss_origin: Float[np.ndarray, "*M 3"] | None = None,
) -> Cloud:
    """Make a cloud without invalid points; its notes count them and name suspicious values in the rest.

    Args:
        points: (N, 3) as read [m]; rows with NaN or infinity are invalid.
        origin: (3,) common start of the rays, or (N, 3) start of each [m].
        notes: notes from the file's reader.
        misses: (M, 3) ends of rays without a return [m].
        miss_origin: (3,) or (M, 3) starts of these rays; None: ``origin``, which must then be (3,).

    Raises:
        CloudError: no points, too many, or more than 95 % of them invalid.
    """
    points, origin = np.asarray(points, dtype=np.float64), np.asarray(origin, dtype=np.float64)
    misses = _no_points() if misses is None else np.asarray(misses, dtype=np.float64)
    if not len(points):
        nothing = f"only {len(misses)} rays that met nothing" if len(misses) else "no points"
        raise CloudError(f"{name}: holds {nothing}; expected at least one point")
    if len(points) + len(misses) > MAX_POINTS:
        raise CloudError(
            f"{name}: {len(points) + len(misses)} points; expected at most {MAX_POINTS}, downsample it first"
        )
    valid = _finite(points, origin)
    n_invalid = int(len(points) - valid.sum())
    if n_invalid > MAX_INVALID_FRACTION * len(points):
        raise CloudError(
            f"{name}: {n_invalid} of {len(points)} points are NaN or infinite; "
            f"expected at most {100 * MAX_INVALID_FRACTION:.0f} %"
        )
    if n_invalid:
        share = 100.0 * n_invalid / len(points)
        notes = (*notes, f"dropped {n_invalid} NaN or infinite points of {len(points)} ({share:.1f} %)")
        points, origin = points[valid], origin if origin.ndim == 1 else origin[valid]
    if len(misses):
        kept = _finite(misses, np.zeros(3) if miss_origin is None else miss_origin)
        misses = misses[kept]
        miss_origin = miss_origin if miss_origin is None or miss_origin.ndim == 1 else miss_origin[kept]
    return Cloud(points, origin, (*notes, *find_doubts(points, origin)), misses, miss_origin)


def merge_clouds(clouds: Sequence[Cloud]) -> Cloud:
    """Merge all points and rays of clouds in one frame; each point keeps the start of its own ray."""
    if len(clouds) == 1:
        return clouds[0]
    behind = [
        np.broadcast_to(cloud.origin if cloud.miss_origin is None else cloud.miss_origin, cloud.misses.shape)
        for cloud in clouds
        if len(cloud.misses)
    ]
    return Cloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.starts for cloud in clouds]),
        tuple(note for cloud in clouds for note in cloud.notes),
        np.concatenate([cloud.misses for cloud in clouds]),
        np.concatenate(behind) if behind else None,
        clouds[0].sensor if len({cloud.sensor for cloud in clouds}) == 1 else "",
        max(cloud.origin_sigma for cloud in clouds),
    )


def _finite(ends: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"]) -> Bool[np.ndarray, "N"]:
    """Return the mask of rays with a finite end and, if starts are given per ray, a finite start."""
    valid = np.isfinite(ends).all(axis=1)
    if starts.ndim == 2:
        valid &= np.isfinite(starts).all(axis=1)
    return np.asarray(valid)
