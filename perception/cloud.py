"""The point cloud: finite points, the rays that found them, and what was noticed while it was read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.errors import CloudError

MAX_POINTS = 2_000_000
MAX_FILE_BYTES = 64 * 2**20
MAX_INVALID_FRACTION = 0.95

# A scan of one place spans tens of metres; beyond these the numbers are in another unit or frame.
_MILLIMETRE_SPAN = 400.0
_MAP_DISTANCE = 1_000.0


def _no_points() -> Float[np.ndarray, "0 3"]:
    return np.zeros((0, 3))


@dataclass(frozen=True)
class Cloud:
    """Points of one scan, or of several merged into one frame.

    Attributes:
        points: (N, 3) finite coordinates [m], N >= 1.
        origin: (3,) where all rays started, or (N, 3) where each did, in the frame of the points [m].
        notes: sentences about the cloud a user should read.
        misses: (M, 3) places up to which rays met nothing: evidence of free space, no points [m].
        miss_origin: (3,) or (M, 3), where those rays started; None: ``origin``, which must then be (3,).
    """

    points: Float[np.ndarray, "N 3"]
    origin: Float[np.ndarray, "*N 3"]
    notes: tuple[str, ...] = ()
    misses: Float[np.ndarray, "M 3"] = field(default_factory=_no_points)
    miss_origin: Float[np.ndarray, "*M 3"] | None = None

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise CloudError(f"points have shape {self.points.shape}; (N, 3) is needed")
        if not len(self.points):
            raise CloudError("the cloud has no points")
        if not np.isfinite(self.points).all():
            raise CloudError("points hold NaN or infinite values; make_cloud() drops and counts them")
        if self.misses.ndim != 2 or self.misses.shape[1] != 3 or not np.isfinite(self.misses).all():
            raise CloudError(f"misses have shape {self.misses.shape}; (M, 3) finite numbers are needed")
        _check_origin(self.origin, len(self.points))
        if self.miss_origin is not None:
            _check_origin(self.miss_origin, len(self.misses))
        elif len(self.misses) and self.origin.ndim == 2:
            raise CloudError("with one origin per point, misses need a miss_origin of their own")

    @property
    def starts(self) -> Float[np.ndarray, "N 3"]:
        """Where the ray of each point started [m]."""
        return np.broadcast_to(self.origin, self.points.shape)

    @property
    def rays(self) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
        """Where all rays started and where they ended, those without a return included [m]."""
        if not len(self.misses):
            return self.starts, self.points
        behind = self.origin if self.miss_origin is None else self.miss_origin
        starts = np.concatenate([self.starts, np.broadcast_to(behind, self.misses.shape)])
        return starts, np.concatenate([self.points, self.misses])

    def selected(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> Cloud:
        """Only these points; the rays without a return stay."""
        origin = self.origin if self.origin.ndim == 1 else self.origin[keep]
        return replace(self, points=self.points[keep], origin=origin)


def _check_origin(origin: Float[np.ndarray, "*N 3"], n_points: int) -> None:
    if origin.shape not in ((3,), (n_points, 3)) or not np.isfinite(origin).all():
        what = origin.tolist() if origin.size <= 3 else f"of shape {origin.shape}"
        raise CloudError(f"ray origin {what} is neither three finite numbers nor ({n_points}, 3) of them")


def make_cloud(
    points: Float[np.ndarray, "N 3"],
    origin: Float[np.ndarray, "3"],
    notes: tuple[str, ...] = (),
    name: str = "cloud",
) -> Cloud:
    """Drop and count invalid points and tell what looks odd about the rest.

    Args:
        points: (N, 3) as read; NaN and infinite rows mean "no return".
        origin: (3,) where the rays started [m].
        notes: what the reader has to say already.
        name: what to call the cloud in errors.

    Raises:
        CloudError: no points, too many, or more than 95 % of them invalid.
    """
    points = np.asarray(points, dtype=np.float64)
    if not len(points):
        raise CloudError(f"{name}: holds no points; at least one is needed")
    if len(points) > MAX_POINTS:
        raise CloudError(f"{name}: {len(points)} points; at most {MAX_POINTS} are read, downsample it first")
    valid = np.isfinite(points).all(axis=1)
    n_invalid = int(len(points) - valid.sum())
    if n_invalid > MAX_INVALID_FRACTION * len(points):
        raise CloudError(
            f"{name}: {n_invalid} of {len(points)} points are NaN or infinite; "
            f"at most {100 * MAX_INVALID_FRACTION:.0f} % may be"
        )
    if n_invalid:
        share = 100.0 * n_invalid / len(points)
        notes = (*notes, f"dropped {n_invalid} NaN or infinite points of {len(points)} ({share:.1f} %)")
        points = points[valid]
    origin = np.asarray(origin, dtype=np.float64)
    return Cloud(points, origin, (*notes, *_oddities(points, origin)))


def _oddities(points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"]) -> tuple[str, ...]:
    """Sentences about unit and frame, judged from the numbers alone."""
    low, high = np.percentile(points, [1, 99], axis=0)
    span = float((high - low).max())
    notes = []
    if span > _MILLIMETRE_SPAN:
        notes.append(
            f"the cloud spans {span:.0f} m: are these millimetres? multiply by 0.001, since metres are taken as read"
        )
    distance = float(np.linalg.norm(np.median(points, axis=0)))
    if span <= _MILLIMETRE_SPAN and distance > _MAP_DISTANCE:
        notes.append(
            f"the cloud lies {distance:.0f} m from the origin: map coordinates? subtract the robot's position first"
        )
    if hint := _sensor_frame_hint(points, origin, low):
        notes.append(hint)
    return tuple(notes)


def _sensor_frame_hint(
    points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], low: Float[np.ndarray, "3"]
) -> str:
    """A hint when the points look given in the sensor's frame: rays start at zero, yet zero is not on the floor."""
    if np.linalg.norm(origin) > 1e-6:
        return ""
    depth = points[:, 2]
    in_front = np.mean((depth > 0.1) & (np.abs(points[:, :2]) < 1.3 * depth[:, None]).all(axis=1))
    if in_front > 0.99:
        return "looks like a camera's own frame (z forward, rays from zero): give it in world coordinates, z up"
    if low[2] < -0.4:
        return (
            f"looks sensor-framed: rays start at zero and points reach {-low[2]:.2f} m below it; "
            "apply the viewpoint or give world coordinates"
        )
    return ""
