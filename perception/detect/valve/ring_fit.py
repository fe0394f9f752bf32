"""Least-squares fit of a wheel's rim to rays that hit and rays that missed.

A scanner's noise lies along its rays, so where a ray ended says how far the rim is, and whether it ended there or went
on says where the rim's edges are.  Both enter the fit: depth of the hits, and the side of the edge for all.  A
Levenberg-Marquardt loop with derivatives by hand takes a tenth of the time of scipy's solver with differences.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from costs.stopping import poll
from perception.detect.valve.ring import Gate, Ring, cross_ring, pass_ring, rim_hits
from perception.sightlines import Sightlines

_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.004
_BEHIND = 0.04
_BESIDE = 3.0
_FEWEST = 8
_MOST_RAYS = 1200
# Seen from the front a rim's thickness cannot be told from its distance; common handwheels are 3 cm thick.
_USUAL_HALF_DEPTH = 0.015
_SIGMA_HALF_DEPTH = 0.004
# Unknowns: shift of the centre (3) [m] and tilt (2) [rad] in the wheel's basis, radius, half width, half depth [m].
_SCALE = np.array([0.005, 0.005, 0.005, 0.03, 0.03, 0.005, 0.005, 0.005])
_LARGEST_STEP = np.array([0.03, 0.03, 0.03, 0.2, 0.2, 0.03, 0.02, 0.02])
_SIZE_LIMITS = np.array([[0.03, 0.004, 0.004], [0.45, 0.06, 0.04]])
_STEPS = 20
_FIRST_DAMPING = 1e-2
_STILL = 1e-4


def fit_ring(rays: Sightlines, ring: Ring, gate: Gate, n_rounds: int) -> Ring:
    """Refine a ring; which rays count as hits is decided anew each round."""
    for _ in range(n_rounds):
        passage = pass_ring(rays, ring)
        hit = rim_hits(rays, ring, passage, gate)
        missed = (rays.length > passage.depth + _BEHIND) & (passage.level < _BESIDE)
        if hit.sum() < _FEWEST:
            return ring
        keep = np.flatnonzero(hit | missed)
        keep = keep[:: max(1, len(keep) // _MOST_RAYS)]
        ring = _solved(rays.selected(keep), hit[keep], moved_ring(ring, np.zeros(8)))
    return ring


def _solved(rays: Sightlines, hit: Bool[np.ndarray, "N"], start: Ring) -> Ring:
    """The ring of least robust (soft l1) squared residuals."""
    ring, trial, cost, damping = start, start, np.inf, _FIRST_DAMPING
    for _ in range(_STEPS):
        residuals, jacobian = linearized(rays, hit, trial)
        root = np.sqrt(1.0 + residuals**2)
        now = 2.0 * float((root - 1.0).sum())
        if now < cost:
            is_still = cost - now < _STILL * cost
            ring, cost, damping = trial, now, 0.3 * damping
            if is_still:
                break
            weighted = jacobian / root
            gradient, curvature = weighted @ residuals, weighted @ jacobian.T
        else:
            damping *= 5.0
        trial = moved_ring(ring, _step(ring, gradient, curvature, damping))
    return ring


def _step(
    ring: Ring, gradient: Float[np.ndarray, "8"], curvature: Float[np.ndarray, "8 8"], damping: float
) -> Float[np.ndarray, "8"]:
    """Sizes at their limits that would go beyond stay where they are."""
    sizes = np.array([ring.radius, ring.half_width, ring.half_depth])
    low, high = sizes <= _SIZE_LIMITS[0], sizes >= _SIZE_LIMITS[1]
    free = np.ones(8, dtype=bool)
    free[5:] = ~((low & (gradient[5:] > 0.0)) | (high & (gradient[5:] < 0.0)))
    scale = _SCALE[free]
    scaled = curvature[np.ix_(free, free)] * scale[:, None] * scale
    scaled[np.diag_indices(len(scale))] += damping * max(float(scaled.diagonal().max()), 1e-9)
    step = np.zeros(8)
    step[free] = -np.linalg.solve(scaled, gradient[free] * scale) * scale
    return np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)


def moved_ring(ring: Ring, x: Float[np.ndarray, "8"]) -> Ring:
    """The ring after a step, its sizes within their limits."""
    basis = ring.basis
    axis = ring.axis + x[3] * basis[0] + x[4] * basis[1]
    sizes = np.clip(np.array([ring.radius, ring.half_width, ring.half_depth]) + x[5:], *_SIZE_LIMITS)
    return Ring(ring.centre + x[:3] @ basis, axis / np.sqrt(axis @ axis), *(float(size) for size in sizes))


def linearized(
    rays: Sightlines, hit: Bool[np.ndarray, "N"], ring: Ring
) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "8 M"]]:
    """Residuals in standard deviations and their derivatives by the unknowns of :func:`moved_ring`: depth of the hits,
    edge of hits and misses on the wrong side of it, and what is usual of a rim's thickness."""
    poll()
    met = cross_ring(rays, ring)
    a, b = ring.half_width, ring.half_depth
    far, steep, outward, along = met.across / a, met.slope / b, met.outward / a, met.along
    # How the ray meets the ring when this moves: distance from the axis, outward and axial speed, crossing.
    n = len(rays)
    distance, speed, slope, crossing = (np.zeros((8, n)) for _ in range(4))
    unit, lag = met.unit, along / met.distance
    for i, side in ((0, unit[:, 1]), (1, -unit[:, 0])):
        distance[i], speed[i] = -unit[:, i], lag * side
    crossing[2] = 1.0 / met.slope
    crossing[3:5] = -met.place.T / met.slope
    distance[2:5] = met.outward * crossing[2:5]
    speed[2:5] = along * lag * crossing[2:5]
    speed[3:5] -= met.slope * unit.T
    slope[3:5] = met.sideways.T
    distance[5] = -1.0
    d_far, d_outward, d_steep = distance / a, speed / a, slope / b
    d_far[6], d_outward[6], d_steep[7] = -far / a, -outward / a, -steep / b
    d_alpha = 2.0 * (outward * d_outward + steep * d_steep)
    half = 0.5 / met.alpha * d_alpha
    d_level = np.sign(far * steep) * (steep * d_far + far * d_steep) / np.sqrt(met.alpha) - met.level * half
    chord = np.sqrt(np.maximum(1.0 - met.level**2, 0.0) / met.alpha)
    # At the very edge the depth changes without bound.
    lean = np.where(met.level < 1.0, met.level / (met.alpha * np.maximum(chord, 0.2 / np.sqrt(met.alpha))), 0.0)
    d_nearest = (outward * d_far + far * d_outward) / met.alpha - 2.0 * met.nearest * half
    d_depth = crossing - d_nearest + lean * d_level + chord * half
    outside = (met.level - 1.0) * a
    d_outside = a * d_level
    d_outside[6] += met.level - 1.0
    wrong = np.flatnonzero(np.where(hit, outside > 0.0, outside < 0.0))
    edge_sign = np.where(hit[wrong], 1.0, -1.0) / _SIGMA_EDGE
    depth = met.crossing - met.nearest - chord
    # As strong as the mean depth of all hits, or it would drown in their number and mixed pixels would deepen the rim.
    prior = np.sqrt(max(int(hit.sum()), 1)) / _SIGMA_HALF_DEPTH
    d_prior = np.zeros((8, 1))
    d_prior[6], d_prior[7] = -prior * (a < _USUAL_HALF_DEPTH), prior
    residuals = [
        (depth - rays.length)[hit] / _SIGMA_DEPTH,
        edge_sign * outside[wrong],
        [prior * (b - min(_USUAL_HALF_DEPTH, a))],
    ]
    jacobian = [d_depth[:, hit] / _SIGMA_DEPTH, edge_sign * d_outside[:, wrong], d_prior]
    return np.concatenate(residuals), np.concatenate(jacobian, axis=1)
