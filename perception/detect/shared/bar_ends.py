"""Most likely ends of a bar, from the rays that hit or pass its outline, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.shared.bars import NEAR_SURFACE, Bar, BarCrossing, Sorted, SurroundingRays, cross_bar, sort_rays
from perception.ground.floor import FloorPlane

_INSIDE = 0.003
_BIN = 0.02
# Of the rays inside the outline that reach it: share that ends near its surface where the bar is (ON) and where it is
# not (OFF, other objects), share that passes through where it is, and standard deviation of depth [m].
_HIT_ON, _HIT_OFF, _PASS_ON, _SIGMA = 0.95, 0.15, 0.03, 0.014
_ON, _OFF = _HIT_ON / (_SIGMA * np.sqrt(2.0 * np.pi)), _HIT_OFF / (2.0 * NEAR_SURFACE)
_LOST = float(np.log(_PASS_ON / (1.0 - _HIT_OFF)))
_MOST_IN_BIN = 4.0
# Log likelihoods: cost of an unseen metre, drop that ends the search, difference that leaves two ends undecided.
_UNSEEN_COST = 40.0
_HOPELESS = 15.0
_UNDECIDED = 4.0
_MOST_UNSEEN, _MOST_COVERED = 0.24, 0.6
_ON_FLOOR, _LEAST_SLOPE = 0.02, 0.05
_MOST_HIDDEN = 0.1
_NEAR, _BEYOND = 0.06, 0.08
_DESCENDS = 0.05
_DIGITS = 9


@dataclass(frozen=True)
class LikelyEnds:
    """Most likely ends of a bar; each has an interval of possible positions.

    Attributes:
        bar: cut at these ends: each at the middle of its interval, or at the inner bound of one longer than 20 cm.
        seen: for the first and the last end, whether rays passed just beyond the interval's inner bound.
        hidden: for each end, how much longer the bar may be, at most 10 cm; below 10 cm also how much shorter [m].
    """

    bar: Bar
    seen: tuple[bool, bool]
    hidden: tuple[float, float]


def likely_ends(rays: SurroundingRays, bar: Bar, floor: FloorPlane | None) -> LikelyEnds:
    """Return the bar's most likely ends, searched from its middle outwards.

    Args:
        bar: only the middle between its ends matters, and its length where no ray hit it.
    """
    crossing = cross_bar(rays, bar)
    outcome = sort_rays(rays, crossing)
    inside = crossing.outside < -_INSIDE
    gains = _gains(rays, crossing, outcome, floor)
    speaks, stopped = inside & (gains != 0.0), crossing.along[inside & outcome.before]
    hits = inside & outcome.hit
    middle = 0.5 * (bar.first + bar.last)
    first, last = (
        _end(at[speaks], gains[speaks], hits[speaks], sign * (stopped - middle))
        or _End(max(0.25 * bar.length, _BIN), np.inf, False)
        for sign, at in ((sign, sign * (crossing.along - middle)) for sign in (-1.0, 1.0))
    )
    if floor is not None:
        nearest = replace(bar, first=middle - first.nearest, last=middle + last.nearest)
        height = _ON_FLOOR + max(0.0, float(floor.above(nearest.corners).min()))
        descent = float(bar.axis @ floor.normal)
        first, last = first.above(height, descent), last.above(height, -descent)
    # An end lies where a ray crosses the bar: rounded, it is clearly before or behind that ray.
    cut = replace(bar, first=round(middle - first.place, _DIGITS), last=round(middle + last.place, _DIGITS))
    return LikelyEnds(cut, (first.is_seen, last.is_seen), (first.hidden, last.hidden))


def _gains(
    rays: SurroundingRays, crossing: BarCrossing, outcome: Sorted, floor: FloorPlane | None
) -> Float[np.ndarray, "N"]:
    """Return each ray's log likelihood ratio of bar against no bar; 0: the ray is no evidence."""
    gap = rays.length - crossing.depth
    gain = np.maximum(_LOST, np.log(_ON / _OFF) - 0.5 * (gap / _SIGMA) ** 2) * (outcome.hit | outcome.passed)
    if floor is not None:
        # A ray that ended on the floor close under the bar is weighed by which of the two surfaces is nearer.
        downwards = np.minimum(rays.direction @ floor.normal, -_LEAST_SLOPE)
        beyond = floor.above(rays.start) / -downwards - crossing.depth
        of_floor = np.clip(0.5 * ((gap - beyond) ** 2 - gap**2) / _SIGMA**2, _LOST, 0.0)
        gain = np.where(rays.elsewhere & ~outcome.before, of_floor, gain)
    return np.asarray(gain)


