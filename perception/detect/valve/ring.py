"""Rim of a handwheel: a ring of elliptic section, its intersection with rays, and its fit to hits and misses.

A scanner's noise lies along its rays, so the depths of hits locate the rim along the rays, and the border between hits
and misses locates its edges.  Both enter the fit: depth residuals of hits, edge residuals of all rays.  A
Levenberg-Marquardt loop with derivatives by hand takes a tenth of the time of scipy's solver with differences.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.sightlines import Sightlines

_LEAST_SLOPE = 0.05
_PARTS, _FEWEST_ON_PART = 12, 4
_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.004
_BEHIND = 0.04
_BESIDE = 3.0
_FEWEST = 8
# Seen from the front a rim's thickness cannot be distinguished from its distance; common handwheels are 3 cm thick.
_USUAL_HALF_DEPTH = 0.015
_SIGMA_HALF_DEPTH = 0.004
# Unknowns: shift of the centre (3) [m] and tilt (2) [rad] in the wheel's basis, radius, half width, half depth [m].
_SCALE = np.array([0.005, 0.005, 0.005, 0.03, 0.03, 0.005, 0.005, 0.005])
_LARGEST_STEP = np.array([0.03, 0.03, 0.03, 0.2, 0.2, 0.03, 0.02, 0.02])
_SIZE_LIMITS = np.array([[0.03, 0.004, 0.004], [0.45, 0.06, 0.04]])
_FIRST_DAMPING = 1e-2


@dataclass(frozen=True)
class Ring:
    """Torus of elliptic section.

    Attributes:
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
    """Return rows e0, e90, axis: angles about the axis count from e0, right-handed.

    e0 is horizontal, z x axis; for a nearly vertical axis it is x projected perpendicular to the axis.
    """
    x, y, z = axis
    first = np.array([-y, x, 0.0]) if x * x + y * y > 0.01 else np.array([1.0 - x * x, -x * y, -x * z])
    a, b, c = first / np.sqrt(first @ first)
    return np.array([[a, b, c], [y * c - z * b, z * a - x * c, x * b - y * a], [x, y, z]])


@dataclass(frozen=True)
class Passage:
    """Crossing and closest approach of rays at a ring.

    Attributes:
        place: (N, 2) crossing of the ray with the ring's plane, in the wheel's basis [m].
        crossing: (N,) distance along the ray to that crossing [m].
        level: (N,) root of the section's ellipse function at its minimum on the ray; below one the ray meets the rim.
        depth: (N,) distance along the ray to the rim, or to the closest approach [m].
    """

    place: Float[np.ndarray, "N 2"]
    crossing: Float[np.ndarray, "N"]
    level: Float[np.ndarray, "N"]
    depth: Float[np.ndarray, "N"]


@dataclass(frozen=True)
class RingCrossing:
    """Intersection of rays with the ring's section at the angle where each crosses the ring's plane.

    Attributes:
        place: (N, 2) crossing of the ray with the plane, in the wheel's basis [m].
        crossing: (N,) distance along the ray to that crossing [m].
        distance: (N,) of the crossing from the axis [m].
        unit: (N, 2) unit direction from the axis to the crossing.
        sideways: (N, 2) component of the ray's direction in the plane.
        outward, along, slope: (N,) radial, tangential and axial component of the ray's direction.
        across: (N,) distance of the crossing outside the rim's centre line [m].
        alpha: (N,) curvature of the section's ellipse function on the ray [1/m^2].
        nearest: (N,) distance along the ray from the ellipse function's minimum to the crossing [m].
        level: (N,) root of that minimum.
    """

    place: Float[np.ndarray, "N 2"]
    crossing: Float[np.ndarray, "N"]
    distance: Float[np.ndarray, "N"]
    unit: Float[np.ndarray, "N 2"]
    sideways: Float[np.ndarray, "N 2"]
    outward: Float[np.ndarray, "N"]
    along: Float[np.ndarray, "N"]
    slope: Float[np.ndarray, "N"]
    across: Float[np.ndarray, "N"]
    alpha: Float[np.ndarray, "N"]
    nearest: Float[np.ndarray, "N"]
    level: Float[np.ndarray, "N"]

    def select(self, keep: Int[np.ndarray, "K"]) -> RingCrossing:
        """Return the intersections of the selected rays."""
        return RingCrossing(**{field.name: getattr(self, field.name)[keep] for field in fields(self)})


def cross_ring(rays: Sightlines, ring: Ring) -> RingCrossing:
    """Return the intersection of each ray with the ring's section at the angle where it crosses the ring's plane."""
    start, direction, slope = _in_basis(rays, ring.centre, ring.axis)
    crossing = -start[:, 2] / slope
    sideways = direction[:, :2]
    place = start[:, :2] + crossing[:, None] * sideways
    distance = np.maximum(np.hypot(place[:, 0], place[:, 1]), 1e-9)
    unit = place / distance[:, None]
    outward = (sideways * unit).sum(axis=1)
    along = sideways[:, 1] * unit[:, 0] - sideways[:, 0] * unit[:, 1]
    across = distance - ring.radius
    a, b = ring.half_width, ring.half_depth
    alpha = (outward / a) ** 2 + (slope / b) ** 2
    nearest = across * outward / (a * a * alpha)
    level = np.abs(across * slope) / (a * b * np.sqrt(alpha))
    return RingCrossing(place, crossing, distance, unit, sideways, outward, along, slope, across, alpha, nearest, level)


