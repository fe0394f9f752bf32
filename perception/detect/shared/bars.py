"""Long straight bars of rectangular or round section, and how rays cross them.

A bar's section is a convex outline: in the section's plane a ray is a line, whose distance from the outline is the
margin of its hit or miss, and whose entry point gives the depth.
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
_LEAST_ENTRY = 1e-4
Section = Literal["box", "round"]


@dataclass(frozen=True)
class Bar:
    """Bar between two positions on its axis.

    Attributes:
        frame: (3, 3) rows: axis, direction of the width, direction of the thickness; unit.
        centre: (3,) point on the axis from which ``first`` and ``last`` count [m].
        half: half the width and half the thickness; (radius, radius) of a round bar [m].
        first, last: positions of its ends along the axis [m].
        section: shape of the outline across the axis.
    """

    frame: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    half: tuple[float, float]
    first: float
    last: float
    section: Section = "box"

    @property
    def axis(self) -> Float[np.ndarray, "3"]:
        """Unit vector (3,) along the bar."""
        return np.asarray(self.frame[0])

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """Point (3,) halfway between the ends [m]."""
        return np.asarray(self.centre + 0.5 * (self.first + self.last) * self.frame[0])

    @property
    def length(self) -> float:
        """Distance between the ends [m]."""
        return self.last - self.first

    @property
    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Corners of the bar's bounding box [m]."""
        along, across, over = np.meshgrid((self.first, self.last), (-1.0, 1.0), (-1.0, 1.0), indexing="ij")
        local = np.column_stack([along.ravel(), across.ravel() * self.half[0], over.ravel() * self.half[1]])
        return np.asarray(self.centre + local @ self.frame)

    def holds(self, points: Float[np.ndarray, "N 3"], margin: float) -> Bool[np.ndarray, "N"]:
        """Return which points are in the bar's box enlarged by ``margin`` [m]."""
        local = (points - self.middle) @ self.frame.T
        return np.asarray((np.abs(local) < np.array([0.5 * self.length, *self.half]) + margin).all(axis=1))

    def places(self, spacing: float) -> Float[np.ndarray, "K 3"]:
        """Return points on the axis from end to end, at most ``spacing`` apart [m]."""
        n = max(2, int(np.ceil(self.length / spacing)) + 1)
        return np.asarray(self.centre + np.linspace(self.first, self.last, n)[:, None] * self.frame[0])


@dataclass(frozen=True)
class BarCrossing:
    """Crossings of rays with bars of unlimited length; leading array axes are those of the bars.

    Attributes:
        outside: distance of the ray from the outline, square to ray and axis; negative when it hits [m].
        side: signed distance of the ray from the axis [m].
        depth: distance along the ray to the outline, or, when it misses, to where it is nearest to the outline [m].
        along: position of that point on the axis [m].
    """

    outside: Float[np.ndarray, "*P N"]
    side: Float[np.ndarray, "*P N"]
    depth: Float[np.ndarray, "*P N"]
    along: Float[np.ndarray, "*P N"]


def cross_bar(rays: Sightlines, bar: Bar) -> BarCrossing:
    """Return each ray's crossing with the bar, arrays (N,)."""
    crossing = cross_sections(rays, bar.frame[None], bar.centre[None], np.array([bar.half]), bar.section)
    return BarCrossing(crossing.outside[0], crossing.side[0], crossing.depth[0], crossing.along[0])


def cross_bars(rays: Sightlines, bars: Sequence[Bar]) -> BarCrossing:
    """Return the crossings of rays with B bars of one section, arrays (B, N)."""
    frames, centres = np.stack([bar.frame for bar in bars]), np.stack([bar.centre for bar in bars])
    return cross_sections(rays, frames, centres, np.array([bar.half for bar in bars]), bars[0].section)


