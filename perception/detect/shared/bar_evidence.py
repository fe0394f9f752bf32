"""Evidence of rays for a fitted bar: its ends, share of hits, and air beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.shared.bars import Bar, SurroundingRays, cross_bar, sort_rays
from perception.sightlines import Sightlines

_BIN = 0.02
_MOST_UNSEEN = 12
_MOST_COVERED = 30
_MOST_OPEN = 2
_FOLLOWED = 4
_INSIDE = 0.003
_BEYOND = 0.08
_AIR = (0.008, 0.045)
_COARSE_BIN = 0.04
# Largest distance of a ray's end from a face's plane, and its increase per cosine between ray and normal [m].
_OFF, _OFF_BY_SLOPE = 0.01, 0.02
_REACH = 0.6
_SHARE, _ALONG = 0.5, 0.35


@dataclass(frozen=True)
class Ends:
    """Ends of a bar.

    Attributes:
        bar: cut at these ends.
        seen: for the first and the last end, whether rays passed just beyond it.
    """

    bar: Bar
    seen: tuple[bool, bool]


def find_ends(rays: SurroundingRays, bar: Bar) -> Ends:
    """Return the ends where, from the bar's middle outwards, rays inside its outline stop hitting and pass."""
    crossing = cross_bar(rays, bar)
    outcome = sort_rays(rays, crossing)
    inside = crossing.outside < -_INSIDE
    hits, passes, stopped = (crossing.along[inside & those] for those in (outcome.hit, outcome.passed, outcome.before))
    if len(hits) < 3:
        return Ends(bar, (False, False))
    middle = 0.5 * (bar.first + bar.last)
    last, last_seen = _end(hits - middle, passes - middle, stopped - middle, 0.5 * bar.length)
    first, first_seen = _end(middle - hits, middle - passes, middle - stopped, 0.5 * bar.length)
    return Ends(replace(bar, first=middle - first, last=middle + last), (first_seen, last_seen))


def _end(
    hits: Float[np.ndarray, "K"], passes: Float[np.ndarray, "M"], stopped: Float[np.ndarray, "S"], fallback: float
) -> tuple[float, bool]:
    """Return where hits end in the positive direction, and whether passes follow there.

    A gap covered by another object may be longer than one without rays, but the hits beyond a long gap must be long
    too.
    """
    hits, passes = hits[hits > -_BIN], passes[passes > -_BIN]
    if not len(hits):
        return max(fallback * 0.5, _BIN), False
    n_bins = int(max(hits.max(), passes.max() if len(passes) else 0.0) / _BIN) + 2
    h = np.bincount((hits.clip(0.0) / _BIN).astype(np.int64), minlength=n_bins)
    p = np.bincount((passes.clip(0.0) / _BIN).astype(np.int64), minlength=n_bins)
    covered = np.bincount(
        (stopped[(stopped > 0.0) & (stopped < n_bins * _BIN)] / _BIN).astype(np.int64), minlength=n_bins
    )
    reached, gap, unseen, fresh, open_bins = 0, 0, 0, 0, 0
    for k in range(n_bins):
        if h[k] > p[k]:
            fresh, open_bins = fresh + 1, 0
            if gap <= _MOST_UNSEEN or _FOLLOWED * fresh >= gap:
                reached, gap, unseen, fresh = k + 1, 0, 0, 0
        elif p[k]:
            open_bins += 1
        else:
            gap += 1
            unseen += not covered[k]
        if open_bins >= _MOST_OPEN or unseen > _MOST_UNSEEN or gap > _MOST_COVERED:
            break
    edge = reached * _BIN
    near_hits, near_passes = (x[np.abs(x - edge) < 3 * _BIN] for x in (hits, passes))
    places = np.sort(np.concatenate([near_hits, near_passes]))
    if len(places):
        wrong = (near_hits[None] > places[:, None]).sum(axis=1) + (near_passes[None] < places[:, None]).sum(axis=1)
        i = int(np.argmin(wrong))
        # The edge lies between the last ray that hit and the first that passed.
        behind = near_passes[near_passes > places[i]]
        edge = float(0.5 * (places[i] + behind.min())) if len(behind) else float(places[i])
    seen = int(((passes > edge - 0.5 * _BIN) & (passes < edge + _BEYOND)).sum()) >= 3
    return max(edge, _BIN), seen


