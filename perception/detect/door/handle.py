"""Handle on a face: a bar or knob that stands out of the face, rated by the end of each ray towards it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.door.bar import Bar, NearRays, fit_ball, fit_bar, rate_extensions
from perception.detect.door.bump import HEIGHTS, JAMB, LONG_SLACK, Bump, DoorFace, find_bumps, rays_towards
from perception.detect.door.profile import Rays
from perception.detect.door.upright import Upright

_ABOUT = 0.015
_OUT = (0.025, 0.1)  # standoffs a handle can have [m]
_FEWEST, _MANY = 3, 40  # rays
_RING = 0.04
_MOST_SLACK = 0.12
_PULL_END = 0.1
_FRONT = 0.75  # mean distance of a bar's returns in front of its centre line, in radii
_THIN, _BAR = 0.005, 0.012  # least and largest radius of a bar across a face [m]
_THINNEST_KNOB, _NO_KIND = 0.018, 0.4
_START_RADIUS = 0.01
_NEAR = 0.12
_WENT_ON, _EDGE = 0.06, 0.06
_TRUSTED = 0.5  # share of a fitted bar's likelihood that counts: the best of many bars fits noise as well
_LEAST_BAR = 4.0  # length of a bar, in radii; shorter ones are knobs
_SLACK = 0.03  # of a handle's middle, measured in the bump and in the fitted bar [m]
_STEEPEST_LEVER, _FLATTEST_PULL = np.radians(55.0), np.radians(65.0)


@dataclass(frozen=True)
class Handle:
    """Bar or knob that stands out of a face.

    Attributes:
        low, high: (2,) corners along the plane and up [m].
        bar: the round bar of greatest likelihood; None of a bar across the face.
        out: distance of its bar's centre line from the face [m].
        is_lever: a bar that is level or inclined.
        is_pull: a bar much higher than wide.
        is_panic: a bar across most of the face.
        evidence: log odds of its rays against the bare face, minus those that noise alone reaches.
        noise: log odds that noise alone reaches on this face.
        purity: share of the rays through its rectangle that met it.
        alone: share of the rays just beside it that met the face behind; of a pull, also above and below it.
        pivot_side: end of a lever, -1 or 1, near which a neck or rose was seen; else 0.
        extensions: (2, E) log likelihoods that the bar's first and second end lie further out by ``bar.EXTENSIONS``.
        slack: (2,) length by which it may extend unseen beyond its low and high end along the plane [m].
    """

    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    bar: Bar | None
    out: float
    is_lever: bool
    is_pull: bool
    is_panic: bool
    evidence: float
    noise: float
    purity: float
    alone: float
    pivot_side: int
    slack: tuple[float, float]
    extensions: Float[np.ndarray, "2 E"] | None = None

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """(2,) centre of its rectangle along the plane and up [m]."""
        return np.asarray(0.5 * (self.low + self.high))

    @property
    def front(self) -> float:
        """Distance of its near side from the face, where most rays met it [m]."""
        return self.out + _FRONT * (_BAR if self.bar is None else self.bar.radius)

    @property
    def gap(self) -> float:
        """Width of the air behind its bar [m]; a face that bulges has none."""
        return self.out if self.bar is None else self.out - self.bar.radius

    @property
    def is_round(self) -> bool:
        """Whether it is as thick as a knob."""
        return self.bar is not None and self.bar.radius + 0.25 * self.bar.axis_length > _THINNEST_KNOB

    @property
    def quality(self) -> float:
        """Certainty that it is a handle, 0 to 1."""
        return float(
            np.clip(self.evidence / max(30.0, self.noise), 0.0, 1.0)
            * np.clip((self.gap + 0.01) / 0.008, 0.0, 1.0)
            * np.clip((self.purity - 0.4) / 0.25, 0.0, 1.0)
            * np.clip((self.alone - 0.5) / 0.25, 0.0, 1.0)
            * np.clip((self.front - 0.031) / 0.008, 0.0, 1.0)
            * np.clip((0.103 - self.front) / 0.006, 0.0, 1.0)
            * (1.0 if self.is_lever or self.is_pull or self.is_panic or self.is_round else _NO_KIND)
        )


def find_handle(
    plane: Upright, low: float, high: float, rms: float, ground: float, rays: Rays, prefer: int = 0
) -> Handle | None:
    """Return the best handle near a side edge of a face, or a bar across it; None when nothing stands out.

    Args:
        low, high: side edges of the face along the plane [m].
        rms: scatter of the face's points [m].
        prefer: side edge to search (-1 low, 1 high); 0 both.
    """
    face = DoorFace(plane, low, high, ground, float(np.clip(rms, 0.006, 0.02)))
    measured = (_measure(face, rays, bump) for bump in find_bumps(face, rays, prefer))
    # A bar fitted to the rays about a bump may be a part of something else, far above or below it.
    seen = [handle for handle in measured if _is_at_hand(handle, ground)]
    return max(seen, key=lambda handle: (handle.quality, handle.evidence), default=None)


def _is_at_hand(handle: Handle, ground: float) -> bool:
    """Return whether a handle's middle is at a height where doors have theirs."""
    slack = _SLACK + (LONG_SLACK if handle.is_pull else 0.0)
    return bool(HEIGHTS[0] - slack < handle.centre[1] - ground < HEIGHTS[1] + slack)


