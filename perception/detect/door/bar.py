"""Straight round bar before a face, fitted to the ends of all rays towards it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from costs.stopping import poll

_SOFT = 0.002  # [m] within which a ray at a bar's edge may hit or pass it
_STRAY = 0.12  # share of rays past the bar that end on its neck, posts or rose
_WILD = 0.02
_PER_LENGTH = 50.0  # cost of a bar's length, so that it ends where no ray shows it [1/m]
_FAR = 0.15
_RADII = (0.005, 0.032)
_OUTS = (0.015, 0.1)
_MOST_RAYS = 3000
_SCALE = 0.004
_MOST_STEPS = 400
EXTENSIONS = np.arange(-0.012, 0.061, 0.003)
"""(E,) lengths by which an end of a bar may have to be moved out [m]."""
_LONGER = ((0.035, 0.0), (0.0, 0.035))  # at the first and second end [m]
_MOST_ROUNDS = 5
_GAIN = 2.0


@dataclass(frozen=True)
class NearRays:
    """K rays towards the surroundings of a handle, in the coordinates of its face: along, up and out of it.

    Attributes:
        direction: (K, 3) unit.
        length: (K,) [m].
        sigma: standard deviation of the ends [m].
    """

    start: Float[np.ndarray, "K 3"]
    direction: Float[np.ndarray, "K 3"]
    length: Float[np.ndarray, "K"]
    sigma: float

    @staticmethod
    def of(start: Float[np.ndarray, "K 3"], end: Float[np.ndarray, "K 3"], sigma: float) -> NearRays:
        """Make rays from their starts and ends; of many, every k-th is used."""
        step = -(-len(start) // _MOST_RAYS) or 1
        way = (end - start)[::step]
        length = np.linalg.norm(way, axis=1)
        return NearRays(start[::step], way / np.maximum(length, 1e-9)[:, None], length, sigma)

    @property
    def out(self) -> Float[np.ndarray, "K"]:
        """(K,) distance of the rays' ends out of the face [m]."""
        return np.asarray(self.start[:, 2] + self.length * self.direction[:, 2])


@dataclass(frozen=True)
class Bar:
    """A round bar with spherical ends, parallel to a face.

    Attributes:
        ends: (2, 2) centres of its end spheres along the face and up [m].
        out: distance of its centre line from the face [m].
        cost: negative log likelihood per ray, relative to the bare face.
    """

    ends: Float[np.ndarray, "2 2"]
    out: float
    radius: float
    cost: float

    @property
    def middle(self) -> Float[np.ndarray, "2"]:
        """(2,) centre along the face and up [m]."""
        return np.asarray(0.5 * (self.ends[0] + self.ends[1]))

    @property
    def axis(self) -> Float[np.ndarray, "2"]:
        """(2,) unit, from its first to its second end; along the face where both coincide."""
        way = self.ends[1] - self.ends[0]
        length = float(np.linalg.norm(way))
        return way / length if length > 1e-6 else np.array([1.0, 0.0])

    @property
    def length(self) -> float:
        """Distance between its tips [m]."""
        return self.axis_length + 2.0 * self.radius

    @property
    def tilt(self) -> float:
        """Angle between its axis and the horizontal, 0 to pi/2 [rad]."""
        return float(np.arctan2(abs(self.axis[1]), abs(self.axis[0])))

    @property
    def axis_length(self) -> float:
        """Distance between the centres of its end spheres [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def reached_by(self, rays: NearRays) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
        """Return (K,) distance of each ray outside the bar's surface, negative inside, and (K,) length to it [m]."""
        return _reach(rays, np.append(self.ends[0], self.out), np.append(self.ends[1], self.out), self.radius)


