"""A lever and its pipe, each fitted without what belongs to the other or to the body between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.detect.shared.bar_fit import BarFit
from perception.detect.shared.bar_search import rays_about
from perception.detect.shared.bar_starts import Run
from perception.detect.shared.bars import Bar, SurroundingRays, cross_bar, sort_rays
from perception.detect.valve.lever_bars import LEVER_RADII, PIPE_RADII, TUBES, best_round
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex

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
class Settled:
    """A lever and its pipe.

    Attributes:
        lever: with its ends.
        pipe: with its ends.
        fits: of both, with how surely they are there; None: as they were.
        is_seen: whether rays went past right beyond the lever's free end.
    """

    lever: Bar
    pipe: Bar
    fits: tuple[BarFit | None, BarFit | None]
    is_seen: bool


def settled(
    lever: Bar,
    pipe: Bar,
    pivot: float,
    up: Float[np.ndarray, "3"],
    index: SightIndex,
    floor: FloorPlane | None,
) -> Settled:
    """Both fitted anew: a flange 3 cm below a lever widens it and draws it aside, as the body does with the pipe.

    Args:
        lever: roughly.
        pipe: roughly.
        pivot: where the lever is held, from its centre along its axis [m].
        up: (3,) unit, from the pipe to the lever.
        index: all rays.
        floor: below everything.
    """
    place = lever.centre + pivot * lever.axis
    rays = _near(index, lever, floor)
    rays = replace(rays, elsewhere=rays.elsewhere | ((rays.ends - place) @ up < -lever.half[0] - _BELOW))
    first, last = lever.first, lever.last
    at_last = last - pivot > pivot - first
    if at_last:
        first = min(max(first, pivot + _NECK), last - _LEAST_RUN)
    else:
        last = max(min(last, pivot - _NECK), first + _LEAST_RUN)
    own = best_round(rays, Run(lever.centre, lever.axis, first, last), LEVER_RADII, TUBES[0], _MOST_RAYS)
    if own is not None:
        lever = _from(own.bar, lever)
    lever, is_seen = _ended(rays, lever, at_last)
    other = None
    if pipe.length - 2.0 * _BODY > _LEAST_PIPE:
        rays = rays_about(index, Run(pipe.centre, pipe.axis, pipe.first, pipe.last), _BEYOND, floor)
        rays = replace(rays, elsewhere=rays.elsewhere | (np.abs((rays.ends - place) @ pipe.axis) < _BODY))
        other = best_round(rays, Run(pipe.centre, pipe.axis, pipe.first, pipe.last), PIPE_RADII, TUBES[1], _MOST_RAYS)
        if other is not None:
            pipe = _from(other.bar, pipe)
    return Settled(lever, pipe, (own, other), is_seen)


def _near(index: SightIndex, bar: Bar, floor: FloorPlane | None) -> SurroundingRays:
    """All rays close to a bar and its ends: the last one that met it tells its end."""
    beyond = replace(bar, first=bar.first - _ABOUT_END, last=bar.last + _ABOUT_END)
    rays = index.passing(beyond.places(_SPACING), _BESIDE)
    elsewhere = np.zeros(len(rays), dtype=bool) if floor is None else floor.above(rays.ends) < _ON_FLOOR
    return SurroundingRays(rays.start, rays.direction, rays.length, elsewhere)


def _from(fitted: Bar, rough: Bar) -> Bar:
    """A fitted bar from and to where the rough one goes."""
    axis = fitted.axis
    sign = np.sign(axis @ rough.axis)
    ends = [float((rough.centre + at * rough.axis - fitted.centre) @ axis) for at in (rough.first, rough.last)]
    if sign < 0.0:
        ends.reverse()
    return replace(fitted, first=ends[0], last=ends[1])


def _ended(rays: SurroundingRays, bar: Bar, at_last: bool) -> tuple[Bar, bool]:
    """The bar with its free end rounded, halfway between the last ray that met it and the first that went past, and
    whether any went past beyond.

    A ray that leans on the bar goes past its end nearer to its middle than it would cross its near side.
    """
    crossing = cross_bar(rays, bar)
    told = sort_rays(rays, crossing)
    radius = bar.half[0]
    inside = crossing.outside < -_INSIDE
    # Where on the axis each ray comes nearest to it, and how far before that place a ball of the bar's radius would
    # have to end to be missed.
    lean = rays.direction @ bar.axis
    square = np.sqrt(np.maximum(1.0 - lean**2, 1e-6))
    offset = rays.start - bar.centre
    along = offset @ bar.axis
    nearest = along - lean * ((offset * rays.direction).sum(axis=1) - lean * along) / square**2
    half_chord = np.sqrt(np.maximum(radius**2 - crossing.side**2, 0.0)) / square
    sign, end = (1.0, bar.last) if at_last else (-1.0, -bar.first)
    reached = sign * nearest + radius - half_chord
    near = inside & (np.abs(reached - end) < _ABOUT_END)
    passes = reached[near & told.passed]
    end = _border(reached[near & told.hit], passes, end)
    is_seen = bool(np.count_nonzero(passes > end) >= _FEWEST)
    return replace(bar, last=end) if at_last else replace(bar, first=-end), is_seen


def _border(hits: Float[np.ndarray, "K"], passes: Float[np.ndarray, "M"], fallback: float) -> float:
    """The middle of the gap that best parts hits from passes further out."""
    if not len(hits) or not len(passes):
        return fallback
    places = np.sort(np.concatenate([hits, passes]))
    # With the border right behind each place: hits beyond it and passes before it are wrong.
    wrong = (hits[None] > places[:, None]).sum(axis=1) + (passes[None] <= places[:, None]).sum(axis=1)
    best = np.flatnonzero(wrong == wrong.min())
    behind = np.append(places[1:], places[-1])
    return float(np.mean(0.5 * (places[best] + behind[best])))