@dataclass(frozen=True)
class _Seen:
    """The K rays that are evidence for a bump, and the rectangle of those that met it.

    Attributes:
        mine: (R,) mask of these rays among all.
        at: (K, 2) crossing with the plane of the bump's near side [m].
        depth: (K,) distance of the ray's end out of the face [m].
        vote: (K,) log odds that the ray met the bump, against the face.
        met: (K,) rays that met the bump.
        out: standoff of the bump [m].
        low, high: (2,) corners of the rectangle [m].
    """

    mine: Bool[np.ndarray, "R"]
    at: Float[np.ndarray, "K 2"]
    depth: Float[np.ndarray, "K"]
    vote: Float[np.ndarray, "K"]
    met: Bool[np.ndarray, "K"]
    out: float
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]

    @property
    def size(self) -> Float[np.ndarray, "2"]:
        """(2,) size of the rectangle along the face and up [m]."""
        return np.asarray(self.high - self.low)

    def within(self, margin: float) -> Bool[np.ndarray, "K"]:
        """Return (K,) rays that cross inside the rectangle grown by ``margin`` [m] on each side."""
        return np.asarray(((self.at >= self.low - margin) & (self.at <= self.high + margin)).all(axis=1))


def _measure(face: DoorFace, rays: Rays, bump: Bump) -> Handle:
    """Return the handle at a bump: its extent, standoff and surroundings, measured by the rays towards it."""
    seen = _look_at(face, rays, bump)
    if seen.size[0] > 0.4 * face.width:
        return _measure_panic(face, rays, bump, seen)
    near = _near_rays(face, rays, seen)
    bar = fit_bar(near, _first_bar(seen))
    is_long = bar.length > _LEAST_BAR * bar.radius
    is_lever = bool(is_long and bar.length > 0.065 and bar.tilt < _STEEPEST_LEVER)
    is_pull = bool(is_long and bar.length > 0.12 and bar.tilt > _FLATTEST_PULL)
    if not is_lever and not is_pull:
        # The neck of a knob makes it look long from aside.
        bar = fit_ball(near, bar)
    half = 0.5 * bar.axis_length * np.abs(bar.axis) + bar.radius
    inside = bar.reached_by(near)[0] < -0.3 * bar.radius
    met = near.out > 0.5 * bar.out
    return Handle(
        bar.middle - half,
        bar.middle + half,
        bar,
        bar.out,
        is_lever,
        is_pull,
        False,
        max(bump.evidence, -_TRUSTED * bar.cost * len(near.length)),
        bump.noise,
        float(np.mean(met[inside])) if inside.any() else 0.0,
        _free_share(face, seen, bar, near, is_pull),
        _neck_side(face, seen, bar) if is_lever else 0,
        _slack(face, seen, bar),
        rate_extensions(near, bar),
    )


def _measure_panic(face: DoorFace, rays: Rays, bump: Bump, seen: _Seen) -> Handle:
    """Return the bar across a face at a bump."""
    radius = float(np.clip(0.5 * seen.size.min(), _THIN, _BAR))
    middle = seen.out - _FRONT * radius
    low, high = _ends(seen, rays.crossing(face.plane, middle)[0])
    inside = seen.within(0.0)
    purity = float(np.mean(seen.vote[inside] > 0.0)) if inside.any() else 0.0
    on_face = np.abs(seen.depth) < max(2.5 * face.sigma, 0.02)
    beside = seen.within(_RING) & ~seen.within(_ABOUT)
    alone = float(np.mean(on_face[beside])) if beside.any() else 0.0
    return Handle(low, high, None, middle, False, False, True, bump.evidence, bump.noise, purity, alone, 0, (0.0, 0.0))


def _first_bar(seen: _Seen) -> Bar:
    """Return a bar along the rays that met a bump, or else along its rectangle."""
    places = seen.at[seen.met] if seen.met.sum() >= _FEWEST else np.stack([seen.low, seen.high])
    middle = places.mean(axis=0)
    axis = np.linalg.eigh(np.cov((places - middle).T))[1][:, 1]
    low, high = np.percentile((places - middle) @ axis, [3.0, 97.0])
    inset = min(_START_RADIUS, 0.45 * float(high - low))
    ends = middle + np.outer([low + inset, high - inset], axis)
    return Bar(ends, max(seen.out - _FRONT * _START_RADIUS, _OUT[0]), _START_RADIUS, 0.0)


def _near_rays(face: DoorFace, rays: Rays, seen: _Seen) -> NearRays:
    """Return the rays that count as evidence within ``_NEAR`` of a bump's rectangle, in the face's coordinates."""
    chosen = np.flatnonzero(seen.mine)[seen.within(_NEAR)]
    return NearRays.of(face.plane.local(rays.starts[chosen]), face.plane.local(rays.ends[chosen]), face.sigma)


