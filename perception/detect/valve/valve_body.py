"""Body of a valve on a pipe: where along the pipe its surface stands out from the pipe's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.shared.bar_search import rays_about
from perception.detect.shared.bar_starts import Run
from perception.detect.shared.bars import Bar, SurroundingRays, cross_bar
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex

_BIN, _AROUND = 0.02, 0.16  # bins along the pipe, and their extent beyond the lever's ends [m]
_FRONT = 0.8  # of the pipe's radius: rays nearer to its axis show the height of its surface
_BESIDE, _OUT, _LEAST_OUT = 0.004, 0.3, 0.012  # rays past the pipe that a body stops: [m], in radii, [m]
_BULGE, _LEAST_BULGE = 0.3, 0.006  # usual height of a body over its pipe, in radii and at least [m]
_SIGMA, _MOST_NEAR = 0.013, 0.1  # of the heights of single returns; greatest distance from the pipe's surface [m]
_MOST_IN_BIN = 4.0  # of the evidence that one kind of ray gives in one bin
_PRIOR = 1.0  # logarithm of the odds against a body in a bin before any ray
_ASIDE, _ABOVE = 0.008, 0.015  # about the lever: returns there are the lever's own [m]
_TOO_HIGH = 0.02  # over a lever's upper side [m]


@dataclass(frozen=True)
class ValveBody:
    """Stretch of a pipe where its surface stands out.

    Attributes:
        first, last: its ends along the pipe's axis, from the pipe's centre [m].
        evidence: logarithm of the odds of a body to the bare pipe there.
    """

    first: float
    last: float
    evidence: float

    @property
    def middle(self) -> float:
        """Position of its middle along the pipe's axis [m]."""
        return 0.5 * (self.first + self.last)


def find_body(
    pipe: Bar, lever: Bar, up: Float[np.ndarray, "3"], index: SightIndex, floor: FloorPlane | None
) -> ValveBody | None:
    """Return the body on the pipe below a lever; None where rays show the bare pipe, or nothing.

    The body is the run of bins along the pipe with the greatest evidence (Bentley, Programming Pearls, CACM 1984).  A
    bin's evidence is that of the rays that end before or behind the pipe's surface, and of those that just miss the
    pipe: a body stops them.

    Args:
        pipe: fitted to its surface beside the body.
        up: (3,) unit, from the pipe to the lever.
    """
    ends = (lever.places(lever.length) - pipe.centre) @ pipe.axis
    low, high = float(ends.min()) - _AROUND, float(ends.max()) + _AROUND
    rays = rays_about(index, Run(pipe.centre, pipe.axis, low, high), 0.0, floor)
    if not len(rays):
        return None
    n_bins = round((high - low) / _BIN)
    evidence = _weigh_bins(rays, pipe, lever, up, low, n_bins)
    best, first, last = 0.0, 0, 0
    total, start = 0.0, 0
    for k, value in enumerate(evidence.tolist()):
        if total <= 0.0:
            total, start = 0.0, k
        total += value
        if total > best:
            best, first, last = total, start, k + 1
    return ValveBody(low + first * _BIN, low + last * _BIN, best) if best > 0.0 else None


def _weigh_bins(
    rays: SurroundingRays, pipe: Bar, lever: Bar, up: Float[np.ndarray, "3"], low: float, n_bins: int
) -> Float[np.ndarray, "K"]:
    """Return (K,) logarithms of the odds of a body to the bare pipe in each bin along the pipe."""
    radius = pipe.half[0]
    crossing = cross_bar(rays, pipe)
    gap = rays.length - crossing.depth
    offset = rays.ends - pipe.centre
    height = np.linalg.norm(offset - (offset @ pipe.axis)[:, None] * pipe.axis, axis=1) - radius
    mine = ~_on_lever(rays, lever, up) & ~rays.elsewhere
    of_bin = np.floor((crossing.along - low) / _BIN).astype(np.int64)
    mine &= (of_bin >= 0) & (of_bin < n_bins)
    front = mine & (np.abs(crossing.side) < _FRONT * radius) & (np.abs(gap) < _MOST_NEAR)
    bulge = max(_BULGE * radius, _LEAST_BULGE)
    heights = _sum_up(front, of_bin, bulge * (height - 0.5 * bulge) / _SIGMA**2, n_bins)
    beside = mine & (crossing.outside > _BESIDE) & (crossing.outside < max(_OUT * radius, _LEAST_OUT))
    stopped, free = beside & (np.abs(gap) < radius + 0.03), beside & (gap >= radius + 0.03)
    edges = _sum_up(stopped | free, of_bin, np.where(stopped, 1.0, -1.0), n_bins)
    return np.asarray(heights + edges - _PRIOR)


def _sum_up(
    chosen: Bool[np.ndarray, "N"], of_bin: Int[np.ndarray, "N"], weight: Float[np.ndarray, "N"], n_bins: int
) -> Float[np.ndarray, "K"]:
    """Return (K,) sums of weights in each bin, limited, since rays in a bin share the pipe's error."""
    total = np.bincount(of_bin[chosen], weight[chosen], n_bins)
    return np.clip(total, -_MOST_IN_BIN, _MOST_IN_BIN)


def _on_lever(rays: SurroundingRays, lever: Bar, up: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "N"]:
    """Return which rays ended on the lever, or so high over the pipe that they cannot be of a body."""
    crossing = cross_bar(rays, lever)
    within = (crossing.along > lever.first - _ASIDE) & (crossing.along < lever.last + _ASIDE)
    over = (rays.ends - lever.middle) @ up
    return np.asarray(
        (within & (crossing.outside < _ASIDE) & (over > -_ABOVE - lever.half[0])) | (over > lever.half[0] + _TOO_HIGH)
    )
