"""Unbroken parts of a floor level, and their convex outlines, cut where rays went through."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from perception.cleaning.clean import voxel_index
from perception.convex.freespace import FreeSpace
from perception.convex.planes import Plane
from perception.convex.slabs import make_slabs
from perception.ground.extent import pierced_cells
from perception.ground.floor import FloorPlane

_PART_CELL, _MARGIN = 0.05, 3
_NEAR, _OFF, _OVER = 0.025, 0.04, 0.15  # [m]
_LEAST_INNER = 0.02  # [m^2]
_LEAST_SHARE = 0.85
_CELL = 0.1
_FINE = 0.06
_THIN = 0.015
_AROUND = np.ones((3, 3), dtype=bool)
# Scan lines are about 10 cm apart where the floor is seen at a grazing angle.
_CLOSING = 2
_NARROWEST = 0.08
_NOTHING = FreeSpace(np.zeros(3), 1.0, np.zeros((1, 1, 1), dtype=bool))


def is_unbroken(
    points: Float[np.ndarray, "N 3"], own: Float[np.ndarray, "K 3"], plane: FloorPlane
) -> Bool[np.ndarray, "K"]:
    """Return which points of a level belong to wide parts with few other points just below or above them.

    Beams in a heap have some upper faces at the same height, but points show lower surfaces between them and higher
    ones across them.  The outermost 5 cm are ignored because of risers.

    Args:
        own: (K, 3) points of the level [m].
    """
    lower = np.floor(own[:, :2].min(axis=0) / _PART_CELL).astype(int) - _MARGIN
    shape = np.floor(own[:, :2].max(axis=0) / _PART_CELL).astype(int) - lower + _MARGIN + 1

    def count(places: Float[np.ndarray, "M 3"]) -> np.ndarray:
        cells = np.floor(places[:, :2] / _PART_CELL).astype(int) - lower
        cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
        return np.bincount(cells @ [shape[1], 1], minlength=shape.prod()).reshape(shape)

    above = plane.above(points)
    n_off = count(points[(above < -_OFF) | ((above > _OFF) & (above < _OVER))])
    n_on = count(points[np.abs(above) < _NEAR])
    # Gaps between scan lines are closed, but not cells in which most points are off the level.
    closed = ndimage.binary_closing(count(own) > 0, structure=_AROUND, iterations=2) & (n_on >= n_off)
    label, n_parts = ndimage.label(ndimage.binary_erosion(closed, structure=_AROUND), structure=_AROUND)
    size, on, off = (
        np.bincount(label.ravel(), weights=weights, minlength=n_parts + 1)
        for weights in (np.ones(label.size), n_on.ravel(), n_off.ravel())
    )
    wide = (size * _PART_CELL**2 > _LEAST_INNER) & (on > _LEAST_SHARE * (on + off))
    wide[0] = False
    with_border = ndimage.binary_dilation(wide[label], structure=_AROUND, iterations=3)
    return np.asarray(with_border[tuple((np.floor(own[:, :2] / _PART_CELL).astype(int) - lower).T)])


def outlines_of(
    level: FloorPlane,
    points: Float[np.ndarray, "N 3"],
    core: Float[np.ndarray, "C 2"],
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]],
) -> tuple[Float[np.ndarray, "K 2"], ...]:
    """Return corners (counter-clockwise) of convex outlines that cover the points and no opening, largest first [m].

    The lowest boards of two shelves may form one level, but rays went through between them.  Gaps of about
    10 cm are covered, wider ones are not.

    Args:
        points: (N, 3) near the level [m].
        core: (C, 2) positions that certainly belong to the level; parts not connected to them are left out [m].
    """
    points = points[np.unique(voxel_index(points, _THIN)[0], return_index=True)[1]]
    places = points[:, :2]
    lower, upper = places.min(axis=0) - _CELL, places.max(axis=0) + _CELL
    extent = 0.5 * float((upper - lower).max())
    holes = pierced_cells(level.normal, level.offset, rays, places, 0.5 * (lower + upper), extent)
    outlines = []
    for part in _parts(places, core, holes):
        plane = Plane(level.normal, level.offset, part, part[:0])
        beyond = _wide_gaps(places[part])
        beyond_flat = np.column_stack([beyond, level.height(beyond)]) @ plane.basis.T
        for slab in make_slabs(plane, points, *rays, _NOTHING, gaps=beyond_flat):
            if _width(slab.outline) >= _NARROWEST:
                corners = slab.outline @ plane.basis[:, :2] + plane.offset * plane.normal[:2]
                outlines.append((slab.area, corners))
    outlines.sort(key=lambda item: -item[0])
    return tuple(corners for _, corners in outlines)


def _parts(
    places: Float[np.ndarray, "N 2"], core: Float[np.ndarray, "C 2"], holes: Float[np.ndarray, "H 2"]
) -> list[Int[np.ndarray, "L"]]:
    """Return the indices of each part connected to the core; gaps between scan lines connect, holes do not."""
    lower, shape = _grid(places, _CELL)
    seen = _picture(places, lower, shape, _CELL)
    joined = _close(seen) & ~_picture(holes, lower, shape, _CELL)
    label, n_parts = ndimage.label(joined | seen, structure=_AROUND)
    of_place = label[tuple(np.floor((places - lower) / _CELL).astype(int).T)]
    is_kept = np.zeros(n_parts + 1, dtype=bool)
    is_kept[label[_picture(core, lower, shape, _CELL)]] = True
    return [np.flatnonzero(of_place == part) for part in np.flatnonzero(is_kept) if part > 0]


def _wide_gaps(places: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "G 2"]:
    """Return centres of 6 cm cells farther from the positions than gaps between scan lines are wide [m]."""
    lower, shape = _grid(places, _FINE)
    closed = _close(_picture(places, lower, shape, _FINE))
    return np.asarray((np.argwhere(~ndimage.binary_dilation(closed, structure=_AROUND)) + 0.5) * _FINE + lower)


def _grid(places: Float[np.ndarray, "N 2"], cell: float) -> tuple[Float[np.ndarray, "2"], Int[np.ndarray, "2"]]:
    """Return lower corner [m] and shape of a grid, with a margin for closing gaps at its border."""
    lower = places.min(axis=0) - (_CLOSING + 0.5) * cell
    return lower, np.ceil((places.max(axis=0) - lower) / cell).astype(int) + _CLOSING + 1


def _close(seen: Bool[np.ndarray, "U V"]) -> Bool[np.ndarray, "U V"]:
    return np.asarray(ndimage.binary_closing(seen, structure=_AROUND, iterations=_CLOSING))


def _picture(
    xy: Float[np.ndarray, "N 2"], lower: Float[np.ndarray, "2"], shape: Int[np.ndarray, "2"], cell: float
) -> Bool[np.ndarray, "U V"]:
    picture = np.zeros(shape, dtype=bool)
    cells = np.floor((xy - lower) / cell).astype(int)
    picture[tuple(cells[((cells >= 0) & (cells < shape)).all(axis=1)].T)] = True
    return picture


def _width(outline: Float[np.ndarray, "K 2"]) -> float:
    """Return the least width of a convex outline [m]."""
    sides = np.roll(outline, -1, axis=0) - outline
    across = np.column_stack([-sides[:, 1], sides[:, 0]]) / np.maximum(np.linalg.norm(sides, axis=1), 1e-9)[:, None]
    return float(np.ptp(outline @ across.T, axis=0).min())