def _look_at(face: DoorFace, rays: Rays, bump: Bump) -> _Seen:
    """Return the rays towards a bump with its measured standoff and the rectangle of those that met it."""
    out = bump.out
    for _ in range(2):
        seen = rays_towards(rays, face, out)
        core = seen.mine & ((seen.at > bump.low - _ABOUT) & (seen.at < bump.high + _ABOUT)).all(axis=1)
        core &= seen.depth > 0.6 * out
        if core.sum() < _FEWEST:
            break
        out = float(np.clip(np.median(seen.depth[core]), *_OUT))
    seen = rays_towards(rays, face, out)
    at, depth = seen.at[seen.mine], seen.depth[seen.mine]
    vote = face.votes(depth, out)
    met = ((at > bump.low - 0.02) & (at < bump.high + 0.02)).all(axis=1) & (vote > 0.0)
    low, high = _corners(at[met]) if met.sum() >= _FEWEST else (bump.low, bump.high)
    return _Seen(seen.mine, at, depth, vote, met, out, low, high)


def _corners(places: Float[np.ndarray, "K 2"]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return low and high corner of the points' bounding rectangle; of many points, 2 % at each end are ignored [m]."""
    trim = 2.0 if len(places) > _MANY else 0.0
    low, high = np.percentile(places, [trim, 100.0 - trim], axis=0)
    return low, high


def _ends(seen: _Seen, at: Float[np.ndarray, "R 2"]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return low and high corner on the plane of the bump's centre line, which the rays cross ``at`` [m].

    Rays from above meet a bar's near side higher up than that plane.
    """
    return _corners(at[seen.mine][seen.met]) if seen.met.sum() >= _FEWEST else (seen.low, seen.high)


def _free_share(face: DoorFace, seen: _Seen, bar: Bar, near: NearRays, is_pull: bool) -> float:
    """Return the share of the rays beside a bar that met the face; low for a pipe, which continues up and down."""
    limit = max(2.5 * face.sigma, 0.02)
    outside = bar.reached_by(near)[0]
    beside_bar = (outside > _ABOUT) & (outside < _RING)
    # Rays that went on just inside of an edge show only that the edge lies further in.
    at = near.start[:, 0] - near.start[:, 2] / near.direction[:, 2] * near.direction[:, 0]
    beside_bar &= (near.out > -_WENT_ON) | ((at > face.low + _EDGE) & (at < face.high - _EDGE))
    ring = np.abs(near.out[beside_bar]) < limit
    beside = [ring]
    if is_pull:
        column = np.abs(seen.at[:, 0] - bar.middle[0]) < bar.radius
        half = 0.5 * bar.length
        for end in (bar.middle[1] - half - _ABOUT - _PULL_END, bar.middle[1] + half + _ABOUT):
            mine = column & (seen.at[:, 1] > end) & (seen.at[:, 1] < end + _PULL_END)
            beside.append(np.abs(seen.depth[mine]) < limit)
    return min(float(np.mean(side)) if len(side) else 0.0 for side in beside)


def _in_bar(bar: Bar, places: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
    """Return (K, 2) coordinates from the bar's middle, along its axis and across it [m]."""
    across = np.array([-bar.axis[1], bar.axis[0]])
    return np.asarray((places - bar.middle) @ np.stack([bar.axis, across]).T)


def _slack(face: DoorFace, seen: _Seen, bar: Bar) -> tuple[float, float]:
    """Return the gap from the low and the high end to the first ray past it, or to the face's edge [m]."""
    half, radius = 0.5 * bar.length, max(0.7 * bar.radius, 0.005)
    along, across = _in_bar(bar, seen.at[seen.vote < 0.0]).T
    past = along[np.abs(across) < radius]
    below, above = -half - past[past < -half], past[past > half] - half
    room = [bar.middle[0] - half - face.low - JAMB, face.high - bar.middle[0] - half - JAMB]
    most = np.clip(np.array(room), 0.0, _MOST_SLACK)
    return (
        float(min(below.min(initial=_MOST_SLACK), most[0])),
        float(min(above.min(initial=_MOST_SLACK), most[1])),
    )


def _neck_side(face: DoorFace, seen: _Seen, bar: Bar) -> int:
    """Return the end, -1 or 1, near which more rays ended between bar and face (the neck); 0 when unclear."""
    along, across = _in_bar(bar, seen.at).T
    about = (np.abs(across) < 0.035) & (np.abs(along) < 0.5 * bar.length + 0.03)
    between = about & (seen.depth > 2.0 * face.sigma) & (seen.depth < seen.out - 1.5 * face.sigma)
    right, left = int((between & (along > 0)).sum()), int((between & (along < 0)).sum())
    if max(left, right) < 5 or max(left, right) < 2.5 * min(left, right):
        return 0
    return 1 if right > left else -1
