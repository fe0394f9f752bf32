"""Depth profile along an upright plane, column by column, and its partition into straight stretches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.detect.door.upright import Upright

BIN = 0.02
BAND = (0.25, 1.8)  # heights over the floor that walls and leaves fill [m]
_DEPTH_BIN = 0.01
STOREY = 0.1
_WINDOW = 0.35
_LAYER = (0.03, 0.06)  # least and most distance of a column's points from their mean [m]
_LAYERS_PER_SCATTER = 2.2
_ROUNDS = 6
_LEAST_STOREYS = 3
_FEWEST_IN_BAND = 3  # points from which a height band's mean counts
_BEHIND = 0.03
_MARGIN = 7
_FAR = 0.1
_SHARED = 0.6
_STEADY = 0.002  # error that remains in a mean of many points [m]
_PIECE_COST = 30.0


@dataclass(frozen=True)
class Rays:
    """Start and end points of rays, those without a return included."""

    starts: Float[np.ndarray, "R 3"]
    ends: Float[np.ndarray, "R 3"]

    def crossing(
        self, plane: Upright, out: float = 0.0
    ) -> tuple[Float[np.ndarray, "R 2"], Float[np.ndarray, "R"], Bool[np.ndarray, "R"]]:
        """Return the crossings of rays, extended if needed, with the plane moved ``out`` towards the sensor.

        Returns:
            (R, 2) along and up [m], (R,) distance of the end out of the moved plane [m], (R,) rays that head for it.
        """
        start = self.starts @ plane.normal - plane.offset - out
        end = self.ends @ plane.normal - plane.offset - out
        heading = (start > 0.05) & (start - end > 1e-6)
        share = start / np.where(heading, start - end, 1.0)
        way = self.ends - self.starts
        at = np.column_stack(
            [
                self.starts @ plane.along + share * (way @ plane.along),
                self.starts[:, 2] + share * way[:, 2],
            ]
        )
        return at, end, heading


@dataclass(frozen=True)
class Profile:
    """Depth along a plane, in columns ``BIN`` wide.

    Attributes:
        low: position of the first column's border along the plane [m].
        depth: (B,) mean distance of the column's surface out of the plane, NaN without a surface [m].
        sigma: (B,) its standard error, with what neighbours share [m].
        storeys: (B,) number of 10 cm height bands with points of that surface.
        open_storeys: (B,) number of height bands in which rays went on behind it.
    """

    low: float
    depth: Float[np.ndarray, "B"]
    sigma: Float[np.ndarray, "B"]
    storeys: Int[np.ndarray, "B"]
    open_storeys: Int[np.ndarray, "B"]

    @property
    def centres(self) -> Float[np.ndarray, "B"]:
        """(B,) column centres along the plane [m]."""
        return self.low + BIN * (np.arange(len(self.depth)) + 0.5)

    @property
    def is_solid(self) -> Bool[np.ndarray, "B"]:
        """(B,) columns with a surface, solid in at least as many height bands as open."""
        return np.asarray(~np.isnan(self.depth) & (self.storeys >= self.open_storeys))


@dataclass(frozen=True)
class Stretch:
    """Neighbouring columns on one straight line, or without a surface.

    Attributes:
        first, last: columns, ``last`` excluded.
        slope, intercept: depth = slope * along + intercept [m]; NaN without a surface.
    """

    first: int
    last: int
    slope: float
    intercept: float


def take_profile(
    plane: Upright, points: Float[np.ndarray, "N 3"], rays: Rays, low: float, high: float, window: float = _WINDOW
) -> Profile:
    """Return the profile of the points and rays at world heights between ``low`` and ``high`` [m]."""
    poll()
    local = plane.local(points)
    band = (local[:, 1] > low) & (local[:, 1] < high) & (np.abs(local[:, 2]) < window)
    local = local[band]
    if len(local) < 20:
        empty = np.zeros(0)
        return Profile(0.0, empty, empty, empty.astype(int), empty.astype(int))
    # A margin of columns without points, where rays may still show open space.
    start = float(np.floor(local[:, 0].min() / BIN) * BIN) - _MARGIN * BIN
    column = np.floor((local[:, 0] - start) / BIN).astype(int)
    n_columns = int(column.max()) + 1 + _MARGIN
    storey = np.floor((local[:, 1] - low) / STOREY).astype(int)
    n_storeys = int(np.ceil((high - low) / STOREY))
    centre = _mode(column, storey, local[:, 2], (n_columns, n_storeys), window)
    near = np.ones(len(local), dtype=bool)
    layer = _LAYER[0]
    for _ in range(_ROUNDS):
        near = np.abs(local[:, 2] - centre[column]) < layer
        count = np.bincount(column[near], minlength=n_columns)
        total = np.bincount(column[near], local[near, 2], n_columns)
        centre = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        square = np.bincount(column[near], (local[near, 2] - centre[column[near]]) ** 2, n_columns)
        # The layer holds most of the noise of a usual column, which a narrow layer cuts off.
        scatter = float(np.sqrt(np.median(square[count > 1] / count[count > 1]))) if (count > 1).any() else 0.0
        layer = float(np.clip(_LAYERS_PER_SCATTER * scatter, *_LAYER))
    # The scatter of few points is unknown: one centimetre is the prior.
    sigma = np.sqrt((square + 1e-4) / (count + 1) / np.maximum(count, 1))
    sigma = np.hypot(sigma, _shared_error(column[near], storey[near], local[near, 2], (n_columns, n_storeys)))
    storeys = _drop_duplicates(column[near], storey[near], (n_columns, n_storeys))
    centre[storeys < _LEAST_STOREYS] = np.nan
    opened = _open_storeys(plane, rays, start, (n_columns, n_storeys), low, centre)
    return Profile(start, centre, sigma, storeys, opened)


def _mode(
    column: Int[np.ndarray, "N"],
    storey: Int[np.ndarray, "N"],
    depth: Float[np.ndarray, "N"],
    shape: tuple[int, int],
    window: float,
) -> Float[np.ndarray, "B"]:
    """Return (B,) depth at which most height bands of each column hold points [m]."""
    layer = np.floor((depth + window) / _DEPTH_BIN).astype(int)
    n_layers = int(np.ceil(2.0 * window / _DEPTH_BIN)) + 1
    grid = np.zeros((*shape, n_layers), dtype=bool)
    grid[column, storey, layer] = True
    # Three layers together, so that noise does not split a face.
    wide = grid.copy()
    wide[..., 1:] |= grid[..., :-1]
    wide[..., :-1] |= grid[..., 1:]
    votes = wide.sum(axis=1) + 0.5 * grid.sum(axis=1)
    middle = (np.arange(n_layers) + 0.5) * _DEPTH_BIN - window
    best = np.argmax(votes, axis=1)
    # In an oblique view a column holds a surface on the plane and one far behind it; prefer the plane.
    on_plane = np.where(np.abs(middle) < _LAYER[0], votes, 0.0)
    is_hidden = (np.abs(middle[best]) > _FAR) & (on_plane.max(axis=1) > _SHARED * votes.max(axis=1))
    return np.asarray(middle[np.where(is_hidden, np.argmax(on_plane, axis=1), best)])


def _shared_error(
    column: Int[np.ndarray, "N"], storey: Int[np.ndarray, "N"], depth: Float[np.ndarray, "N"], shape: tuple[int, int]
) -> Float[np.ndarray, "B"]:
    """Return (B,) standard error of each column's mean that neighbours share, by the scatter of its height bands [m].

    Neighbouring pixels of a depth camera err together; then many points are no better than a few.  Bands whose scatter
    their own points explain add nothing.
    """
    cell = np.ravel_multi_index((column, storey), shape)
    n = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
    at_least = np.maximum(n, 1)
    mean = np.bincount(cell, depth, n.size).reshape(shape) / at_least
    square = np.bincount(cell, depth**2, n.size).reshape(shape) / at_least - mean**2
    full = n >= _FEWEST_IN_BAND
    n_bands = np.maximum(full.sum(axis=1), 1)
    middle = np.where(full, mean, 0.0).sum(axis=1) / n_bands
    spread = np.where(full, (mean - middle[:, None]) ** 2, 0.0).sum(axis=1) / np.maximum(n_bands - 1, 1)
    explained = np.where(full, np.maximum(square, 0.0) / np.maximum(n - 1, 1), 0.0).sum(axis=1) / n_bands
    return np.asarray(np.sqrt(np.maximum(spread - explained, 0.0) / n_bands))


def _drop_duplicates(column: Int[np.ndarray, "N"], storey: Int[np.ndarray, "N"], shape: tuple[int, int]) -> np.ndarray:
    grid = np.zeros(shape, dtype=bool)
    grid[column, storey] = True
    return np.asarray(grid.sum(axis=1))


def _open_storeys(
    plane: Upright,
    rays: Rays,
    start: float,
    shape: tuple[int, int],
    low: float,
    centre: Float[np.ndarray, "B"],
) -> Int[np.ndarray, "B"]:
    """Return (B,) number of height bands in which rays went on behind the column's surface (or else the plane)."""
    at, end, heading = rays.crossing(plane)
    cell = np.floor((at - [start, low]) / [BIN, STOREY]).astype(int)
    inside = heading & ((cell >= 0) & (cell < shape)).all(axis=1)
    column, storey = cell[inside, 0], cell[inside, 1]
    level = np.nan_to_num(centre[column], nan=0.0)
    through = end[inside] < np.minimum(level, 0.0) - _BEHIND - _LAYER[0]
    return _drop_duplicates(column[through], storey[through], shape)