def cross_plane(
    rays: Sightlines, centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N"]]:
    """Return where each ray crosses a wheel's plane, in the wheel's basis, and the distance along the ray to it [m]."""
    start, direction, slope = _in_basis(rays, centre, axis)
    crossing = -start[:, 2] / slope
    return start[:, :2] + crossing[:, None] * direction[:, :2], crossing


def _in_basis(
    rays: Sightlines, centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], Float[np.ndarray, "N"]]:
    """Return starts and directions of rays in a wheel's basis, and their slopes to its plane, none of them flat."""
    basis = wheel_basis(axis)
    start, direction = (rays.start - centre) @ basis.T, rays.direction @ basis.T
    slope = direction[:, 2]
    return start, direction, np.where(np.abs(slope) < _LEAST_SLOPE, np.copysign(_LEAST_SLOPE, slope), slope)


def pass_ring(rays: Sightlines, ring: Ring) -> Passage:
    """Return the crossing and closest approach of each ray at a ring."""
    met = cross_ring(rays, ring)
    depth = met.crossing - met.nearest - np.sqrt(np.maximum(1.0 - met.level**2, 0.0) / met.alpha)
    return Passage(met.place, met.crossing, met.level, depth)


@dataclass(frozen=True)
class Gate:
    """Greatest distances from a rim at which a ray's end counts as a hit.

    Attributes:
        along: along the ray, before or behind the rim [m].
        beside: outside the rim's section [m].
    """

    along: float
    beside: float


ABOUT = Gate(0.04, 0.008)
# For a nearly correct ring: returns further off at its edges are mixed pixels of rim and background.
CLOSE = Gate(0.03, 0.004)


def rough_gate(ring: Ring) -> Gate:
    """Return the gate for a first guess of a ring, wider for larger rings."""
    return Gate(0.04 + 0.1 * ring.radius, 0.008 + 0.06 * ring.radius)


def rim_hits(rays: Sightlines, ring: Ring, passage: Passage, gate: Gate = ABOUT) -> Bool[np.ndarray, "N"]:
    """Return (N,) rays that ended on the rim: near its depth, and inside its section or just beside it."""
    beside = passage.level < 1.0 + gate.beside / ring.half_width
    return np.asarray(beside & (np.abs(rays.length - passage.depth) < gate.along))


def depth_error(rays: Sightlines, passage: Passage, hit: Bool[np.ndarray, "N"]) -> float:
    """Return the root mean square depth residual of the hits [m]; infinite without hits."""
    return float(np.sqrt(np.mean((rays.length - passage.depth)[hit] ** 2))) if hit.any() else np.inf


def axis_error(rays: Sightlines, ring: Ring, passage: Passage) -> float:
    """Return the standard deviation of the axis, from the depth residuals of the close hits [rad]."""
    close = rim_hits(rays, ring, passage, CLOSE)
    return depth_error(rays, passage, close) / ring.radius * float(np.sqrt(2.0 / max(int(close.sum()), 1)))


def unevenness(rays: Sightlines, passage: Passage, hit: Bool[np.ndarray, "N"]) -> float:
    """Return the root mean square over twelfths of the rim of their mean depth residual, beyond scatter [m].

    A true rim fits its returns all round; a ring through parts of other objects is before some and behind others.
    """
    off = (rays.length - passage.depth)[hit]
    angle = np.arctan2(passage.place[hit, 1], passage.place[hit, 0])
    part = np.floor(angle / (2.0 * np.pi) * _PARTS).astype(int) % _PARTS
    count = np.bincount(part, minlength=_PARTS)
    known = count >= _FEWEST_ON_PART
    if not known.any():
        return 0.0
    mean = np.bincount(part, off, _PARTS) / np.maximum(count, 1)
    scatter = float(((off - mean[part]) ** 2)[known[part]].sum()) / max(int((count[known] - 1).sum()), 1)
    beyond = float(np.mean(mean[known] ** 2 - scatter / count[known]))
    return float(np.sqrt(max(0.0, beyond)))


@dataclass(frozen=True)
class RingFit:
    """Effort of a ring's fit.

    Attributes:
        n_rounds: number of solves; each selects hits and misses anew.
        most_rays: used in a solve.
        most_steps: of a solve.
        still: share of the cost by which the last step of a solve may still lower it.
    """

    n_rounds: int
    most_rays: int
    most_steps: int
    still: float


