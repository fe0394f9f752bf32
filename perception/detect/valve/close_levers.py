"""Levers a few centimetres before their pipe, as of ball valves: found outside fitted pipes, joined over a body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.cleaning.clean import voxel_downsample
from perception.detect.shared.arithmetic import cross, rising
from perception.detect.shared.bar_pivot import Pivot
from perception.detect.shared.bars import Bar
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.lever_bars import (
    LEVER_RADII,
    LONGEST_LINE,
    TUBES,
    FittedBar,
    distances_from,
    fit_line,
    in_air,
    is_lever,
)
from perception.detect.valve.lever_joint import (
    OVERHANG,
    LeverJoint,
    are_parallel,
    axis_of,
    find_far_end,
    nearest_on,
    settle_lever,
    settle_pipe,
)
from perception.detect.valve.lever_on_pipe import END_UNSEEN, LeverOnPipe, rate_lever, rate_pipe, rate_pivot
from perception.detect.valve.lines import find_lines
from perception.detect.valve.valve_body import ValveBody, find_body
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex

_VOXEL = 0.012
_LEVELS = (0.02, 0.04)  # least distances of a lever's points from the pipe's surface: a flange may reach the first [m]
_REACH = 0.12  # greatest one [m]
_TUBE, _BALL, _N_PAIRS, _LEAST = (0.02,), 0.05, 6, 0.08
_MOST_LINES, _FEWEST = 4, 20
_BEYOND = 0.1
_BESIDE = 0.13  # of a lever along its pipe: the pipe is fitted further away [m]
_HOPELESS = 0.02
_OVER = (0.015, 0.13)  # distance of a lever's middle from the pipe's surface [m]
_WIDEST, _LONGEST = 1.0, (13.0, 16.0)  # radius and length of a lever, in radii of its pipe
_NEARER = (0.2, 0.5)  # by which the body is nearer to one end than to the other, in the distance of the ends
_EVIDENCE = (2.0, 5.0)  # logarithm of the odds of a body
_SPREADS = (np.radians(2.5), np.radians(4.5))  # deviation of an axis rated 1, and of one rated 0 [rad]
_LONG_ENOUGH = 0.17  # of a lever for a fit without the part over its body [m]
_MOST_SHIFT = 0.03  # from a pivot by the lever's end to one by the body's middle [m]
# Standard deviations of a pivot by the lever's end, of the distance of lever and pipe from their crossing, both across
# their axes, and of a pivot by the body's middle [m].
_SIGMA_END, _SIGMA_LATERAL, _SIGMA_BODY = 0.012, 0.005, 0.012
_LEAST_ANGLE = 0.1  # of lever and pipe [rad], below which their crossing is unknown
_ABOUT_END, _BLUR = 0.06, 0.015  # reach about a free end, and of the noise across rays at an edge [m]
_JOINED = (0.2, 0.4)  # points that join a lever at its free end, over those on it there
_OFF_BODY, _OFF_BODY_BY = 0.015, (0.2, 0.4)  # of a pivot from the body's middle: [m], and in the body's length


def find_close_levers(
    pipes: Sequence[FittedBar], foreground: Foreground, floor: FloorPlane | None
) -> list[tuple[FittedBar, FittedBar]]:
    """Return slim bars close before a pipe, each with its pipe.

    A lever of sheet metal along its pipe makes one line of points with it.  Outside the fitted pipe it stands alone.
    """
    pairs: list[tuple[FittedBar, FittedBar]] = []
    for pipe in pipes:
        if rate_pipe(pipe) < _HOPELESS:
            continue
        along, apart = distances_from(pipe.bar, foreground.points)
        out = apart - pipe.bar.half[0]
        near = (along > pipe.bar.first - _BEYOND) & (along < pipe.bar.last + _BEYOND) & (out < _REACH)
        for level in _LEVELS:
            points = foreground.points[near & (out > level)]
            if len(points) < _FEWEST:
                break
            points, _ = voxel_downsample(points, _VOXEL)
            lines = find_lines(points, foreground.generator(), _TUBE, _LEAST, n_pairs=_N_PAIRS, slim_ball=_BALL)
            short = [line for line in lines if line.last - line.first < LONGEST_LINE]
            behind = (pipe.bar, level)
            for line in in_air(short, foreground.index, floor, LEVER_RADII[1:2], behind)[:_MOST_LINES]:
                lever = fit_line(line, foreground.index, floor, LEVER_RADII, TUBES[0], behind)
                if lever is not None and is_lever(lever) and rate_lever(lever) > _HOPELESS:
                    pairs.append((lever, pipe))
    return pairs


def join_close(lever: FittedBar, pipe: FittedBar, index: SightIndex, floor: FloorPlane | None) -> LeverOnPipe | None:
    """Return the valve of a lever close before its pipe; None where no body on the pipe holds the lever at one end.

    The gap between lever and pipe is hardly deeper than the noise, so that rays do not show at which end it is open.
    The body of the valve does.
    """
    confidence = rate_lever(lever) * rate_pipe(pipe)
    if confidence < _HOPELESS:
        return None
    reach = 0.5 * lever.bar.length * abs(float(lever.bar.axis @ pipe.bar.axis)) + _BESIDE
    clear = settle_pipe(pipe.bar, lever.bar.middle, index, floor, reach)
    tilt = (clear.fit or pipe.fit).spread[0]
    rough = _hold(lever.bar, clear.bar, (lever.fit.spread[0], tilt), index, floor)
    if rough is None or confidence * rate_pivot(rough.pivot, lever.bar.half[0]) < _HOPELESS:
        return None
    own = settle_lever(lever.bar, rough.pivot.along, rough.axis, index, floor, refit=lever.bar.length > _LONG_ENOUGH)
    joint = _hold(own.bar, clear.bar, ((own.fit or lever.fit).spread[0], tilt), index, floor)
    if joint is None or (joint.pivot.far > joint.pivot.along) != (rough.pivot.far > rough.pivot.along):
        return None
    is_end_seen = own.is_seen and lever.ends.seen[rough.pivot.far == lever.bar.last]
    confidence *= rate_pivot(joint.pivot, own.bar.half[0]) * (1.0 if is_end_seen else END_UNSEEN)
    confidence *= rising(-joint.spread, -_SPREADS[1], -_SPREADS[0]) * _rate_free_end(own.bar, joint, index)
    return LeverOnPipe(lever, own.bar, joint, float(confidence), pipe)


def _hold(
    bar: Bar, pipe: Bar, tilts: tuple[float, float], index: SightIndex, floor: FloorPlane | None
) -> LeverJoint | None:
    """Return the joint of a lever at the body on its pipe; None when sizes, positions or body do not fit.

    Args:
        pipe: fitted beside the body.
        tilts: standard deviations of the directions of lever and pipe [rad].
    """
    up = bar.middle - pipe.centre
    up = up - (up @ pipe.axis) * pipe.axis
    if not are_parallel(bar, pipe):
        normal = cross(bar.axis, pipe.axis)
        up = normal * (np.sign(normal @ up) or 1.0)
    up = up / np.linalg.norm(up)
    over = float((bar.middle - pipe.centre) @ up) - pipe.half[0]
    if not _OVER[0] < over < _OVER[1] or bar.half[0] > _WIDEST * pipe.half[0] or pipe.length < 2.0 * bar.length:
        return None
    body = find_body(pipe, bar, up, index, floor)
    if body is None:
        return None
    ends = (bar.first, bar.last)
    inwards = OVERHANG * bar.half[0]
    pivots = [bar.first + inwards, bar.last - inwards]
    along_pipe = [float((bar.centre + at * bar.axis - pipe.centre) @ pipe.axis) for at in pivots]
    off = [abs(at - body.middle) for at in along_pipe]
    if are_parallel(bar, pipe):
        k = int(np.argmin(off))
        is_held = rising((off[1 - k] - off[k]) / abs(along_pipe[1] - along_pipe[0]), *_NEARER)
    else:
        far = find_far_end(bar, nearest_on(bar, pipe))
        if far is None:
            return None
        k, is_held = 1 - ends.index(far), 1.0
    pivot = _place_pivot(bar, pipe, pivots[k], body)
    place = float((bar.centre + pivot * bar.axis - pipe.centre) @ pipe.axis)
    is_held *= rising(body.evidence, *_EVIDENCE) * _is_at(place, body)
    is_held *= rising(-abs(ends[1 - k] - pivot) / pipe.half[0], -_LONGEST[1], -_LONGEST[0])
    axis, spread = axis_of(bar, pipe, pivot, tilts)
    return LeverJoint(axis, Pivot(pivot, ends[1 - k], over, is_held), spread)


def _is_at(place: float, body: ValveBody) -> float:
    """Return the rating, 0 to 1, of a pivot's position along the pipe by its distance from the body's middle."""
    off = abs(place - body.middle) - _OFF_BODY
    length = body.last - body.first
    return rising(-off, -_OFF_BODY_BY[1] * length, -_OFF_BODY_BY[0] * length)


def _place_pivot(bar: Bar, pipe: Bar, by_end: float, body: ValveBody) -> float:
    """Return the position of the pivot along a lever, from its centre [m].

    It is the mean, weighted by accuracy, of the position usual for the lever's end, of the closest approach of lever
    and pipe, and of the middle of the body, above which the stem stands.
    """
    cosine = float(bar.axis @ pipe.axis)
    sine = float(np.sqrt(max(1.0 - cosine**2, 0.0)))
    estimates = [(by_end, _SIGMA_END)]
    if sine > _LEAST_ANGLE:
        estimates.append((nearest_on(bar, pipe), _SIGMA_LATERAL / sine))
    if abs(cosine) > _LEAST_ANGLE:
        middle = (body.middle - float((bar.centre - pipe.centre) @ pipe.axis)) / cosine
        if abs(middle - by_end) < _MOST_SHIFT:
            estimates.append((middle, _SIGMA_BODY / abs(cosine)))
    places, sigmas = np.array(estimates).T
    return float(np.average(places, weights=sigmas**-2.0))


def _rate_free_end(bar: Bar, joint: LeverJoint, index: SightIndex) -> float:
    """Return the rating, 0 to 1, that nothing joins a lever at its free end, as a rim joins a wheel's spoke.

    It falls with the number of points beside and beyond the end, above the lever's axis, over that on the lever there.
    """
    far = bar.centre + joint.pivot.far * bar.axis
    outwards = np.sign(joint.pivot.far - joint.pivot.along) * bar.axis
    ends = index.passing(far[None], _ABOUT_END).ends - far
    past, height = ends @ outwards, ends @ joint.axis
    aside = np.abs(ends @ cross(joint.axis, outwards))
    level = (height > 0.0) & (height < _ABOUT_END) & (np.abs(past) < _ABOUT_END) & (aside < _ABOUT_END)
    on_lever = level & (past < 0.0) & (aside < bar.half[0])
    joined = level & ((aside > bar.half[0] + _BLUR) | (past > _BLUR))
    return 1.0 - rising(float(joined.sum()) / max(float(on_lever.sum()), 1.0), *_JOINED)
