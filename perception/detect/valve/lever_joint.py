"""Lever and pipe of a valve: their joint, and the fit of each without the points of the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.detect.shared.arithmetic import cross
from perception.detect.shared.bar_fit import BarFit
from perception.detect.shared.bar_pivot import Pivot, find_pivot
from perception.detect.shared.bar_search import rays_about
from perception.detect.shared.bar_starts import Run
from perception.detect.shared.bars import Bar, SurroundingRays, cross_bar, sort_rays
from perception.detect.shared.faces import Face, face_rays
from perception.detect.valve.lever_bars import LEVER_RADII, PIPE_RADII, TUBES, best_round
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex

_APART = (0.04, 0.25)
_PARALLEL_DEG = 20.0
_PIVOT_FROM_END = 0.06
# Distance from the pipe's axis, in its radii, beyond which returns belong to the lever's support: above the pipe's
# noise for a parallel lever, lower for a lever across it.
_OVER_PIPE, _IN_PIPE = 1.15, 0.8
OVERHANG = 1.25  # length of a lever beyond its pivot, in its radii
# Least deviations: directions of bar and pipe [rad], their lateral positions, the pivot's position along the bar [m].
_SIGMA_WAY, _SIGMA_ACROSS, _SIGMA_ALONG = 0.004, 0.002, 0.012
_BEYOND = 0.1
_BELOW = 0.01
_NECK = 0.035
_LEAST_RUN = 0.08
_BODY = 0.13
_LEAST_PIPE = 0.3
_INSIDE = 0.001
_ABOUT_END = 0.06
_SPACING, _BESIDE, _ON_FLOOR = 0.03, 0.05, 0.02
_MOST_RAYS = 1200
_FEWEST = 3


@dataclass(frozen=True)
class LeverJoint:
    """Joint of a lever on a pipe.

    Attributes:
        axis: (3,) unit, pivot axis, from the pipe to the lever.
        pivot: position of the pivot and of the free end along the lever.
        spread: standard deviation of the axis [rad].
    """

    axis: Float[np.ndarray, "3"]
    pivot: Pivot
    spread: float

    def pose(self, bar: Bar) -> Float[np.ndarray, "4 4"]:
        """Return (4, 4): origin at the pivot of the bar, x along the lever, z the pivot's axis to the sensor."""
        x = np.sign(self.pivot.far - self.pivot.along) * bar.axis
        z = self.axis - (self.axis @ x) * x
        z /= np.linalg.norm(z)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([x, cross(z, x), z])
        pose[:3, 3] = bar.centre + self.pivot.along * bar.axis
        return pose

    def turn_round(self, bar: Bar, pipe: Bar, tilts: tuple[float, float]) -> LeverJoint:
        """Return the joint at the other end of a bar parallel to its pipe."""
        end, far = (bar.first, bar.last) if self.pivot.far < self.pivot.along else (bar.last, bar.first)
        pivot = replace(self.pivot, along=float(end + np.sign(far - end) * OVERHANG * bar.half[0]), far=far)
        return LeverJoint(axis_of(bar, pipe, pivot.along, tilts)[0], pivot, self.spread)


