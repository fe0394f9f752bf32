"""A handwheel's rim as a ring of elliptic section, and how rays pass it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.sightlines import Sightlines

_LEAST_SLOPE = 0.05


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


@dataclass(frozen=True)
class Crossing:
    """How each ray runs through the ring's section at the angle where it crosses the ring's plane.

    Attributes:
        place: (N, 2) where it crosses the plane, in the wheel's basis [m].
        crossing: (N,) distance along the ray to that place [m].
        distance: (N,) of that place from the axis [m].
        unit: (N, 2) direction of that place.
        sideways: (N, 2) of the ray's direction, what lies in the plane.
        outward, along, slope: (N,) of the ray's direction, what points away from the axis, about it, and along it.
        across: (N,) how far beyond the rim's centre line it crosses the plane [m].
        alpha: (N,) curvature of the section's ellipse function on the ray [1/m^2].
        nearest: (N,) how far before the plane the ellipse function is smallest [m].
        level: (N,) the root of its smallest value.
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


def cross_ring(rays: Sightlines, ring: Ring) -> Crossing:
    """Meet every ray with the section of the ring at the angle where the ray crosses its plane."""
    basis = ring.basis
    start = (rays.start - ring.centre) @ basis.T
    direction = rays.direction @ basis.T
    slope = direction[:, 2]
    slope = np.where(np.abs(slope) < _LEAST_SLOPE, np.copysign(_LEAST_SLOPE, slope), slope)
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
    return Crossing(place, crossing, distance, unit, sideways, outward, along, slope, across, alpha, nearest, level)


def pass_ring(rays: Sightlines, ring: Ring) -> Passage:
    """Where every ray passes a ring, and how closely."""
    met = cross_ring(rays, ring)
    depth = met.crossing - met.nearest - np.sqrt(np.maximum(1.0 - met.level**2, 0.0) / met.alpha)
    return Passage(met.place, met.crossing, met.level, depth)


@dataclass(frozen=True)
class Gate:
    """How far off a rim a ray may end to count as ended on it.

    Attributes:
        along: before or behind it [m].
        beside: its section [m].
    """

    along: float
    beside: float


ABOUT = Gate(0.04, 0.008)
# Of a ring that is nearly right: what ends further off at its edges is mixed of it and what is behind.
CLOSE = Gate(0.03, 0.004)


def rough_gate(ring: Ring) -> Gate:
    """Of a ring that is but a guess: the larger it is the further off it may be."""
    return Gate(0.04 + 0.1 * ring.radius, 0.008 + 0.06 * ring.radius)


def rim_hits(rays: Sightlines, ring: Ring, passage: Passage, gate: Gate = ABOUT) -> Bool[np.ndarray, "N"]:
    """Rays that ended on the rim: near its depth, and inside its section or just beside it."""
    beside = passage.level < 1.0 + gate.beside / ring.half_width
    return np.asarray(beside & (np.abs(rays.length - passage.depth) < gate.along))