ROUGH = RingFit(1, 500, 10, 2e-3)
FINE = RingFit(2, 2000, 20, 1e-4)


def fit_ring(rays: Sightlines, ring: Ring, gate: Gate, effort: RingFit) -> Ring:
    """Return the ring fitted to the rays that end on it or pass it."""
    for _ in range(effort.n_rounds):
        passage = pass_ring(rays, ring)
        hit = rim_hits(rays, ring, passage, gate)
        missed = (rays.length > passage.depth + _BEHIND) & (passage.level < _BESIDE)
        if hit.sum() < _FEWEST:
            return ring
        keep = np.flatnonzero(hit | missed)
        keep = keep[:: -(-len(keep) // effort.most_rays)]
        ring = _solve(rays.select(keep), hit[keep], move_ring(ring, np.zeros(8)), effort)
    return ring


def _solve(rays: Sightlines, hit: Bool[np.ndarray, "N"], start: Ring, effort: RingFit) -> Ring:
    """Return the ring of least robust (soft l1) cost, by Levenberg-Marquardt steps."""
    ring, trial, cost, damping = start, start, np.inf, _FIRST_DAMPING
    for _ in range(effort.most_steps):
        residuals, jacobian = linearize_ring(rays, hit, trial)
        root = np.sqrt(1.0 + residuals**2)
        now = 2.0 * float((root - 1.0).sum())
        if now < cost:
            is_still = cost - now < effort.still * cost
            ring, cost, damping = trial, now, 0.3 * damping
            if is_still:
                break
            weighted = jacobian / root
            gradient, curvature = weighted @ residuals, weighted @ jacobian.T
        else:
            damping *= 5.0
        trial = move_ring(ring, _step(ring, gradient, curvature, damping))
    return ring


def _step(
    ring: Ring, gradient: Float[np.ndarray, "8"], curvature: Float[np.ndarray, "8 8"], damping: float
) -> Float[np.ndarray, "8"]:
    """Return the damped step (8,) in :func:`move_ring`'s unknowns; sizes at a limit do not go beyond it."""
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


def move_ring(ring: Ring, x: Float[np.ndarray, "8"]) -> Ring:
    """Return the ring after a step, its sizes within their limits."""
    basis = ring.basis
    axis = ring.axis + x[3] * basis[0] + x[4] * basis[1]
    sizes = np.clip(np.array([ring.radius, ring.half_width, ring.half_depth]) + x[5:], *_SIZE_LIMITS)
    return Ring(ring.centre + x[:3] @ basis, axis / np.sqrt(axis @ axis), *(float(size) for size in sizes))


def linearize_ring(
    rays: Sightlines, hit: Bool[np.ndarray, "N"], ring: Ring
) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "8 M"]]:
    """Return residuals (depth, edge, thickness) in deviations, and derivatives by :func:`move_ring`'s unknowns."""
    poll()
    met = cross_ring(rays, ring)
    a, b = ring.half_width, ring.half_depth
    is_wrong = np.where(hit, met.level > 1.0, met.level < 1.0)
    # A ray that misses the rim as it should has no residual.
    used = np.flatnonzero(hit | is_wrong)
    n_hits, hit, is_wrong, length = int(hit.sum()), hit[used], is_wrong[used], rays.length[used]
    met = met.select(used)
    far, steep, outward, along = met.across / a, met.slope / b, met.outward / a, met.along
    # Derivatives by the ring's motion: distance from the axis, radial and axial component, crossing.
    n = len(used)
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
    # Bounded, because the derivative of the depth is infinite at the edge.
    lean = np.where(met.level < 1.0, met.level / (met.alpha * np.maximum(chord, 0.2 / np.sqrt(met.alpha))), 0.0)
    d_nearest = (outward * d_far + far * d_outward) / met.alpha - 2.0 * met.nearest * half
    d_depth = crossing - d_nearest + lean * d_level + chord * half
    outside = (met.level - 1.0) * a
    d_outside = a * d_level
    d_outside[6] += met.level - 1.0
    wrong = np.flatnonzero(is_wrong)
    edge_sign = np.where(hit[wrong], 1.0, -1.0) / _SIGMA_EDGE
    depth = met.crossing - met.nearest - chord
    # As strong as the mean depth of all hits; with a weaker prior, mixed pixels would deepen the rim.
    prior = np.sqrt(max(n_hits, 1)) / _SIGMA_HALF_DEPTH
    d_prior = np.zeros((8, 1))
    d_prior[6], d_prior[7] = -prior * (a < _USUAL_HALF_DEPTH), prior
    residuals = [
        (depth - length)[hit] / _SIGMA_DEPTH,
        edge_sign * outside[wrong],
        [prior * (b - min(_USUAL_HALF_DEPTH, a))],
    ]
    jacobian = [d_depth[:, hit] / _SIGMA_DEPTH, edge_sign * d_outside[:, wrong], d_prior]
    return np.concatenate(residuals), np.concatenate(jacobian, axis=1)