@dataclass(frozen=True)
class _End:
    """Interval in which a bar ends, from its middle [m], and whether rays passed just beyond ``nearest``."""

    nearest: float
    furthest: float
    is_seen: bool

    @property
    def hidden(self) -> float:
        """Half the interval's length, at most 10 cm [m]."""
        return min(_MOST_HIDDEN, 0.5 * (self.furthest - self.nearest))

    @property
    def place(self) -> float:
        """Middle of the interval, or its inner bound if it is longer than 20 cm [m]."""
        return self.nearest + (self.hidden if self.hidden < _MOST_HIDDEN else 0.0)

    def above(self, height: float, descent: float) -> _End:
        """Cut the interval where the bar, ``height`` [m] over the floor and falling ``descent`` per metre, meets it."""
        if descent <= _DESCENDS:
            return self
        return replace(self, furthest=min(self.furthest, self.nearest + height / descent))


def _end(
    at: Float[np.ndarray, "K"],
    gain: Float[np.ndarray, "K"],
    hit: Bool[np.ndarray, "K"],
    stopped: Float[np.ndarray, "S"],
) -> _End | None:
    """Return the interval of the bar's end in the positive direction; None: no hit there."""
    keep = np.flatnonzero(at > -_BIN)
    keep = keep[np.argsort(at[keep], kind="stable")]
    at, gain, hit = at[keep], gain[keep], hit[keep]
    if not hit.any():
        return None
    is_pass = gain < 0.5 * _LOST
    # Neighbouring rays are not independent: one object affects all of them.
    in_bin = np.floor(at / _BIN).astype(np.int64) + 1
    gain = gain * np.minimum(1.0, _MOST_IN_BIN / np.bincount(in_bin)[in_bin])
    total = np.cumsum(gain)
    steps = np.maximum(np.diff(at, prepend=0.0) - _BIN, 0.0)
    within = _count_followed(at, steps, total, np.sort(stopped))
    worth = (total - _UNSEEN_COST * np.cumsum(steps))[:within]
    best = int(np.argmax(worth))
    likely = max(float(at[np.flatnonzero(worth >= worth[best] - _UNDECIDED)[0]]), _BIN)
    place = likely if at[best] - likely >= _NEAR else float(at[best])
    lost = np.flatnonzero(total[best + 1 :] < total[best] - _UNDECIDED)
    furthest = float(at[best + 1 + lost[0]]) if len(lost) else np.inf
    passes = at[is_pass]
    behind = passes[passes > place]
    if len(behind) and behind[0] < place + _NEAR:
        place = 0.5 * (place + float(behind[0]))
    is_seen = int(((passes > place - 0.5 * _BIN) & (passes < place + _BEYOND)).sum()) >= 3
    is_bounded = furthest - place < 2.0 * _MOST_HIDDEN
    nearest = likely if is_bounded and not is_seen else max(place, _BIN)
    return _End(nearest, max(nearest, furthest), is_seen)


def _count_followed(
    at: Float[np.ndarray, "K"],
    steps: Float[np.ndarray, "K"],
    total: Float[np.ndarray, "K"],
    stopped: Float[np.ndarray, "S"],
) -> int:
    """Return the number of rays, from the bar's middle, up to a long unseen gap or a clear stretch of air."""
    unseen = steps > _MOST_UNSEEN
    for i in np.flatnonzero(unseen):
        between = stopped[(stopped > at[i] - steps[i]) & (stopped < at[i])]
        covered = len(np.unique(np.floor(between / _BIN))) * _BIN
        unseen[i] = steps[i] > _MOST_COVERED or steps[i] - covered > _MOST_UNSEEN
    lost = unseen | (total < np.maximum.accumulate(total) - _HOPELESS)
    return max(1, int(np.argmax(lost)) if lost.any() else len(at))
