"""How a bar and a pipe lie to one another where they are a valve's lever and its pipe: pivot and pivot's axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.detect.shared.bar_pivot import Pivot, find_pivot
from perception.detect.shared.bars import Bar
from perception.detect.shared.faces import Face, face_rays
from perception.detect.shared.vectors import cross
from perception.sightlines import SightIndex

_APART = (0.04, 0.25)
_PARALLEL_DEG = 20.0
_PIVOT_FROM_END = 0.06
# By the pipe's radius, where what holds a lever before it begins: the noise of the pipe itself is below that; a lever
# across looks past it.
_OVER_PIPE, _IN_PIPE = 1.15, 0.8
_OVERHANG = 1.25  # of a lever beyond its pivot, by its radius
# What is known at best of: directions of bar and pipe [rad], their places across, the pivot's place along [m].
_SIGMA_WAY, _SIGMA_ACROSS, _SIGMA_ALONG = 0.004, 0.002, 0.012


@dataclass(frozen=True)
class Joint:
    """A lever on a pipe.

    Attributes:
        axis: (3,) unit, of the pivot, from the pipe to the lever.
        pivot: on the lever.
        is_parallel: whether the lever lies along the pipe.
        spread: standard deviation of the axis [rad].
    """

    axis: Float[np.ndarray, "3"]
    pivot: Pivot
    is_parallel: bool
    spread: float


def joint_of(bar: Bar, pipe: Bar, tilts: tuple[float, float], index: SightIndex) -> Joint | None:
    """The joint; None when they do not lie as lever and pipe do.

    Where they cross, the pivot lies where they come nearest to each other, and otherwise at the end behind which rays
    do not pass.  The pivot's axis is square to both and leads from the pipe's middle to the pivot: what is known best
    counts most.

    Args:
        bar: with its ends.
        pipe: with its ends.
        tilts: standard deviations of their directions [rad].
        index: all rays.
    """
    if pipe.half[0] < 1.2 * bar.half[0] or pipe.length < bar.length:
        return None
    cosine = float(bar.axis @ pipe.axis)
    is_parallel = abs(cosine) > np.cos(np.radians(_PARALLEL_DEG))
    between = bar.middle - pipe.centre
    offset = bar.centre - pipe.centre
    if is_parallel:
        axis = between - (between @ bar.axis) * bar.axis
        nearest = 0.0
    else:
        axis = cross(bar.axis, pipe.axis)
        axis *= np.sign(axis @ between) or 1.0
        # Where the bar's line comes nearest to the pipe's.
        nearest = float((cosine * (offset @ pipe.axis) - offset @ bar.axis) / (1.0 - cosine**2))
    apart = float(np.linalg.norm(axis)) if is_parallel else abs(float(between @ axis) / float(np.linalg.norm(axis)))
    axis = axis / np.linalg.norm(axis)
    along_pipe = float((offset + nearest * bar.axis) @ pipe.axis)
    if not _APART[0] + pipe.half[0] < apart + 0.02 or apart > _APART[1]:
        return None
    if not pipe.first - 0.1 < along_pipe < pipe.last + 0.1:
        return None
    pivot = _pivot(bar, axis, apart - (_OVER_PIPE if is_parallel else _IN_PIPE) * pipe.half[0], index)
    if not is_parallel:
        ends = np.array([bar.first, bar.last])
        k = int(np.argmin(np.abs(ends - nearest)))
        if abs(ends[k] - nearest) > _PIVOT_FROM_END or (nearest - ends[k]) * (1 - 2 * k) < -0.02:
            return None
        # Where they cross tells the pivot better than what is seen behind the bar.
        clear = pivot.confidence if pivot.far == ends[1 - k] else 0.0
        pivot = replace(pivot, along=nearest, far=float(ends[1 - k]), confidence=clear)
    else:
        # What is seen of the body below it tells at which end a lever is held, but not where.
        end = bar.first if pivot.far > pivot.along else bar.last
        pivot = replace(pivot, along=float(end + np.sign(pivot.far - end) * _OVERHANG * bar.half[0]))
    axis, spread = _axis(bar, pipe, pivot.along, tilts)
    return Joint(axis, pivot, is_parallel, spread)


def _axis(bar: Bar, pipe: Bar, at: float, tilts: tuple[float, float]) -> tuple[Float[np.ndarray, "3"], float]:
    """The direction that is as square to both, and as much along the way from the pipe to the pivot, as is known of
    each; and its standard deviation [rad]."""
    out = bar.centre + at * bar.axis - pipe.centre
    out = out - (out @ pipe.axis) * pipe.axis
    apart = float(np.linalg.norm(out))
    out = out / apart
    askew = 1.0 - float(bar.axis @ pipe.axis) ** 2
    sigma_out = float(np.hypot(_SIGMA_ACROSS, _SIGMA_ALONG * np.sqrt(askew))) / apart
    weighed = (np.eye(3) - np.outer(out, out)) / sigma_out**2
    for way, tilt in ((bar.axis, tilts[0]), (pipe.axis, tilts[1])):
        weighed = weighed + np.outer(way, way) / max(tilt, _SIGMA_WAY) ** 2
    values, vectors = np.linalg.eigh(weighed)
    axis = vectors[:, 0] * np.sign(vectors[:, 0] @ out)
    return np.asarray(axis), float(1.0 / np.sqrt(values[1]))


def _pivot(bar: Bar, axis: Float[np.ndarray, "3"], gap: float, index: SightIndex) -> Pivot:
    """Where the bar is held over the pipe's near side, as if that were a face."""
    z = axis - (axis @ bar.axis) * bar.axis
    z /= np.linalg.norm(z)
    half = 0.5 * bar.length
    face = Face(
        np.stack([bar.axis, cross(z, bar.axis), z]),
        bar.middle - gap * z,
        np.array([-half, -0.04]),
        np.array([half, 0.04]),
        0.008,
    )
    return find_pivot(face, face_rays(face, index, 0.06), bar)
