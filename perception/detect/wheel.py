"""A handwheel's rim as a ring of elliptic section, and its least-squares fit to rays that hit and rays that missed.

A scanner's noise lies along its rays, so where a ray ended says how far the rim is, and whether it ended there or went
on says where the rim's edges are.  Both enter the fit: depth of the hits, and the side of the edge for all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from perception.detect.sightlines import Sightlines

_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.004
_NEAR_SURFACE = 0.04
_BEHIND = 0.04
_EDGE_GATE = 0.008
_MOST_RAYS = 1200
# Seen from the front a rim's thickness cannot be told from its distance; common handwheels are 3 cm thick.
_USUAL_HALF_DEPTH = 0.015
_SIGMA_HALF_DEPTH = 0.004
_LIMITS = ((0.03, 0.45), (0.004, 0.06), (0.004, 0.04))


@dataclass(frozen=True)
class Ring:
    """A torus of elliptic section.

    Attributes:
        centre: (3,) [m].
        axis: (3,) unit, towards the sensor.
        radius: of the section's centre line [m].
        half_width: of the section along the radius [m].
        half_depth: of the section along the axis [m].
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    half_width: float
    half_depth: float

    @property
    def basis(self) -> Float[np.ndarray, "3 3"]:
        """Rows: the horizontal direction at angle 0, the direction at 90 degrees, the axis."""
        return wheel_basis(self.axis)


def wheel_basis(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows e0, e90, axis: angles about the axis count from e0, right-handed.

    e0 is horizontal, z x axis; for an upright axis it is what of x is at right angles to it.
    """
    x, y, z = axis
    first = np.array([-y, x, 0.0]) if x * x + y * y > 0.01 else np.array([1.0 - x * x, -x * y, -x * z])
    a, b, c = first / np.sqrt(first @ first)
    return np.array([[a, b, c], [y * c - z * b, z * a - x * c, x * b - y * a], [x, y, z]])


@dataclass(frozen=True)
class Passage:
    """How each ray passes a ring.

    Attributes:
        place: (N, 2) where it crosses the ring's plane, in the wheel's basis [m].
        crossing: (N,) distance along the ray to that place [m].
        level: (N,) smallest value of the section's ellipse function on the ray: below one it meets the rim.
        depth: (N,) distance along the ray to the rim, or to the closest approach [m].
    """

    place: Float[np.ndarray, "N 2"]
    crossing: Float[np.ndarray, "N"]
    level: Float[np.ndarray, "N"]
    depth: Float[np.ndarray, "N"]


def pass_ring(rays: Sightlines, ring: Ring) -> Passage:
    """Meet every ray with the section of the ring at the angle where the ray crosses its plane."""
    basis = ring.basis
    start = (rays.start - ring.centre) @ basis.T
    direction = rays.direction @ basis.T
    slope = np.where(np.abs(direction[:, 2]) < 0.05, np.copysign(0.05, direction[:, 2]), direction[:, 2])
    crossing = -start[:, 2] / slope
    place = start[:, :2] + crossing[:, None] * direction[:, :2]
    distance = np.maximum(np.linalg.norm(place, axis=1), 1e-9)
    outward = (direction[:, :2] * place).sum(axis=1) / distance
    a, b = ring.half_width, ring.half_depth
    across = distance - ring.radius
    alpha = (outward / a) ** 2 + (slope / b) ** 2
    beta = across * outward / a**2
    lowest = np.maximum((across / a) ** 2 - beta**2 / alpha, 0.0)
    depth = crossing - beta / alpha - np.sqrt(np.maximum(1.0 - lowest, 0.0) / alpha)
    return Passage(place, crossing, np.sqrt(lowest), depth)


def rim_hits(rays: Sightlines, ring: Ring, passage: Passage) -> Bool[np.ndarray, "N"]:
    """Rays that ended on the rim: near its depth, and inside its section or just beside it."""
    beside = passage.level < 1.0 + _EDGE_GATE / ring.half_width
    return np.asarray(beside & (np.abs(rays.length - passage.depth) < _NEAR_SURFACE))


def fit_ring(rays: Sightlines, ring: Ring, n_rounds: int = 3) -> Ring:
    """Refine a ring; which rays count as hits is decided anew each round."""
    for _ in range(n_rounds):
        passage = pass_ring(rays, ring)
        hit = rim_hits(rays, ring, passage)
        missed = (rays.length > passage.depth + _BEHIND) & (passage.level < 3.0)
        if hit.sum() < 8:
            return ring
        keep = np.flatnonzero(hit | missed)
        keep = keep[:: max(1, len(keep) // _MOST_RAYS)]
        chosen = rays.selected(keep)
        moved, flags = _moves_of(ring), hit[keep]
        lower = [-0.1] * 3 + [-0.6] * 2 + [limit[0] for limit in _LIMITS]
        upper = [0.1] * 3 + [0.6] * 2 + [limit[1] for limit in _LIMITS]
        start = np.clip([0.0] * 5 + [ring.radius, ring.half_width, ring.half_depth], lower, upper)
        ring = _solved(chosen, flags, moved, start, (lower, upper))
    return ring


def _solved(
    rays: Sightlines,
    hit: Bool[np.ndarray, "N"],
    moved: Callable[[Float[np.ndarray, "8"]], Ring],
    start: Float[np.ndarray, "8"],
    bounds: tuple[list[float], list[float]],
) -> Ring:
    """The ring of least robust residuals."""

    def residuals(x: Float[np.ndarray, "8"]) -> Float[np.ndarray, "M"]:
        return _residuals(rays, hit, moved(x))

    return moved(least_squares(residuals, start, bounds=bounds, loss="soft_l1", max_nfev=25).x)


def _moves_of(ring: Ring) -> Callable[[Float[np.ndarray, "8"]], Ring]:
    """The ring at x: centre shift (3), tilt (2), radius, half width, half depth."""
    basis = ring.basis

    def moved(x: Float[np.ndarray, "8"]) -> Ring:
        axis = ring.axis + x[3] * basis[0] + x[4] * basis[1]
        return Ring(ring.centre + x[:3], axis / np.linalg.norm(axis), float(x[5]), float(x[6]), float(x[7]))

    return moved


def _residuals(rays: Sightlines, hit: Bool[np.ndarray, "N"], ring: Ring) -> Float[np.ndarray, "M"]:
    """Depth of the hits, edge of hits and misses, and what is usual of a rim's thickness, in standard deviations."""
    passage = pass_ring(rays, ring)
    depth = np.where(hit, (rays.length - passage.depth) / _SIGMA_DEPTH, 0.0)
    outside = (passage.level - 1.0) * ring.half_width / _SIGMA_EDGE
    edge = np.where(hit, np.maximum(outside, 0.0), np.maximum(-outside, 0.0))
    usual = min(_USUAL_HALF_DEPTH, ring.half_width)
    # As strong as the mean depth of all hits, or it would drown in their number.
    prior = np.sqrt(max(hit.sum(), 1)) * (ring.half_depth - usual) / _SIGMA_HALF_DEPTH * 0.1
    return np.concatenate([depth, edge, [prior]])
