"""Level patches: flat pieces of surface that face up, with the bounding rectangle of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from costs.stopping import poll
from perception.detect.shared.arithmetic import sum_about

_CELL = 0.03
_LAYER = 0.015
_THICK = 0.03
_TALL = 0.12
_LEAST_AREA = 0.07
_STEEPEST = np.tan(np.radians(12.0))
_MOST_LEVELS = 10
_ROW = 0.05
_GAP = 0.06
YAWS = np.radians(np.arange(0.0, 90.0, 1.0))


@dataclass(frozen=True)
class Patch:
    """Level patch.

    Attributes:
        centre: (3,) middle of its rectangle, on its plane [m].
        yaw: direction of the rectangle's first side, modulo quarter turns [rad].
        size: (2,) length along the first and the second side [m].
        filled: share of the rectangle that the patch covers.
        rms: of its points' distances from its plane [m].
        points: (K, 3) its points [m].
    """

    centre: Float[np.ndarray, "3"]
    yaw: float
    size: Float[np.ndarray, "2"]
    filled: float
    rms: float
    points: Float[np.ndarray, "K 3"]


def find_patches(points: Float[np.ndarray, "N 3"], low: float, high: float) -> list[Patch]:
    """Return level patches between two heights, largest first."""
    near = points[(points[:, 2] > low - _TALL) & (points[:, 2] < high + _TALL)]
    if len(near) < 30:
        return []
    cell = np.floor((near[:, :2] - near[:, :2].min(axis=0)) / _CELL).astype(int)
    shape = (int(cell[:, 0].max()) + 1, int(cell[:, 1].max()) + 1)
    column = cell[:, 0] * shape[1] + cell[:, 1]
    patches = []
    for level in _levels(column, near[:, 2], low, high):
        patches += _patches_at(near, column, shape, level)
    return sorted(_drop_duplicates(patches), key=lambda patch: -float(np.prod(patch.size) * patch.filled))


def _levels(
    column: Float[np.ndarray, "N"], height: Float[np.ndarray, "N"], low: float, high: float
) -> Float[np.ndarray, "L"]:
    """Return heights at which many columns hold points, fullest first [m]."""
    layer = np.floor((height - low) / _LAYER).astype(int)
    n_layers = int(np.ceil((high - low) / _LAYER))
    inside = (layer >= 0) & (layer < n_layers)
    pairs = np.unique(column[inside].astype(np.int64) * n_layers + layer[inside])
    votes = np.bincount(pairs % n_layers, minlength=n_layers).astype(float)
    votes = sum_about(votes, (1.0, 1.0, 1.0))
    levels = []
    for _ in range(_MOST_LEVELS):
        best = int(np.argmax(votes))
        if votes[best] * _CELL**2 < _LEAST_AREA:
            break
        levels.append(low + (best + 0.5) * _LAYER)
        votes[max(best - 3, 0) : best + 4] = 0.0
    return np.array(levels)


def _patches_at(
    points: Float[np.ndarray, "N 3"], column: Float[np.ndarray, "N"], shape: tuple[int, int], level: float
) -> list[Patch]:
    """Return connected patches near one height, without columns that continue above or below, such as walls."""
    off = np.abs(points[:, 2] - level)
    size = shape[0] * shape[1]
    on = np.bincount(column[off < _THICK], minlength=size)
    about = np.bincount(column[off < _TALL], minlength=size)
    mask = ((on > 0) & (on >= 0.6 * about)).reshape(shape)
    mask = ndimage.binary_closing(np.pad(mask, 3), iterations=2)[3:-3, 3:-3]
    labels, n_labels = ndimage.label(ndimage.binary_opening(mask))
    out = []
    of_point = labels.ravel()[column]
    for label in range(1, n_labels + 1):
        n_cells = int((labels == label).sum())
        if n_cells * _CELL**2 < _LEAST_AREA:
            continue
        patch = _patch(points[(of_point == label) & (off < 1.5 * _THICK)], n_cells * _CELL**2)
        if patch is not None:
            out.append(patch)
    return out


def _patch(members: Float[np.ndarray, "K 3"], area: float) -> Patch | None:
    if len(members) < 15:
        return None
    middle = members.mean(axis=0)
    plane, *_ = np.linalg.lstsq(np.column_stack([members[:, :2] - middle[:2], np.ones(len(members))]), members[:, 2])
    if np.hypot(plane[0], plane[1]) > _STEEPEST:
        return None
    off = members[:, 2] - (members[:, :2] - middle[:2]) @ plane[:2] - plane[2]
    yaw, low, high = _rectangle(members[:, :2])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    centre = 0.5 * (low + high) @ turn
    height = float((centre - middle[:2]) @ plane[:2] + plane[2])
    size = high - low
    return Patch(
        np.array([*centre, height]),
        yaw,
        size,
        float(min(area / max(np.prod(size), 1e-6), 1.0)),
        float(np.sqrt(np.mean(off**2))),
        members,
    )


def _rectangle(flat: Float[np.ndarray, "K 2"]) -> tuple[float, Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return yaw and the corners (in turned coordinates) of the smallest bounding rectangle, outliers ignored."""
    few = flat[:: max(1, len(flat) // 3000)]
    first = few @ np.stack([np.cos(YAWS), np.sin(YAWS)])
    second = few @ np.stack([-np.sin(YAWS), np.cos(YAWS)])
    ends = np.percentile(np.stack([first, second]), [0.7, 99.3], axis=1)
    best = int(np.argmin(np.prod(ends[1] - ends[0], axis=0)))
    return float(YAWS[best]), ends[0][:, best], ends[1][:, best]


def _drop_duplicates(patches: list[Patch]) -> list[Patch]:
    """Drop patches whose centre is within 15 cm of a larger one's."""
    kept: list[Patch] = []
    for patch in sorted(patches, key=lambda candidate: -len(candidate.points)):
        if all(np.linalg.norm(patch.centre - other.centre) > 0.15 for other in kept):
            kept.append(patch)
    return kept


def split_at_gap(patch: Patch, least: float) -> list[Patch]:
    """Return the patch, or its two parts if a gap separates parts at least ``least`` long [m]."""
    long = int(np.argmax(patch.size))
    if patch.size[long] < 2.0 * least:
        return [patch]
    turn = np.array([[np.cos(patch.yaw), np.sin(patch.yaw)], [-np.sin(patch.yaw), np.cos(patch.yaw)]])
    along = (patch.points[:, :2] - patch.centre[:2]) @ turn[long]
    across = (patch.points[:, :2] - patch.centre[:2]) @ turn[1 - long]
    # Share of rows with points in each slice across the length: a gap has few.
    n_rows = max(round(patch.size[1 - long] / _ROW), 1)
    slices = np.floor(along / _CELL + 0.5 * patch.size[long] / _CELL).astype(int)
    rows = np.clip(np.floor(across / _ROW + 0.5 * n_rows).astype(int), 0, n_rows - 1)
    n_slices = int(patch.size[long] / _CELL) + 1
    inside = (slices >= 0) & (slices < n_slices)
    grid = np.zeros((n_slices, n_rows), dtype=bool)
    grid[slices[inside], rows[inside]] = True
    filled = grid.mean(axis=1)
    is_low = filled < 0.4 * np.median(filled[filled > 0.0])
    labels, n_labels = ndimage.label(is_low)
    for label in range(1, n_labels + 1):
        gap = np.flatnonzero(labels == label) * _CELL - 0.5 * patch.size[long]
        first, last = gap[0], gap[-1] + _CELL
        sides = (first + 0.5 * patch.size[long], 0.5 * patch.size[long] - last)
        if last - first >= _GAP and min(sides) >= least:
            parts = [patch.points[along < first], patch.points[along > last]]
            area = patch.filled * float(np.prod(patch.size)) * (1.0 - (last - first) / patch.size[long])
            halves = [_patch(part, area * side / sum(sides)) for part, side in zip(parts, sides, strict=True)]
            return [half for half in halves if half is not None]
    return [patch]


def is_inside(
    local: Float[np.ndarray, "N 3"], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "N"]:
    """Return which points are in the axis-aligned box from ``low`` to ``high``."""
    poll()
    return np.asarray(((local > low) & (local < high)).all(axis=1))


def filled_cells(
    places: Float[np.ndarray, "K 2"],
    low: Float[np.ndarray, "2"],
    shape: Int[np.ndarray, "2"],
    cell: float | Float[np.ndarray, "2"],
) -> Bool[np.ndarray, "A B"]:
    """Return the occupancy grid of points; points outside the grid are ignored.

    Args:
        places: (K, 2) points [m].
        low: (2,) lower corner of the grid [m].
        shape: (2,) number of cells along each axis.
        cell: edge lengths of a cell [m].
    """
    poll()
    grid = np.zeros(tuple(shape), dtype=bool)
    index = np.floor((places - low) / cell).astype(int)
    index = index[((index >= 0) & (index < shape)).all(axis=1)]
    grid[index[:, 0], index[:, 1]] = True
    return grid