def cross_sections(
    rays: Sightlines,
    frames: Float[np.ndarray, "P 3 3"],
    centres: Float[np.ndarray, "P 3"],
    halves: Float[np.ndarray, "P 2"],
    section: Section,
) -> BarCrossing:
    """Return the crossings of rays with P bars, given as frames, centres [m] and half sizes [m], arrays (P, N)."""
    poll()
    start = frames @ rays.start.T
    start -= frames @ centres[:, :, None]
    way = frames @ rays.direction.T
    # Sums and maxima over two components are several times as slow as on the components one by one.
    p1, p2, d1, d2 = start[:, 1], start[:, 2], way[:, 1], way[:, 2]
    speed = np.maximum(np.sqrt(d1 * d1 + d2 * d2), LEAST_SLOPE)
    n1, n2 = -d2 / speed, d1 / speed
    side = n1 * p1 + n2 * p2
    half1, half2 = halves[:, :1], halves[:, 1:]
    reach = np.broadcast_to(half1, side.shape) if section == "round" else np.abs(n1) * half1 + np.abs(n2) * half2
    outside = np.abs(side) - reach
    # A ray that misses is moved sideways onto the outline, so that depth is continuous at its edge.
    excess = np.copysign(np.maximum(outside, 0.0), side)
    n1 *= excess
    n2 *= excess
    m1, m2 = p1 - n1, p2 - n2
    if section == "round":
        inside = np.minimum(np.abs(side), reach)
        depth = -(m1 * d1 + m2 * d2) / speed**2 - np.sqrt(np.maximum(reach**2 - inside**2, 0.0)) / speed
    else:
        depth = np.maximum(_enter(m1, d1, half1), _enter(m2, d2, half2))
    return BarCrossing(outside, side, depth, start[:, 0] + depth * way[:, 0])


def _enter(
    place: Float[np.ndarray, "P N"], slope: Float[np.ndarray, "P N"], half: Float[np.ndarray, "P 1"]
) -> Float[np.ndarray, "P N"]:
    """Return the distance along each ray at which it enters the slab between ``-half`` and ``half`` [m]."""
    steep = np.copysign(np.maximum(np.abs(slope), _LEAST_ENTRY), slope)
    return np.asarray((np.copysign(half, -steep) - place) / steep)


@dataclass(frozen=True)
class SurroundingRays(Sightlines):
    """Rays about a bar.

    Attributes:
        elsewhere: (N,) whether the ray ended on another object, such as the floor.
        taken: (N,) whether the ray ended on a bar found before; None: no bar was found before.
    """

    elsewhere: Bool[np.ndarray, "N"]
    taken: Bool[np.ndarray, "N"] | None = None

    def select(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> SurroundingRays:
        """Return only the rays ``keep``, a mask or indices."""
        taken = None if self.taken is None else self.taken[keep]
        return SurroundingRays(self.start[keep], self.direction[keep], self.length[keep], self.elsewhere[keep], taken)


@dataclass(frozen=True)
class Sorted:
    """Rays sorted by outcome at each bar; a ray that ended before a bar is no evidence for or against it.

    Attributes:
        hit: the ray ended on the bar.
        passed: the ray ended behind the bar's depth, through its outline or beside it.
        before: the ray ended before the bar.
    """

    hit: Bool[np.ndarray, "*P N"]
    passed: Bool[np.ndarray, "*P N"]
    before: Bool[np.ndarray, "*P N"]


def sort_rays(rays: SurroundingRays, crossing: BarCrossing) -> Sorted:
    """Return hits, passes and rays stopped before, for bars of unlimited length.

    A ray that ended elsewhere is no hit, and just behind the bar no pass either, since a bar may touch the floor.
    A ray that ended on another bar near this one's surface counts as stopped before.
    """
    gap = rays.length - crossing.depth
    near = np.abs(gap) < NEAR_SURFACE
    before = gap <= -NEAR_SURFACE
    hit = near & (crossing.outside < _BESIDE) & ~rays.elsewhere
    if rays.taken is not None:
        hit &= ~rays.taken
        before |= near & rays.taken
    return Sorted(np.asarray(hit), np.asarray(gap >= NEAR_SURFACE), np.asarray(before))
