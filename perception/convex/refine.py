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
from perception.convex.towards import Sheaf

_CELL = 0.01
_CLOSE = 2
_AROUND = 0.03
_FEW = 3
# Smaller hulls are as small as noise and skin make them, and so much seen-free space is noise [m^3].
_LEAST_VOLUME = 5e-5
_ALLOWED = Allowance(volume=2.4e-5, share=0.03, skin=SKIN)


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
    is_large = [hull_of(thickened(hull.vertices, SKIN), hull.members).volume >= _LEAST_VOLUME for hull in hulls]
    passing = _Passing.of(*rays, sum(is_large))
    done: list[Hull] = []
    for hull, is_asked in zip(hulls, is_large, strict=True):
        if not is_asked:
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
    inside = surface
    for axis in range(3):
        inside = inside[(inside[:, axis] >= lower[axis]) & (inside[:, axis] <= upper[axis])]
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
        sheaf: the same, if all start in one place and many are asked for.
    """

    starts: Float[np.ndarray, "R 3"]
    ends: Float[np.ndarray, "R 3"]
    sheaf: Sheaf | None

    @classmethod
    def of(cls, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"], n_asked: int) -> _Passing:
        """To be asked so often."""
        sheaf = Sheaf.of(starts, ends) if starts.ndim == 1 and n_asked > _FEW else None
        return cls(np.broadcast_to(starts, ends.shape), ends, sheaf)

    def near(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Int[np.ndarray, "K"]:
        """Rays that pass the ball about a box."""
        centre, radius = 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))
        asked = slice(None) if self.sheaf is None else self.sheaf.about(centre, radius)
        starts, along = self.starts[asked], self.ends[asked] - self.starts[asked]
        length = np.maximum(np.sqrt(np.einsum("ij,ij->i", along, along)), 1e-9)
        along /= length[:, None]
        ahead = np.einsum("ij,ij->i", centre - starts, along).clip(0.0, length)
        apart = starts + ahead[:, None] * along - centre
        near = np.flatnonzero(np.einsum("ij,ij->i", apart, apart) <= radius**2 + 1e-9)
        return near if isinstance(asked, slice) else asked[near]
