"""Shape of a cordless drill: crossings of rays with it, and the notches that distinguish it from a block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import poll
from perception.sightlines import Sightlines

# Usual half sizes of the battery's foot, and radii of body and grip [m].
FOOT = (0.06, 0.035, 0.0275)
BODY_RADIUS = 0.031
_NOSE_RADIUS = 0.02
_NOSE_SHARE = 0.34
GRIP_RADIUS = 0.021
# Least length of a ray inside a notch, least extra depth compared with a block, and depth that excludes a block [m].
_LEAST_INSIDE, _LEAST_DEEPER, _DEEP = 0.03, 0.055, 0.06


@dataclass(frozen=True)
class DrillShape:
    """Position and sizes of a drill.

    Attributes:
        x, y: position of the grip on its support [m].
        yaw: direction of the chuck about z [rad].
        grip: length of the grip [m].
        body: length of the body with its chuck [m].
        back: length of the body behind the grip's axis [m].
    """

    x: float
    y: float
    yaw: float
    grip: float = 0.125
    body: float = 0.2
    back: float = 0.07

    @classmethod
    def of(cls, values: Float[np.ndarray, "6"]) -> DrillShape:
        """Return a drill from six values in the order of the attributes."""
        x, y, yaw, grip, body, back = values.tolist()
        return cls(x, y, yaw, grip, body, back)

    @property
    def values(self) -> Float[np.ndarray, "6"]:
        """All six values, in the order of the attributes."""
        return np.array([self.x, self.y, self.yaw, self.grip, self.body, self.back])


@dataclass(frozen=True)
class Solids:
    """Parts of a drill as capsules: all points within a radius of a segment.

    Attributes:
        first, last: (S, 3) ends of the segments, in the drill's frame on its support [m].
    """

    first: Float[np.ndarray, "S 3"]
    last: Float[np.ndarray, "S 3"]
    radius: Float[np.ndarray, "S"]


def solids_of(shape: DrillShape) -> Solids:
    """Return capsules: body, nose, grip and two for the battery's foot."""
    foot = 2.0 * FOOT[2]
    top = foot + shape.grip + 0.03
    front, nose = shape.body - shape.back, _NOSE_SHARE * shape.body
    r, low = FOOT[2], FOOT[2]
    across = FOOT[1] - r
    parts = [
        ((-shape.back + BODY_RADIUS, 0.0, top), (front - nose - 0.5 * BODY_RADIUS, 0.0, top), BODY_RADIUS),
        ((front - nose, 0.0, top), (front - _NOSE_RADIUS, 0.0, top), _NOSE_RADIUS),
        ((0.0, 0.0, foot), (0.0, 0.0, top), GRIP_RADIUS),
        ((-0.05 + r, -across, low), (0.07 - r, -across, low), r),
        ((-0.05 + r, across, low), (0.07 - r, across, low), r),
    ]
    first, last, radius = (np.array(column) for column in zip(*parts, strict=True))
    return Solids(first, last, radius)


def meet(rays: Sightlines, shape: DrillShape, level: float) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return each ray's distance from the drill, negative for a hit, and depth at the part hit or nearest [m]."""
    poll()
    rotation = about_up(-shape.yaw)
    start = (rays.start - (shape.x, shape.y, level)) @ rotation.T
    way = rays.direction @ rotation.T
    solids = solids_of(shape)
    apart, along = _rays_to_segments(start, way, solids.first, solids.last)
    radius = solids.radius[:, None]
    beyond = apart - radius
    enters = along - np.sqrt(np.maximum(radius**2 - np.minimum(apart, radius) ** 2, 0.0))
    # The first part that a ray hits counts, or the nearest part if it misses all.
    outside, is_hit = beyond.min(axis=0), beyond < 0.0
    nearest = np.take_along_axis(enters, beyond.argmin(axis=0)[None], axis=0)[0]
    first = np.where(is_hit, enters, np.inf).min(axis=0)
    return outside, np.where(outside < 0.0, first, nearest)


def about_up(angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation matrix about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _rays_to_segments(
    start: Float[np.ndarray, "N 3"],
    way: Float[np.ndarray, "N 3"],
    first: Float[np.ndarray, "S 3"],
    last: Float[np.ndarray, "S 3"],
) -> tuple[Float[np.ndarray, "S N"], Float[np.ndarray, "S N"]]:
    """Return each ray's distance from each segment, and the depth along the ray of its nearest point [m]."""
    poll()
    side = last - first
    a, b = side @ way.T, (side**2).sum(axis=1)[:, None]
    c = (way * start).sum(axis=1) - first @ way.T
    d = side @ start.T - (side * first).sum(axis=1)[:, None]
    share = np.clip((d - a * c) / np.maximum(b - a**2, 1e-9), 0.0, 1.0)
    along = share * a - c
    square = np.zeros_like(along)
    for i in range(3):
        offset = start[:, i] - first[:, i, None] + along * way[:, i] - share * side[:, i, None]
        square += offset * offset
    return np.sqrt(square), along


def notch_open(rays: Sightlines, shape: DrillShape, level: float) -> tuple[float, int]:
    """Return the share of rays into the notches that pass where a block would stop them, and the rays' number.

    The notches are between chuck and foot, before and behind the grip.  Rays from the side pass through them, rays
    from ahead and behind end on the grip or the foot.
    """
    rotation = about_up(-shape.yaw)
    start = (rays.start - (shape.x, shape.y, level)) @ rotation.T
    way = rays.direction @ rotation.T
    way = np.where(np.abs(way) < 1e-9, 1e-9, way)
    outside, depth = meet(rays, shape, level)
    stop = np.where(outside < 0.0, depth, np.inf)
    foot = 2.0 * FOOT[2]
    beside, half, low, high = GRIP_RADIUS + 0.015, GRIP_RADIUS, foot + 0.015, foot + shape.grip + 0.018 - BODY_RADIUS
    spans = ((beside, shape.body - shape.back - 0.01), (0.01 - shape.back, -beside))
    n_open = n_seen = 0
    for first, last in spans:
        sides = [(np.array(corner) - start) / way for corner in ((first, -half, low), (last, half, high))]
        enters, leaves = np.minimum(*sides).max(axis=1), np.maximum(*sides).min(axis=1)
        goes = stop - enters
        tells = (np.minimum(leaves, stop) - enters > _LEAST_INSIDE) & (goes > _LEAST_DEEPER)
        tells &= rays.length > enters - _LEAST_INSIDE
        n_open += int((rays.length > enters + np.minimum(0.75 * goes, _DEEP))[tells].sum())
        n_seen += int(tells.sum())
    return n_open / max(n_seen, 1), n_seen