def _reach(
    rays: NearRays, first: Float[np.ndarray, "3"], last: Float[np.ndarray, "3"], radius: float
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Return (K,) distance of each ray outside a capsule's surface, and (K,) length of the ray to it [m]."""
    way = last - first
    to_first = first - rays.start
    along_ray = np.einsum("ki,ki->k", rays.direction, to_first)  # a sum over rows of three takes twice as long
    slope = rays.direction @ way
    square = float(way @ way)
    # Closest points of ray and segment (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).
    below = np.maximum(square - slope**2, 1e-12)
    share = np.clip((slope * along_ray - to_first @ way) / below, 0.0, 1.0)
    length = along_ray + share * slope
    gap = to_first + share[:, None] * way - length[:, None] * rays.direction
    apart = np.sqrt(np.einsum("ki,ki->k", gap, gap))
    steep = np.sqrt(np.clip(1.0 - slope**2 / max(square, 1e-12), 0.05, 1.0))
    depth = np.sqrt(np.maximum(radius**2 - np.minimum(apart, radius) ** 2, 0.0)) / steep
    return apart - radius, length - depth


def fit_bar(rays: NearRays, start: Bar) -> Bar:
    """Return the likeliest bar, searched from ``start`` and from longer ones, since noise may split a bar in two."""
    best = _search(rays, start)
    for _ in range(_MOST_ROUNDS):
        longer = []
        for low, high in _LONGER:
            ends = best.ends + best.axis * np.array([[-low], [high]])
            longer.append(_search(rays, replace(best, ends=ends)))
        better = min(longer, key=lambda bar: bar.cost)
        if better.cost > best.cost - _GAIN / len(rays.length):
            break
        best = better
    return best if best.axis[0] >= 0.0 else replace(best, ends=best.ends[::-1])


def fit_ball(rays: NearRays, start: Bar) -> Bar:
    """Return the likeliest bar without length, searched from the middle of ``start``."""
    return _search(rays, replace(start, ends=np.stack([start.middle, start.middle])), is_ball=True)


def _search(rays: NearRays, start: Bar, *, is_ball: bool = False) -> Bar:
    """Return the bar of greatest likelihood near ``start``, by simplex search; of a ball both ends move alike."""
    bare = _bare(rays)
    on_face = _face(rays, -rays.start[:, 2] / rays.direction[:, 2])
    n_rays = max(len(bare), 1)
    n_shifts = 4 if is_ball else 6

    def cost(shift: Float[np.ndarray, "S"]) -> float:
        poll()
        bar, beyond = _shifted(start, shift)
        return float((np.sum(_misfits(rays, bar, on_face) - bare) + _PER_LENGTH * bar.length) / n_rays + beyond)

    found = minimize(
        cost,
        np.zeros(n_shifts),
        method="Nelder-Mead",
        options={
            "initial_simplex": np.concatenate([np.zeros((1, n_shifts)), np.eye(n_shifts)]),
            "maxfev": _MOST_STEPS,
            "xatol": 0.02,
            "fatol": 1e-5,
        },
    )
    bar, _ = _shifted(start, found.x)
    return Bar(bar.ends, bar.out, bar.radius, float(found.fun))


def _shifted(start: Bar, shift: Float[np.ndarray, "S"]) -> tuple[Bar, float]:
    """Return the bar after a step in units of ``_SCALE``, and how far its standoff and radius exceed their limits.

    Args:
        shift: of both ends, or of both alike, then of standoff and radius.
    """
    out, radius = start.out + _SCALE * shift[-2], start.radius + 0.5 * _SCALE * shift[-1]
    within = float(np.clip(out, *_OUTS)), float(np.clip(radius, *_RADII))
    beyond = 100.0 * (abs(out - within[0]) + abs(radius - within[1]))
    return Bar(start.ends + _SCALE * shift[:-2].reshape(-1, 2), *within, 0.0), beyond


def _bare(rays: NearRays) -> Float[np.ndarray, "K"]:
    """Return the misfits of the bare face."""
    to_face = -rays.start[:, 2] / rays.direction[:, 2]
    return np.asarray(-np.log((1.0 - _WILD) * _face(rays, to_face) + _WILD / _FAR))


def _misfits(
    rays: NearRays,
    bar: Bar,
    on_face: Float[np.ndarray, "K"],
    neck: tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]] | None = None,
) -> Float[np.ndarray, "K"]:
    """Return the negative log likelihood of each ray's end.

    Args:
        on_face: likelihood of each ray on the bare face, see :func:`_face` [1/m].
        neck: distance of each ray outside the bar's neck, and its length to it.
    """
    past = on_face
    for outside, length in (bar.reached_by(rays),) if neck is None else (neck, bar.reached_by(rays)):
        hits = 1.0 / (1.0 + np.exp(np.clip(outside / (0.5 * _SOFT), -30.0, 30.0)))
        past = hits * _normal(rays.length - length, rays.sigma) + (1.0 - hits) * past
    return np.asarray(-np.log((1.0 - _WILD) * past + _WILD / _FAR))


def _face(rays: NearRays, to_face: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Return the likelihood of rays that end on the face, or somewhere before it on a neck or rose [1/m]."""
    off = rays.length - to_face
    before = (off < 0.0) & (off > -_FAR)
    return np.asarray((1.0 - _STRAY) * _normal(off, rays.sigma) + _STRAY * before / _FAR)


def _normal(off: Float[np.ndarray, "K"], sigma: float) -> Float[np.ndarray, "K"]:
    return np.asarray(np.exp(-0.5 * (off / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma))


def rate_extensions(rays: NearRays, bar: Bar) -> Float[np.ndarray, "2 E"]:
    """Return (2, E) log likelihoods of the bar with its first or its second end moved out by ``EXTENSIONS``.

    The moved end is the one at the spindle: a neck of the bar's radius joins it with the face.
    """
    on_face = _face(rays, -rays.start[:, 2] / rays.direction[:, 2])
    rated = np.empty((2, len(EXTENSIONS)))
    for end, outwards in enumerate((-1.0, 1.0)):
        for i, extension in enumerate(EXTENSIONS):
            ends = bar.ends.copy()
            ends[end] += outwards * extension * bar.axis
            neck = _reach(rays, np.append(ends[end], 0.0), np.append(ends[end], bar.out), bar.radius)
            rated[end, i] = -float(np.sum(_misfits(rays, replace(bar, ends=ends), on_face, neck)))
    return rated


def expect_extension(rated: Float[np.ndarray, "E"], prior: Float[np.ndarray, "E"]) -> tuple[float, float]:
    """Return mean and standard deviation of an extension from its log likelihoods and the log of its prior [m]."""
    weight = np.exp(rated + prior - np.max(rated + prior))
    weight /= weight.sum()
    mean = float(weight @ EXTENSIONS)
    return mean, float(np.sqrt(weight @ (EXTENSIONS - mean) ** 2))
