"""Where the rays of a scanner's grid went that met nothing, by those beside them that did."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

# A grid is believed when nearly all of its rays that met something are where it has them.
_NEARLY_ALL = 95.0
_LARGEST_MISFIT = np.radians(1.0)
_FEWEST_POINTS = 10
_FEWEST_LINES = 5


def missed_directions(
    points: Float[np.ndarray, "N 3"], cells: Int[np.ndarray, "N"], missed: Int[np.ndarray, "K"], shape: tuple[int, int]
) -> Float[np.ndarray, "M 3"]:
    """Directions of cells without a return, where the grid tells them.

    A column has one azimuth and a row one elevation; both are taken from the cells of that column or row that met
    something, or follow from those of the columns and rows beside it.  Files differ in whether cells are listed column
    by column or row by row: the order is the one that explains the points, and without one nothing is told.

    Args:
        points: (N, 3) in the scanner's own frame, none at zero.
        cells: (N,) their places in the list of cells.
        missed: (K,) places of the cells that met nothing.
        shape: columns and rows of the grid.

    Returns:
        (M, 3) unit vectors, M <= K.
    """
    if len(points) < _FEWEST_POINTS or not len(missed):
        return np.zeros((0, 3))
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    n_columns, n_rows = shape
    orders = [
        _Grid(rays, cells // n_rows, cells % n_rows, shape),
        _Grid(rays, cells % n_columns, cells // n_columns, shape),
    ]
    best = min(orders, key=lambda grid: grid.misfit)
    if best.misfit > min(best.spacing, _LARGEST_MISFIT):
        return np.zeros((0, 3))
    if best is orders[0]:
        directions = best.directions(missed // n_rows, missed % n_rows)
    else:
        directions = best.directions(missed % n_columns, missed // n_columns)
    return np.asarray(directions[np.isfinite(directions).all(axis=1)])


class _Grid:
    """The azimuth of each column and the elevation of each row that explain rays best [rad].

    Attributes:
        misfit: angle within which nearly all rays are where the grid has them [rad].
        spacing: angle between neighbours, the wider of both ways [rad].
    """

    def __init__(
        self,
        rays: Float[np.ndarray, "N 3"],
        columns: Int[np.ndarray, "N"],
        rows: Int[np.ndarray, "N"],
        shape: tuple[int, int],
    ) -> None:
        sums = [np.bincount(columns, rays[:, axis], shape[0]) for axis in (0, 1)]
        is_column = np.bincount(columns, minlength=shape[0]) > 0
        self._azimuth = _between(np.unwrap(np.arctan2(sums[1], sums[0])[is_column]), is_column)
        n_in_row = np.bincount(rows, minlength=shape[1])
        elevations = np.bincount(rows, np.arcsin(np.clip(rays[:, 2], -1.0, 1.0)), shape[1])
        self._elevation = _between((elevations / np.maximum(n_in_row, 1))[n_in_row > 0], n_in_row > 0)
        off = np.linalg.norm(self.directions(columns, rows) - rays, axis=1)
        self.misfit = float(np.percentile(off, _NEARLY_ALL))
        self.spacing = max(_step(self._azimuth), _step(self._elevation))

    def directions(self, columns: Int[np.ndarray, "K"], rows: Int[np.ndarray, "K"]) -> Float[np.ndarray, "K 3"]:
        """Unit vectors; NaN where the columns and rows that met something do not tell."""
        azimuth, elevation = self._azimuth[columns], self._elevation[rows]
        flat = np.where(np.abs(elevation) <= 0.5 * np.pi, np.cos(elevation), np.nan)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)


def _between(known: Float[np.ndarray, "K"], is_known: Bool[np.ndarray, "L"]) -> Float[np.ndarray, "L"]:
    """A value for each line: its own, or one between those of the known lines about it.

    Before and after them it goes on in even steps where the known lines have such, else it is NaN.
    """
    lines, places = np.arange(len(is_known)), np.flatnonzero(is_known)
    values = np.interp(lines, places, known, left=np.nan, right=np.nan)
    if len(known) < _FEWEST_LINES:
        return np.asarray(values)
    step = (known[-1] - known[0]) / (places[-1] - places[0])
    if np.abs(known - known[0] - step * (places - places[0])).max() < 0.5 * abs(step):
        values[: places[0]] = known[0] + step * (lines[: places[0]] - places[0])
        values[places[-1] + 1 :] = known[-1] + step * (lines[places[-1] + 1 :] - places[-1])
    return np.asarray(values)


def _step(angles: Float[np.ndarray, "L"]) -> float:
    """The usual angle between neighbours [rad]."""
    steps = np.abs(np.diff(angles[np.isfinite(angles)]))
    return float(np.median(steps)) if len(steps) else 0.0
