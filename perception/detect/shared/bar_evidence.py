"""Evidence of rays for a fitted bar: where it ends, how solid it is, how much air is beside it."""

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
# How far off a face's plane a ray's end may lie, and how much further for each unit of the slope it met it at [m].
_OFF, _OFF_BY_SLOPE = 0.01, 0.02
_REACH = 0.6
_SHARE, _ALONG = 0.5, 0.35


@dataclass(frozen=True)
class Ends:
    """The places where a bar begins and ends.

    Attributes:
        bar: with these ends.
        seen: for the first and the last, whether rays went on just beyond it.
    """

    bar: Bar
    seen: tuple[bool, bool]


def find_ends(rays: SurroundingRays, bar: Bar) -> Ends:
    """Follow the bar from where it is surest to where rays inside its outline go on behind it."""
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

    Where something lies over the bar it is followed further than where nothing is known, but what is found behind a
    long gap has to be long itself.
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
        n_hits: rays that ended on it.
        solid: share of hits among the rays inside its outline that were not stopped before.
        visible: share of its length where rays ended on it.
        air: on the worse long side, share of the length known there where rays just beside the bar went on behind it,
            and did not end on a surface that runs on from one of its faces.
        known: on the worse side, share of the length where rays say so or otherwise.
        rms: of the depths of its hits [m].
        hits: which rays ended on it.
    """

    n_hits: int
    solid: float
    visible: float
    air: float
    known: float
    rms: float
    hits: Bool[np.ndarray, "N"]


def weigh_bar(rays: SurroundingRays, bar: Bar) -> BarEvidence:
    """Count hits, passes and air about a fitted bar."""
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
    """Return which rays ended beside a bar, level with one of its faces that is seen; a round bar has none."""
    if bar.section == "round" or not len(rays):
        return np.zeros(len(rays), dtype=bool)
    half, frame = np.array(bar.half), bar.frame[1:]
    seen = np.sign((rays.start.mean(axis=0) - bar.centre) @ frame.T)
    across = (rays.ends - bar.centre) @ frame.T
    # Noise lies along the rays: those that graze a face end close to its plane, or on something else behind it.
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
    """Return the parts of a bar's side where most rays beside it met a surface level with its face.

    What looks like a board there is the rim of a panel, or the narrow side of a slab; where air comes first, few rays
    met it or it is along little of the bar, what is level with the face is another thing.

    Args:
        level: which of the rays ended level with a face.
        free: which of the others went on.
        outside: how far each passes the bar [m].
        part: of the bar's length that each passes.
    """
    n_level, n_free = (np.bincount(part[those], minlength=n_parts) for those in (level, free))
    of_level, of_free = (np.bincount(part[those], outside[those], n_parts) for those in (level, free))
    is_nearer = (n_free == 0) | (of_level * n_free <= of_free * n_level)
    larger = (n_level > 0) & (n_level >= _SHARE * (n_level + n_free)) & is_nearer
    # In a heap something or other is level with a face here and there.
    return np.asarray(larger & (larger.sum() >= _ALONG * ((n_level + n_free) > 0).sum()))
