"""Long straight bars of rectangular or round section, and how rays cross them.

Across its axis a bar is a convex outline: in the plane of its section a ray is a line whose distance from the outline
says by how much it hits or misses, and whose entry says how deep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.sightlines import Sightlines

SIGMA_DEPTH = 0.01
SIGMA_EDGE = 0.004
NEAR_SURFACE = 0.035
_BESIDE = 0.012
LEAST_SLOPE = 0.05
Section = Literal["box", "round"]


@dataclass(frozen=True)
class Bar:
    """A bar between two places of its axis.

    Attributes:
        frame: (3, 3) rows: axis, direction of the width, direction of the thickness; unit.
        centre: (3,) a place on the axis from which ``first`` and ``last`` count [m].
        half: half the width and half the thickness; twice the radius of a round one [m].
        first, last: where it begins and ends along the axis [m].
        section: outline across the axis.
    """

    frame: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    half: tuple[float, float]
    first: float
    last: float
    section: Section = "box"

    @property
    def axis(self) -> Float[np.ndarray, "3"]:
        """(3,) unit."""
        return np.asarray(self.frame[0])

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """(3,) halfway between the ends [m]."""
        return np.asarray(self.centre + 0.5 * (self.first + self.last) * self.frame[0])

    @property
    def length(self) -> float:
        """[m]."""
        return self.last - self.first

    @property
    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Corners of the box about it [m]."""
        along, across, over = np.meshgrid((self.first, self.last), (-1.0, 1.0), (-1.0, 1.0), indexing="ij")
        local = np.column_stack([along.ravel(), across.ravel() * self.half[0], over.ravel() * self.half[1]])
        return np.asarray(self.centre + local @ self.frame)

    def holds(self, points: Float[np.ndarray, "N 3"], margin: float) -> Bool[np.ndarray, "N"]:
        """Return points in it or within ``margin`` [m] of it."""
        local = (points - self.middle) @ self.frame.T
        return np.asarray((np.abs(local) < np.array([0.5 * self.length, *self.half]) + margin).all(axis=1))

    def places(self, spacing: float) -> Float[np.ndarray, "K 3"]:
        """Return places along the axis, at most ``spacing`` apart [m]."""
        n = max(2, int(np.ceil(self.length / spacing)) + 1)
        return np.asarray(self.centre + np.linspace(self.first, self.last, n)[:, None] * self.frame[0])


@dataclass(frozen=True)
class BarCrossing:
    """Crossings of rays with bars of unlimited length; leading axes as those of the bars.

    Attributes:
        outside: distance of the ray from the outline, across both; negative when it hits [m].
        side: distance of the ray from the axis, signed [m].
        depth: along the ray to the outline, or to its nearest corner [m].
        along: where on the axis that is [m].
    """

    outside: Float[np.ndarray, "*P N"]
    side: Float[np.ndarray, "*P N"]
    depth: Float[np.ndarray, "*P N"]
    along: Float[np.ndarray, "*P N"]


def cross_bar(rays: Sightlines, bar: Bar) -> BarCrossing:
    """Return how each ray crosses the bar."""
    crossing = cross_sections(rays, bar.frame[None], bar.centre[None], np.array([bar.half]), bar.section)
    return BarCrossing(crossing.outside[0], crossing.side[0], crossing.depth[0], crossing.along[0])


def cross_bars(rays: Sightlines, bars: Sequence[Bar]) -> BarCrossing:
    """Return all bars of one section at once."""
    frames, centres = np.stack([bar.frame for bar in bars]), np.stack([bar.centre for bar in bars])
    return cross_sections(rays, frames, centres, np.array([bar.half for bar in bars]), bars[0].section)


def cross_sections(
    rays: Sightlines,
    frames: Float[np.ndarray, "P 3 3"],
    centres: Float[np.ndarray, "P 3"],
    halves: Float[np.ndarray, "P 2"],
    section: Section,
) -> BarCrossing:
    """Return all bars of one section at once, given as frames, centres [m] and half sizes [m]."""
    poll()
    start = frames @ rays.start.T - frames @ centres[:, :, None]
    way = frames @ rays.direction.T
    p, d = start[:, 1:], way[:, 1:]
    speed = np.maximum(np.hypot(d[:, 0], d[:, 1]), LEAST_SLOPE)
    n = np.stack([-d[:, 1], d[:, 0]], axis=1) / speed[:, None]
    side = (n * p).sum(axis=1)
    if section == "round":
        reach = np.broadcast_to(halves[:, :1], side.shape)
    else:
        reach = np.abs(n[:, 0]) * halves[:, :1] + np.abs(n[:, 1]) * halves[:, 1:]
    outside = np.abs(side) - reach
    # A ray that misses is moved to the outline's edge, so that depths do not jump there.
    moved = p - n * (np.sign(side) * np.maximum(outside, 0.0))[:, None]
    if section == "round":
        inside = np.minimum(np.abs(side), reach)
        depth = -(moved * d).sum(axis=1) / speed**2 - np.sqrt(np.maximum(reach**2 - inside**2, 0.0)) / speed
    else:
        slope = np.where(np.abs(d) < 1e-4, np.copysign(1e-4, d), d)
        depth = ((-np.sign(slope) * halves[:, :, None] - moved) / slope).max(axis=1)
    return BarCrossing(outside, side, depth, start[:, 0] + depth * way[:, 0])


@dataclass(frozen=True)
class SurroundingRays(Sightlines):
    """Rays about a bar.

    Attributes:
        elsewhere: (N,) whether it ended on something that is not the bar, as the floor.
        taken: (N,) whether it ended on a bar found before; None: there is no such bar.
    """

    elsewhere: Bool[np.ndarray, "N"]
    taken: Bool[np.ndarray, "N"] | None = None

    def select(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> SurroundingRays:
        """Keep only these."""
        taken = None if self.taken is None else self.taken[keep]
        return SurroundingRays(self.start[keep], self.direction[keep], self.length[keep], self.elsewhere[keep], taken)


@dataclass(frozen=True)
class Sorted:
    """Rays sorted by what each tells of each bar; a ray that ended before a bar tells nothing of it.

    Attributes:
        hit: it ended on the bar.
        passed: it went on behind where the bar is or would be beside it.
        before: it ended before the bar.
    """

    hit: Bool[np.ndarray, "*P N"]
    passed: Bool[np.ndarray, "*P N"]
    before: Bool[np.ndarray, "*P N"]


def sort_rays(rays: SurroundingRays, crossing: BarCrossing) -> Sorted:
    """Return hits, passes and rays stopped before, whatever the bars' ends.

    What ended elsewhere is no hit; just behind a bar it is no pass either, for what lies on the floor touches it.
    What ended on another bar near this one's surface may have been stopped by it before.
    """
    gap = rays.length - crossing.depth
    near = np.abs(gap) < NEAR_SURFACE
    before = gap <= -NEAR_SURFACE
    hit = near & (crossing.outside < _BESIDE) & ~rays.elsewhere
    if rays.taken is not None:
        hit &= ~rays.taken
        before |= near & rays.taken
    return Sorted(np.asarray(hit), np.asarray(gap >= NEAR_SURFACE), np.asarray(before))