def joint_of(bar: Bar, pipe: Bar, tilts: tuple[float, float], index: SightIndex) -> LeverJoint | None:
    """Return the joint of a bar and a pipe; None when their sizes or positions do not fit a lever on its pipe.

    If they cross, the pivot lies at their closest approach; if parallel, at the end of the bar behind which no rays
    pass.  The pivot's axis is perpendicular to both and leads from the pipe's axis to the pivot, each condition
    weighted by its accuracy.

    Args:
        tilts: standard deviations of the directions of bar and pipe [rad].
    """
    if pipe.half[0] < 1.2 * bar.half[0] or pipe.length < bar.length:
        return None
    is_parallel = are_parallel(bar, pipe)
    between = bar.middle - pipe.centre
    offset = bar.centre - pipe.centre
    if is_parallel:
        axis = between - (between @ bar.axis) * bar.axis
        nearest = 0.0
    else:
        axis = cross(bar.axis, pipe.axis)
        axis *= np.sign(axis @ between) or 1.0
        nearest = nearest_on(bar, pipe)
    apart = float(np.linalg.norm(axis)) if is_parallel else abs(float(between @ axis) / float(np.linalg.norm(axis)))
    axis = axis / np.linalg.norm(axis)
    along_pipe = float((offset + nearest * bar.axis) @ pipe.axis)
    if not _APART[0] + pipe.half[0] < apart + 0.02 or apart > _APART[1]:
        return None
    if not pipe.first - 0.1 < along_pipe < pipe.last + 0.1:
        return None
    pivot = _pivot(bar, axis, apart - (_OVER_PIPE if is_parallel else _IN_PIPE) * pipe.half[0], index)
    if not is_parallel:
        far = find_far_end(bar, nearest)
        if far is None:
            return None
        # The crossing locates the pivot better than the rays behind the bar.
        clear = pivot.confidence if pivot.far == far else 0.0
        pivot = replace(pivot, along=nearest, far=far, confidence=clear)
    else:
        # The body seen below a lever shows at which end it is held, but not the position.
        end = bar.first if pivot.far > pivot.along else bar.last
        pivot = replace(pivot, along=float(end + np.sign(pivot.far - end) * OVERHANG * bar.half[0]))
    axis, spread = axis_of(bar, pipe, pivot.along, tilts)
    return LeverJoint(axis, pivot, spread)


def nearest_on(bar: Bar, pipe: Bar) -> float:
    """Return the position along a bar, from its centre, that is closest to the axis of a pipe askew to it [m]."""
    cosine, offset = float(bar.axis @ pipe.axis), bar.centre - pipe.centre
    return float((cosine * (offset @ pipe.axis) - offset @ bar.axis) / (1.0 - cosine**2))


def find_far_end(bar: Bar, crossing: float) -> float | None:
    """Return the end of a bar that is away from its crossing with a pipe [m]; None where it crosses at neither end."""
    ends = np.array([bar.first, bar.last])
    k = int(np.argmin(np.abs(ends - crossing)))
    if abs(ends[k] - crossing) > _PIVOT_FROM_END or (crossing - ends[k]) * (1 - 2 * k) < -0.02:
        return None
    return float(ends[1 - k])


def are_parallel(bar: Bar, pipe: Bar) -> bool:
    """Return whether a bar goes along a pipe, so that their directions do not show where it is held."""
    return bool(abs(bar.axis @ pipe.axis) > np.cos(np.radians(_PARALLEL_DEG)))


def axis_of(bar: Bar, pipe: Bar, at: float, tilts: tuple[float, float]) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the unit axis most nearly perpendicular to both bars and along their offset, and its deviation [rad].

    Args:
        at: position of the pivot along the bar [m].
        tilts: standard deviations of the directions of bar and pipe [rad].
    """
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
    """Return the pivot of the bar, with the pipe's near side taken as a face."""
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


@dataclass(frozen=True)
class Settled:
    """Refitted lever or pipe.

    Attributes:
        bar: cut to its ends.
        fit: with its uncertainty; None where the rough bar was kept.
        is_seen: whether rays passed right beyond a lever's free end.
    """

    bar: Bar
    fit: BarFit | None
    is_seen: bool = False


def settle_lever(
    lever: Bar,
    pivot: float,
    up: Float[np.ndarray, "3"],
    index: SightIndex,
    floor: FloorPlane | None,
    *,
    refit: bool = True,
) -> Settled:
    """Return a lever refitted without flange and body: a flange 3 cm below a lever widens and shifts its fit.

    Args:
        lever: rough lever.
        pivot: position of the pivot along the lever's axis, from its centre [m].
        up: (3,) unit, from the pipe to the lever.
        refit: whether the lever is fitted again, or its free end alone.
    """
    place = lever.centre + pivot * lever.axis
    rays = _rays_near(index, lever, floor)
    rays = replace(rays, elsewhere=rays.elsewhere | ((rays.ends - place) @ up < -lever.half[0] - _BELOW))
    first, last = lever.first, lever.last
    at_last = last - pivot > pivot - first
    own = None
    if refit:
        if at_last:
            first = min(max(first, pivot + _NECK), last - _LEAST_RUN)
        else:
            last = max(min(last, pivot - _NECK), first + _LEAST_RUN)
        own = best_round(rays, Run(lever.centre, lever.axis, first, last), LEVER_RADII, TUBES[0], _MOST_RAYS)
    if own is not None:
        lever = _between_ends(own.bar, lever)
    lever, is_seen = _round_off_end(rays, lever, at_last)
    return Settled(lever, own, is_seen)


