"""Parts of a detected object that a hand may press, and the rays of the scan that met or passed each of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.shared.bars import Bar, cross_bar
from perception.sightlines import SightIndex

ON_SURFACE = 0.03
"""Distance from a part's surface, along the ray, within which a point lies on the part [m]."""
CELL = 0.02
"""Length of the cells in which the rays of a bar are counted [m]."""
_EDGE = 0.004  # beside a part, where a ray at its edge may still have met it [m]
_CORE = 0.5  # share of a bar's thickness through which no ray passes, whatever the error of its pose


@dataclass(frozen=True)
class SeenPart:
    """Rays of a scan at a part of an object, counted in cells.

    Attributes:
        name: of the part, such as ``spoke/0``.
        places: middle of each cell, in two coordinates of the part (a bar's second one is 0) [m].
        hits: number of points of the scan on each cell, within ``ON_SURFACE`` of its surface.
        passes: number of rays that pass through each cell and end behind it.
    """

    name: str
    places: tuple[tuple[float, float], ...]
    hits: tuple[int, ...]
    passes: tuple[int, ...]

    def count_near(self, place: tuple[float, float], within: float) -> tuple[int, int]:
        """Return the numbers of points and of passing rays in the cells within a distance of a place [m]."""
        near = [np.hypot(u - place[0], v - place[1]) <= within for u, v in self.places]
        pick = lambda counts: sum(count for count, is_near in zip(counts, near, strict=True) if is_near)  # noqa: E731
        return pick(self.hits), pick(self.passes)


def count_on_bar(name: str, index: SightIndex, bar: Bar) -> SeenPart:
    """Count the rays that end on a bar, and those that pass through its core, by cells along it."""
    near = index.passing(bar.places(CELL), max(bar.half) + CELL)
    crossing, core = cross_bar(near, bar), cross_bar(near, replace(bar, half=(_CORE * bar.half[0], _CORE * bar.half[1])))
    behind = near.length - crossing.depth
    return _count_cells(
        name,
        [(0.5 * (low + high), 0.0) for low, high in _cells(bar.first, bar.last)],
        np.floor((crossing.along - bar.first) / (bar.last - bar.first) * len(_cells(bar.first, bar.last))),
        (crossing.outside < _EDGE) & (np.abs(behind) < ON_SURFACE),
        (core.outside < 0.0) & (behind >= ON_SURFACE),
    )


def _cells(first: float, last: float) -> list[tuple[float, float]]:
    """Return the borders of equal cells of about ``CELL`` between two positions [m]."""
    edges = np.linspace(first, last, max(1, round((last - first) / CELL)) + 1).tolist()
    return list(zip(edges[:-1], edges[1:], strict=True))


def _count_cells(
    name: str,
    places: list[tuple[float, float]],
    cell: Float[np.ndarray, "N"],
    hit: Bool[np.ndarray, "N"],
    passed: Bool[np.ndarray, "N"],
) -> SeenPart:
    """Return the part, given the cell of each ray (none where it is no index of ``places``)."""
    inside = (cell >= 0) & (cell < len(places))
    counts = [np.bincount(cell[inside & these].astype(np.int64), minlength=len(places)) for these in (hit, passed)]
    return SeenPart(name, tuple(places), *(tuple(count.tolist()) for count in counts))
