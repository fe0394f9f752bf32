"""Convex pieces of a scan by CoACD: occupied cells, a closed surface around them, and its convex parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from costs.array_cache import Parts
from costs.scene import ConvexPiece
from perception.cleaning.clean import nearest
from perception.convex.clock import Clock
from perception.convex.coarse import coarsen, smooth_points
from perception.convex.freespace import FreeSpace, carve
from perception.convex.hulls import limit_vertices, make_hull
from perception.convex.piece import Piece, measure_evidence
from perception.convex.pieces import Pieces
from perception.convex.split import is_free_of
from perception.solids.decompose import CoacdResources, CoacdSettings, decompose
from perception.solids.mesh import Mesh
from perception.solids.voxels import wrap_cells

_VOXEL = 0.015
_COACD = CoacdSettings(0.05, iterations=20, nodes=5, depth=1)
# Parts that contain free space are split again at half the threshold, at most this many times.
_PASSES = 1
_FREE_CELL = 0.02
_MOST_FREE = 0.02  # share of a part's volume
_AROUND = 0.1
_WITHIN = 0.01
_NEIGHBOURS = 8
_LINK = 0.05
_ASIDE = 0.003  # cells this close to a point are occupied too: the surface around a single cell cuts its corners [m]
_LINK_PER_RANGE = 0.045
_TOUCHING = np.ones((3, 3, 3), dtype=bool)


def make_coacd_pieces(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    resources: CoacdResources | None = None,
) -> Pieces:
    """Return convex pieces ``coacd/0`` ... of obstacle points, in the form of ``perception.convex.make_pieces``.

    Free cells between points are never filled, and a part that contains free cells is split again.  Hollows that
    CoACD still bridges are less deep than its threshold, and count in the evidence of each piece.

    Args:
        points: (N, 3) obstacle points, cleaned [m].

    Raises:
        MeshError: CoACD crashed or exceeded its memory or time limit.
        Stopped: the caller cancelled.
    """
    if not len(points):
        return Pieces((), {})
    clock = Clock()
    grid, free = _make_cells(points, starts, rays)
    clock.lap("voxels")
    parts = _split_grid(grid, free, resources or CoacdResources())
    clock.lap("coacd")
    pieces = _name_parts(parts, points, free)
    clock.lap("evidence")
    return Pieces(pieces, clock.timings)


@dataclass(frozen=True)
class _Cells:
    """Grid of occupied cells: ``lower`` (3,) corner of the grid and ``size``, edge of a cell [m]."""

    occupied: Bool[np.ndarray, "X Y Z"]
    lower: Float[np.ndarray, "3"]
    size: float

    def wrap(self) -> list[Mesh]:
        """Return a closed surface around each group of touching cells."""
        label, _ = ndimage.label(self.occupied, _TOUCHING)
        return [
            wrap_cells(label[box] == i + 1, self.lower + np.array([side.start for side in box]) * self.size, self.size)
            for i, box in enumerate(ndimage.find_objects(label))
        ]

    def crop(self, part: Float[np.ndarray, "V 3"]) -> _Cells:
        """Return the cells whose centre lies in a convex part or up to a quarter of a cell outside it."""
        hull = make_hull(part)
        first = np.maximum(np.floor((hull.lower - self.lower) / self.size).astype(int), 0)
        last = np.floor((hull.upper - self.lower) / self.size).astype(int) + 1
        block = self.occupied[tuple(slice(a, b) for a, b in zip(first, last, strict=True))].copy()
        cells = np.argwhere(block)
        lower = self.lower + first * self.size
        block[tuple(cells[~hull.is_within((cells + 0.5) * self.size + lower, 0.25 * self.size)].T)] = False
        return _Cells(block, lower, self.size)


def _make_cells(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
) -> tuple[_Cells, FreeSpace]:
    """Return the cells with points, or between neighbouring points and not free; and the free space."""
    size = _VOXEL
    points = smooth_points(points, np.ones(len(points), dtype=int), starts, np.arange(len(points)))
    coarse = coarsen(points, starts, size)
    lower = _FREE_CELL * np.floor((coarse.points.min(axis=0) - _AROUND) / _FREE_CELL)
    upper = coarse.points.max(axis=0) + _AROUND
    free = carve(*rays, coarse.points, lower, upper, _FREE_CELL)
    occupied = np.zeros(np.ceil((upper - lower) / size).astype(int) + 1, dtype=bool)
    between = _bridge_gaps(coarse.points, coarse.starts, size)
    _mark(occupied, between[~free.contains(between)], lower, size)
    for aside in _ASIDE * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]):
        _mark(occupied, points + aside, lower, size)
    return _Cells(occupied, lower, size), free


def _mark(grid: Bool[np.ndarray, "X Y Z"], at: Float[np.ndarray, "N 3"], lower: np.ndarray, size: float) -> None:
    grid[tuple(np.floor((at - lower) / size).astype(int).T)] = True


def _bridge_gaps(
    points: Float[np.ndarray, "M 3"], starts: Float[np.ndarray, "M 3"], size: float
) -> Float[np.ndarray, "K 3"]:
    """Return points (K, 3) on the lines between neighbours at most max(5 cm, 4.5 % of range) apart [m]."""
    if len(points) < 2:
        return points
    k = np.arange(2, min(_NEIGHBOURS + 1, len(points)) + 1)
    distance, neighbour = nearest(cKDTree(points), points, k)
    link = np.maximum(_LINK, _LINK_PER_RANGE * np.linalg.norm(points - starts, axis=1))
    row, column = np.nonzero(np.asarray(distance) <= link[:, None])
    ends = points[np.asarray(neighbour)[row, column]]
    n_steps = int(np.ceil(float(link.max()) / (0.7 * size))) + 1
    steps = np.linspace(0.0, 1.0, n_steps)[:, None, None]
    return np.asarray((points[row] + steps * (ends - points[row])).reshape(-1, 3))


def _split_grid(grid: _Cells, free: FreeSpace, resources: CoacdResources) -> Parts:
    """Return convex parts of all groups of cells; parts with free space are split again at half the threshold."""
    done: list[Float[np.ndarray, "V 3"]] = []
    coacd, todo = _COACD, grid.wrap()
    for again in range(_PASSES + 1):
        hulls = [make_hull(mesh.vertices) for mesh in todo]
        whole = [is_free_of(hull, free) for hull in hulls]
        done += [hull.vertices for hull, fits in zip(hulls, whole, strict=True) if fits]
        rest = [mesh for mesh, fits in zip(todo, whole, strict=True) if not fits]
        todo = []
        for part in (part for parts in decompose(rest, coacd, resources, "cloud") for part in parts):
            if again == _PASSES or measure_evidence(make_hull(part), free).free_share < _MOST_FREE:
                done.append(part)
            else:
                todo += grid.crop(part).wrap()
        coacd = replace(coacd, threshold_m=0.5 * coacd.threshold_m)
    return tuple(done)


def _name_parts(parts: Parts, points: Float[np.ndarray, "N 3"], free: FreeSpace) -> tuple[Piece, ...]:
    """Return a piece, with name, points and evidence, for each part."""
    left = np.ones(len(points), dtype=bool)
    pieces = []
    for i, part in enumerate(parts):
        vertices = limit_vertices(part)
        hull = make_hull(vertices)
        near = left & ((points >= hull.lower - _WITHIN) & (points <= hull.upper + _WITHIN)).all(axis=1)
        mine: Int[np.ndarray, "K"] = np.flatnonzero(near)
        mine = mine[hull.is_within(points[mine], _WITHIN)]
        left[mine] = False
        shape = ConvexPiece(f"coacd/{i}", vertices, kind="clutter")
        pieces.append(Piece(shape, mine, measure_evidence(hull, free), hull.simplified))
    return tuple(pieces)