def settle_pipe(
    pipe: Bar,
    place: Float[np.ndarray, "3"],
    index: SightIndex,
    floor: FloorPlane | None,
    body: float = _BODY,
) -> Settled:
    """Return a pipe refitted beside its valve.

    Args:
        pipe: rough pipe.
        place: (3,) a point in the valve [m].
        body: distance along the pipe from ``place`` up to which rays may end on the valve [m].
    """
    if pipe.length - 2.0 * body <= _LEAST_PIPE:
        return Settled(pipe, None)
    run = Run(pipe.centre, pipe.axis, pipe.first, pipe.last)
    rays = rays_about(index, run, _BEYOND, floor)
    rays = replace(rays, elsewhere=rays.elsewhere | (np.abs((rays.ends - place) @ pipe.axis) < body))
    fit = best_round(rays, run, PIPE_RADII, TUBES[1], _MOST_RAYS)
    return Settled(pipe if fit is None else _between_ends(fit.bar, pipe), fit)


def _rays_near(index: SightIndex, bar: Bar, floor: FloorPlane | None) -> SurroundingRays:
    """Return all rays close to a bar and beyond its ends, unthinned: the last hit locates the end."""
    beyond = replace(bar, first=bar.first - _ABOUT_END, last=bar.last + _ABOUT_END)
    rays = index.passing(beyond.places(_SPACING), _BESIDE)
    elsewhere = np.zeros(len(rays), dtype=bool) if floor is None else floor.above(rays.ends) < _ON_FLOOR
    return SurroundingRays(rays.start, rays.direction, rays.length, elsewhere)


def _between_ends(fitted: Bar, rough: Bar) -> Bar:
    """Return the fitted bar with the ends of the rough one."""
    axis = fitted.axis
    sign = np.sign(axis @ rough.axis)
    ends = [float((rough.centre + at * rough.axis - fitted.centre) @ axis) for at in (rough.first, rough.last)]
    if sign < 0.0:
        ends.reverse()
    return replace(fitted, first=ends[0], last=ends[1])


def _round_off_end(rays: SurroundingRays, bar: Bar, at_last: bool) -> tuple[Bar, bool]:
    """Return the bar with its free end between the last hit and the first pass, and whether that end was seen.

    An oblique ray that passes the end is closest to the axis nearer to the bar's middle than on its near side.
    """
    crossing = cross_bar(rays, bar)
    outcome = sort_rays(rays, crossing)
    radius = bar.half[0]
    inside = crossing.outside < -_INSIDE
    # Axial position of each ray's closest approach, and from it the position at which a bar with a spherical end of
    # its radius would just be missed.
    lean = rays.direction @ bar.axis
    square = np.sqrt(np.maximum(1.0 - lean**2, 1e-6))
    offset = rays.start - bar.centre
    along = offset @ bar.axis
    nearest = along - lean * ((offset * rays.direction).sum(axis=1) - lean * along) / square**2
    half_chord = np.sqrt(np.maximum(radius**2 - crossing.side**2, 0.0)) / square
    sign, end = (1.0, bar.last) if at_last else (-1.0, -bar.first)
    reached = sign * nearest + radius - half_chord
    near = inside & (np.abs(reached - end) < _ABOUT_END)
    passes = reached[near & outcome.passed]
    end = _border(reached[near & outcome.hit], passes, end)
    is_seen = bool(np.count_nonzero(passes > end) >= _FEWEST)
    return replace(bar, last=end) if at_last else replace(bar, first=-end), is_seen


def _border(hits: Float[np.ndarray, "K"], passes: Float[np.ndarray, "M"], fallback: float) -> float:
    """Return the axial position that best separates hits from passes further out [m]."""
    if not len(hits) or not len(passes):
        return fallback
    places = np.sort(np.concatenate([hits, passes]))
    # Errors with the border right behind each position: hits beyond it and passes before it.
    wrong = (hits[None] > places[:, None]).sum(axis=1) + (passes[None] <= places[:, None]).sum(axis=1)
    best = np.flatnonzero(wrong == wrong.min())
    behind = np.append(places[1:], places[-1])
    return float(np.mean(0.5 * (places[best] + behind[best])))
