"""Hulls held against the rays once more, in finer cells, and split where these went through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from perception.convex.freespace import FreeSpace, carve
from perception.convex.hulls import SKIN, Hull, hull_of, thickened
from perception.convex.split import Allowance, is_free_of, merge, split

_CELL = 0.01
_CLOSE = 2
_AROUND = 0.03
# Smaller hulls are as small as noise and skin make them, and so much seen-free space is noise [m^3].
_LEAST_VOLUME = 5e-5
_ALLOWED = Allowance(volume=1.2e-5, share=0.02, skin=SKIN)


def refined(
    hulls: Sequence[Hull],
    points: Float[np.ndarray, "N 3"],
    surface: Float[np.ndarray, "M 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    gap: float,
) -> list[Hull]:
    """The hulls, those that with a skin hold seen-free space more than 2 cm from any point split until they do not.

    The points of a single scan line round a corner span no volume, but with a skin their hull is a sheet through the
    air before them.

    Args:
        hulls: of some of the points.
        points: (N, 3) that their members index [m].
        surface: (M, 3) all points that surfaces stand for [m].
        rays: starts, (3,) or (R, 3), and ends (R, 3) of all rays [m].
        gap: parts whose boxes are farther apart are not joined again [m].
    """
    passing = _Passing.of(np.broadcast_to(rays[0], rays[1].shape), rays[1])
    done: list[Hull] = []
    for hull in hulls:
        if hull_of(thickened(hull.vertices, SKIN), hull.members).volume < _LEAST_VOLUME:
            done.append(hull)
            continue
        lower = _CELL * np.floor((hull.lower - _AROUND) / _CELL)
        fine = _seen_free(passing, surface, lower, hull.upper + _AROUND)
        if is_free_of(hull, fine, _ALLOWED):
            done.append(hull)
        else:
            done += merge(split(points, hull.members, fine, _ALLOWED), fine, gap, _ALLOWED)
    return done


def _seen_free(
    passing: _Passing, surface: Float[np.ndarray, "M 3"], lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> FreeSpace:
    """Cells in a box that rays passed, more than about 2 cm from any surface."""
    near = passing.near(lower, upper)
    inside = surface[((surface >= lower) & (surface <= upper)).all(axis=1)]
    free = carve(passing.starts[near], passing.ends[near], inside, lower, upper, _CELL)
    held = np.zeros(free.free.shape, dtype=bool)
    cells = np.floor((inside - lower) / free.size).astype(int)
    held[tuple(cells[(cells < held.shape).all(axis=1)].T)] = True
    return FreeSpace(free.lower, free.size, free.free & ~ndimage.binary_dilation(held, iterations=_CLOSE))


@dataclass(frozen=True)
class _Passing:
    """Rays, to be asked which pass a place.

    Attributes:
        starts, ends: (R, 3) [m].
        along: (R, 3) unit.
        length: (R,) [m].
        offset: (R,) ``starts . along``.
        squared: (R,) ``|starts|^2``.
    """

    starts: Float[np.ndarray, "R 3"]
    ends: Float[np.ndarray, "R 3"]
    along: Float[np.ndarray, "R 3"]
    length: Float[np.ndarray, "R"]
    offset: Float[np.ndarray, "R"]
    squared: Float[np.ndarray, "R"]

    @classmethod
    def of(cls, starts: Float[np.ndarray, "R 3"], ends: Float[np.ndarray, "R 3"]) -> _Passing:
        along = ends - starts
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
        along /= length[:, None]
        offset, squared = np.einsum("ij,ij->i", starts, along), np.einsum("ij,ij->i", starts, starts)
        return cls(starts, ends, along, length, offset, squared)

    def near(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Int[np.ndarray, "K"]:
        """Rays that pass the ball about a box."""
        centre = 0.5 * (lower + upper)
        ahead = self.along @ centre - self.offset
        t = ahead.clip(0.0, self.length)
        distance = self.squared - 2.0 * (self.starts @ centre) + centre @ centre + t * (t - 2.0 * ahead)
        return np.flatnonzero(distance <= 0.25 * float(((upper - lower) ** 2).sum()) + 1e-9)
