"""What rays say of a fitted tube's end: how solid its wall is, whether it is open, how much air is about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.hose.tube import NEAR_WALL, STRAIGHT, Tube, meet_tubes, square_to
from perception.sightlines import Sightlines

_INSIDE = 0.004
_CORE = 0.7
_DEEPER = 0.025
_AIR = (0.01, 0.045)
_STOPPED = 0.02
_STRAY = 0.025
_AHEAD = 0.03
_N_SECTORS = 12


@dataclass(frozen=True)
class Evidence:
    """What speaks for a tube's end.

    Attributes:
        n_hits: rays that ended on its wall, outside or inside.
        solid: share of them among the rays that should.
        open: share of rays at the middle of the mouth that went on behind it; NaN when there are none.
        n_open: how many rays that rests on.
        round: share of the directions about the axis in which its wall was seen: more rays ended on it than passed.
        entering: share of the rays that go into the mouth among those that meet the end.
        stopped: share of the rays that go into the mouth which ended before they could have met a tube's inside.
        stray: share of what ended about the end that lies off the wall.
        air: share of the directions in which rays just beside its end went on behind it, of those known.
        known: share of the directions of which that is known.
        rms: of the depths of its hits [m].
        points: (K, 3) where they ended [m].
    """

    n_hits: int
    solid: float
    open: float
    n_open: int
    round: float
    entering: float
    stopped: float
    stray: float
    air: float
    known: float
    rms: float
    points: Float[np.ndarray, "K 3"]


def weigh_tube(rays: Sightlines, tube: Tube) -> Evidence:
    """Count rays on, into and beside the end."""
    met = meet_tubes(rays, [tube])
    on, into, through = met.on[0], met.into[0], met.through[0]
    gap = rays.length - met.depth[0]
    arrives = gap > -NEAR_WALL
    straight = met.along[0] > -STRAIGHT
    should = (on | (into & ~through)) & arrives & straight
    hits = should & (gap < NEAR_WALL)
    clear = should & (met.outside[0] < -_INSIDE)
    core = into & (met.across[0] < _CORE * tube.radius) & (rays.length > met.plane[0] - NEAR_WALL)
    deeper = rays.length > met.plane[0] + _DEEPER
    inward = into & (rays.length > met.plane[0] - NEAR_WALL)
    beside = ~on & ~into & (met.outside[0] > _AIR[0]) & (met.outside[0] < _AIR[1]) & straight & arrives
    sector = _sectors(rays, tube, met.depth[0])
    free, full = (np.bincount(sector[beside & one], minlength=_N_SECTORS) for one in (gap > NEAR_WALL, gap < NEAR_WALL))
    known = free + full > 0
    there, missing = (np.bincount(sector[one], minlength=_N_SECTORS) for one in (hits, clear & ~hits))
    return Evidence(
        int(hits.sum()),
        float(hits[clear].mean()) if clear.any() else 0.0,
        float(deeper[core].mean()) if core.any() else float("nan"),
        int(core.sum()),
        float((there > missing).mean()),
        float(inward.sum() / max(1, (inward | should).sum())),
        float((gap < -_STOPPED)[inward].mean()) if inward.any() else 1.0,
        _stray_share(rays, tube),
        float((free > full)[known].mean()) if known.any() else 0.0,
        float(known.mean()),
        float(np.sqrt(np.mean(gap[hits] ** 2))) if hits.any() else float("inf"),
        rays.ends[hits],
    )


def _stray_share(rays: Sightlines, tube: Tube) -> float:
    """Of the rays that ended beside the axis, how many ended neither near the wall nor deep inside."""
    offset = rays.ends - tube.mouth
    along = offset @ tube.axis
    across = np.linalg.norm(offset - along[:, None] * tube.axis, axis=1)
    about = (along > -STRAIGHT) & (along < _AHEAD) & (across < tube.radius + _AHEAD)
    return float((np.abs(across - tube.radius) > _STRAY)[about].mean()) if about.any() else 1.0


def _sectors(rays: Sightlines, tube: Tube, depth: Float[np.ndarray, "N"]) -> np.ndarray:
    """In which direction about the axis each ray is at a depth along it."""
    across, over = square_to(tube.axis)
    offset = rays.start + depth[:, None] * rays.direction - tube.mouth
    angle = np.arctan2(offset @ over, offset @ across) / (2.0 * np.pi) % 1.0
    return np.asarray((angle * _N_SECTORS).astype(np.int64) % _N_SECTORS)