def straight_stretches(profile: Profile) -> list[Stretch]:
    """Return the optimal partition of the profile into straight stretches: least misfit plus a cost per stretch."""
    solid = profile.is_solid
    out: list[Stretch] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], solid.astype(int), [0]])))
    at = 0
    for first, last in edges.reshape(-1, 2):
        if first > at:
            out.append(Stretch(at, int(first), np.nan, np.nan))
        out += _partition(profile, int(first), int(last))
        at = int(last)
    if at < len(solid):
        out.append(Stretch(at, len(solid), np.nan, np.nan))
    return out


def _partition(profile: Profile, first: int, last: int) -> list[Stretch]:
    """Return the optimal stretches of solid columns, by dynamic programming; all line fits use running sums."""
    x = profile.centres[first:last]
    y = profile.depth[first:last]
    weight = 1.0 / (profile.sigma[first:last] ** 2 + _STEADY**2)
    origin = x.mean()
    x = x - origin
    sums = np.concatenate(
        [
            np.zeros((6, 1)),
            np.cumsum([weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y], 1),
        ],
        axis=1,
    )
    n = len(x)
    best = np.full(n + 1, np.inf)
    best[0] = 0.0
    back = np.zeros(n + 1, dtype=int)
    for end in range(1, n + 1):
        slope, intercept, misfit = _line(sums[:, end][:, None] - sums[:, :end])
        cost = best[:end] + misfit + _PIECE_COST
        back[end] = int(np.argmin(cost))
        best[end] = cost[back[end]]
    out = []
    end = n
    while end > 0:
        start = int(back[end])
        slope, intercept, _ = _line((sums[:, end] - sums[:, start])[:, None])
        out.append(Stretch(first + start, first + end, float(slope[0]), float(intercept[0] - slope[0] * origin)))
        end = start
    return out[::-1]


def _line(
    sums: Float[np.ndarray, "6 K"],
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Return slope, intercept and misfit of weighted least-squares lines."""
    w, wx, wy, wxx, wxy, wyy = sums
    # One or two columns do not determine a slope: regularise it.
    spread = wxx - wx**2 / w + 1e-3 * w * BIN**2 + 1.0
    slope = (wxy - wx * wy / w) / spread
    intercept = (wy - slope * wx) / w
    misfit = np.maximum(wyy - wy**2 / w - slope * (wxy - wx * wy / w), 0.0)
    return slope, intercept, misfit
