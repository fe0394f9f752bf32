"""Parts of a detected object that a hand may press, and the rays of the scan that met or passed each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.shared.bars import LEAST_SLOPE, Bar, cross_bar
from perception.sightlines import SightIndex

_SPREAD, _ON_SURFACE = 2.5, (0.015, 0.03)
CELL, _FACE_CELL = 0.02, 0.1
"""Length of the cells in which the rays of a bar are counted, and of a face [m]."""
_EDGE = 0.004  # beside a part, where a ray at its edge may still have met it [m]
_CORE = 0.5  # share of a bar's thickness through which no ray passes, whatever the error of its pose


@dataclass(frozen=True)
class SeenPart:
    """Rays of a scan at a part of an object, counted in cells.

    Attributes:
        name: of the part, such as ``spoke/0``.
        places: middle of each cell, in two coordinates of the part (a bar's second one is 0) [m].
        hits: number of points of the scan on each cell.
        passes: number of rays that pass through each cell and end behind it.
        within_m: distance from the part's surface, along the ray, within which a point lies on the part.
    """

    name: str
    places: tuple[tuple[float, float], ...]
    hits: tuple[int, ...]
    passes: tuple[int, ...]
    within_m: float

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> SeenPart:
        """Read the fields of a part from JSON data."""
        places = tuple((float(u), float(v)) for u, v in data["places"])
        hits, passes = (tuple(int(count) for count in data[key]) for key in ("hits", "passes"))
        if not len(places) == len(hits) == len(passes):
            raise ValueError(f"expected a count for each of {len(places)} places, got {len(hits)} and {len(passes)}")
        return SeenPart(str(data["name"]), places, hits, passes, float(data["within_m"]))

    def count_near(self, place: tuple[float, float], within: float) -> tuple[int, int]:
        """Return the numbers of points and of passing rays in the cells within a distance of a place [m]."""
        near = [k for k, (u, v) in enumerate(self.places) if np.hypot(u - place[0], v - place[1]) <= within]
        return sum(self.hits[k] for k in near), sum(self.passes[k] for k in near)


def choose_distance(noise: float) -> float:
    """Return the distance from a surface, along the ray, within which a point lies on it, given the noise [m]."""
    return float(np.clip(_SPREAD * noise, *_ON_SURFACE))


def count_on_bar(name: str, index: SightIndex, bar: Bar, within: float) -> SeenPart:
    """Count the rays that end on a bar, and those that pass through its core, by cells along it.

    Args:
        within: distance from its surface, along the ray, within which a point lies on it [m].
    """
    near = index.passing(bar.places(CELL), max(bar.half) + CELL)
    crossing, core = (
        cross_bar(near, bar),
        cross_bar(near, replace(bar, half=(_CORE * bar.half[0], _CORE * bar.half[1]))),
    )
    behind = near.length - crossing.depth
    return _count_cells(
        name,
        [(0.5 * (low + high), 0.0) for low, high in _cells(bar.first, bar.last)],
        np.floor((crossing.along - bar.first) / (bar.last - bar.first) * len(_cells(bar.first, bar.last))),
        (crossing.outside < _EDGE) & (np.abs(behind) < within),
        (core.outside < 0.0) & (behind >= within),
        within,
    )


def count_on_face(
    name: str,
    index: SightIndex,
    frame: Float[np.ndarray, "3 3"],
    corner: Float[np.ndarray, "3"],
    size: tuple[float, float],
    within: float,
) -> SeenPart:
    """Count the rays that end on a flat face, and those that pass through it, by square cells.

    Args:
        frame: (3, 3) rows: the two directions of its coordinates, and its normal; unit.
        corner: (3,) from which places count [m].
        size: along the two directions [m].
        within: distance from the face within which a point lies on it [m].
    """
    counts = [max(1, round(length / _FACE_CELL)) for length in size]
    steps = [length / count for length, count in zip(size, counts, strict=True)]
    places = [((i + 0.5) * steps[0], (j + 0.5) * steps[1]) for i in range(counts[0]) for j in range(counts[1])]
    rays = index.rays
    slope = rays.direction @ frame[2]
    faces = np.abs(slope) > LEAST_SLOPE
    crossing = ((corner - rays.start) @ frame[2]) / np.where(faces, slope, 1.0)
    at = (rays.start + crossing[:, None] * rays.direction - corner) @ frame[:2].T
    cells = np.floor(at / steps)
    is_inside = faces & (crossing > 0.0) & (cells >= 0).all(axis=1) & (cells < counts).all(axis=1)
    cell = np.where(is_inside, cells[:, 0] * counts[1] + cells[:, 1], -1.0)
    behind = (rays.length - crossing) * np.abs(slope)
    return _count_cells(name, places, cell, np.abs(behind) < within, behind >= within, within)


def _cells(first: float, last: float) -> list[tuple[float, float]]:
    """Return the borders of equal cells of about ``CELL`` between two positions [m]."""
    edges = np.linspace(first, last, max(1, round((last - first) / CELL)) + 1).tolist()
    return list(pairwise(edges))


def _count_cells(
    name: str,
    places: list[tuple[float, float]],
    cell: Float[np.ndarray, "N"],
    hit: Bool[np.ndarray, "N"],
    passed: Bool[np.ndarray, "N"],
    within: float,
) -> SeenPart:
    """Return the part, given the cell of each ray (none where it is no index of ``places``)."""
    inside = (cell >= 0) & (cell < len(places))
    counts = [np.bincount(cell[inside & these].astype(np.int64), minlength=len(places)) for these in (hit, passed)]
    hits, passes = (tuple(count.tolist()) for count in counts)
    return SeenPart(name, tuple(places), hits, passes, within)