@dataclass(frozen=True)
class BarEvidence:
    """Evidence for a bar.

    Attributes:
        n_hits: number of rays that ended on it.
        solid: share of hits among the rays inside its outline that reach it.
        visible: share of its length with hits.
        air: share of the known length where rays just beside the bar pass it and do not end on a surface that
            continues one of its faces; of the long side with less.
        known: share of the length with any rays just beside the bar; of the long side with less.
        rms: of its hits' depth residuals [m].
        hits: (N,) which rays ended on it.
    """

    n_hits: int
    solid: float
    visible: float
    air: float
    known: float
    rms: float
    hits: Bool[np.ndarray, "N"]


def weigh_bar(rays: SurroundingRays, bar: Bar) -> BarEvidence:
    """Return the evidence for a fitted bar: shares of hits, visible length and air beside it."""
    crossing = cross_bar(rays, bar)
    outcome = sort_rays(rays, crossing)
    between = (crossing.along > bar.first) & (crossing.along < bar.last)
    inside = between & (crossing.outside < -_INSIDE)
    n_hits, n_passed = int((inside & outcome.hit).sum()), int((inside & outcome.passed).sum())
    n_bins = max(1, round(bar.length / _COARSE_BIN))
    of_bin = ((crossing.along - bar.first) / bar.length * n_bins).clip(0, n_bins - 1).astype(np.int64)
    visible = float((np.bincount(of_bin[inside & outcome.hit], minlength=n_bins) > 0).mean())
    beside = between & (crossing.outside > _AIR[0]) & (crossing.outside < _AIR[1])
    gap = rays.length - crossing.depth
    through = outcome.passed | (rays.elsewhere & ~outcome.before)
    level = outcome.passed & in_line(bar, rays) & ~rays.elsewhere
    if rays.taken is not None:
        level &= ~rays.taken
    airs, knowns = [], []
    for sign in (-1.0, 1.0):
        there = beside & (np.sign(crossing.side) == sign)
        free = np.bincount(of_bin[there & through], minlength=n_bins)
        full = np.bincount(of_bin[there & ~through & ~outcome.before], minlength=n_bins)
        known = (free + full) > 0
        is_larger = runs_on(level[there], (through & ~level)[there], crossing.outside[there], of_bin[there], n_bins)
        airs.append(float(((free > full) & ~is_larger)[known].mean()) if known.any() else 0.0)
        knowns.append(float(known.mean()))
    hits = between & outcome.hit
    rms = float(np.sqrt(np.mean(gap[hits] ** 2))) if hits.any() else np.inf
    return BarEvidence(n_hits, n_hits / max(1, n_hits + n_passed), visible, min(airs), min(knowns), rms, hits)


def in_line(bar: Bar, rays: Sightlines) -> Bool[np.ndarray, "N"]:
    """Return which rays ended beside a bar in the plane of one of its visible faces; none for a round bar."""
    if bar.section == "round" or not len(rays):
        return np.zeros(len(rays), dtype=bool)
    half, frame = np.array(bar.half), bar.frame[1:]
    seen = np.sign((rays.start.mean(axis=0) - bar.centre) @ frame.T)
    across = (rays.ends - bar.centre) @ frame.T
    # Noise is along the ray, so a grazing ray that hits the face ends close to its plane.
    level = np.abs(across * seen - half) < _OFF + _OFF_BY_SLOPE * np.abs(rays.direction @ frame.T)
    beside = (np.abs(across) > half) & (np.abs(across) < half + _REACH)
    return np.asarray((level & beside[:, ::-1]).any(axis=1))


def runs_on(
    level: Bool[np.ndarray, "K"],
    free: Bool[np.ndarray, "K"],
    outside: Float[np.ndarray, "K"],
    part: Int[np.ndarray, "K"],
    n_parts: int,
) -> Bool[np.ndarray, "P"]:
    """Return (P,) parts of a bar's side where most rays beside it ended on a surface in the plane of its face.

    Such a bar is the rim of a panel or the narrow side of a slab.  The surface is another object where air separates
    it from the bar, few rays met it or it accompanies little of the bar.

    Args:
        level: which rays ended in the plane of a face.
        free: which of the others passed.
        outside: distance of each ray from the bar's outline [m].
        part: index of the part of the bar's length that each ray passes.
    """
    n_level, n_free = (np.bincount(part[those], minlength=n_parts) for those in (level, free))
    of_level, of_free = (np.bincount(part[those], outside[those], n_parts) for those in (level, free))
    is_nearer = (n_free == 0) | (of_level * n_free <= of_free * n_level)
    larger = (n_level > 0) & (n_level >= _SHARE * (n_level + n_free)) & is_nearer
    # In a heap some points are in the plane of a face by chance.
    return np.asarray(larger & (larger.sum() >= _ALONG * ((n_level + n_free) > 0).sum()))
