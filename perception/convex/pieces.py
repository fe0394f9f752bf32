"""A cleaned cloud to convex pieces that cover what is there and leave free what was seen free."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.scene import ConvexPiece
from perception.convex.coarse import Coarse, coarsened
from perception.convex.evidence import evidence_of
from perception.convex.freespace import FreeSpace, carve
from perception.convex.hulls import Hull, hull_of, limited, thickened
from perception.convex.piece import Piece
from perception.convex.planes import Plane, PlaneSettings, find_planes
from perception.convex.slabs import FRONT, Slab, slabs_of
from perception.convex.split import clusters, merge, split

VOXEL = 0.015
_CELL = 0.02
_WITHIN = 0.01
_BEHIND = 0.02
_SKIN = 0.005
_GAP = 0.06
_AROUND = 0.1
_UPRIGHT = 0.17
_WALL = (0.8, 1.2)


@dataclass(frozen=True)
class Pieces:
    """Convex pieces of a cloud.

    Attributes:
        pieces: ``plane/0`` ..., ``wall/0`` ... and ``clutter/0`` ...
        timings: seconds by step.
    """

    pieces: tuple[Piece, ...]
    timings: dict[str, float]


def make_pieces(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    seed: int = 0,
    plane_settings: PlaneSettings | None = None,
) -> Pieces:
    """Planes become thin slabs; what is left becomes hulls that hold no seen-free space.

    Args:
        points: (N, 3) obstacle points, cleaned [m].
        starts: (3,) or (N, 3), where their rays started [m].
        rays: starts, (3,) or (R, 3), and ends (R, 3) of all rays of the scan, those of the floor, of the robot and
            those that met nothing included: evidence of free space [m].
        seed: of the plane search; the same points, in any order, and the same seed give the same pieces.
        plane_settings: what counts as a plane.
    """
    timings: dict[str, float] = {}
    if not len(points):
        return Pieces((), timings)
    clock = time.perf_counter()
    coarse = coarsened(points, starts, VOXEL)
    planes = find_planes(coarse.points, coarse.counts, coarse.starts, np.random.default_rng(seed), plane_settings)
    timings["planes"] = time.perf_counter() - clock
    clock = time.perf_counter()
    free = _seen_free(coarse, rays)
    timings["free space"] = time.perf_counter() - clock
    clock = time.perf_counter()
    slabs = [(plane, slab) for plane in planes for slab in slabs_of(plane, coarse.points, *rays, free)]
    timings["slabs"] = time.perf_counter() - clock
    clock = time.perf_counter()
    rest = ~_covered(coarse.points, slabs)
    hulls = _clutter(coarse.points[rest], coarse.starts[rest], free)
    timings["clutter"] = time.perf_counter() - clock
    clock = time.perf_counter()
    bodies = [_Body(_kind_of(plane, slab), slab.vertices, plane) for plane, slab in slabs]
    bodies += [_Body("clutter", _skinned(hull), None) for hull in hulls]
    pieces = _assembled(bodies, points, coarse, free)
    timings["evidence"] = time.perf_counter() - clock
    return Pieces(pieces, timings)


def _seen_free(coarse: Coarse, rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]) -> FreeSpace:
    """What the rays saw to be free around the points, in cells that are aligned with the world's origin."""
    lower = _CELL * np.floor((coarse.points.min(axis=0) - _AROUND) / _CELL)
    return carve(*rays, coarse.points, lower, coarse.points.max(axis=0) + _AROUND, _CELL)


def _clutter(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], free: FreeSpace) -> list[Hull]:
    """Hulls of what no plane explains, merged while they stay free."""
    if not len(points):
        return []
    hulls = [hull for members in clusters(points, starts) for hull in split(points, members, free)]
    return merge(hulls, free, _GAP)


def _covered(points: Float[np.ndarray, "N 3"], slabs: list[tuple[Plane, Slab]]) -> Bool[np.ndarray, "N"]:
    """Points that a slab stands for: within 1 cm of it, its noise, and what seems to lie up to 2 cm behind it."""
    covered = np.zeros(len(points), dtype=bool)
    for plane, slab in slabs:
        covered[plane.noise] = True
        distance = points @ plane.normal - plane.offset
        near = np.flatnonzero(~covered & (distance <= FRONT + _WITHIN) & (distance >= -_BEHIND))
        flat = points[near] @ plane.basis.T
        inside = (flat @ slab.faces[:, :2].T + slab.faces[:, 2] <= _WITHIN).all(axis=1)
        covered[near[inside]] = True
    return covered


def _skinned(hull: Hull) -> Float[np.ndarray, "V 3"]:
    """The hull with a skin of 5 mm, which covers the surface between points, and at most 64 vertices."""
    return limited(hull_of(thickened(hull.vertices, _SKIN), hull.members).vertices)


def _kind_of(plane: Plane, slab: Slab) -> str:
    """``wall`` for what stands upright and is larger than a person is wide and half a person high."""
    width, height = np.ptp(slab.outline, axis=0)
    is_wall = abs(plane.normal[2]) < _UPRIGHT and width >= _WALL[0] and height >= _WALL[1]
    return "wall" if is_wall else "plane"


@dataclass(frozen=True)
class _Body:
    """A piece before it has a name."""

    kind: str
    vertices: Float[np.ndarray, "V 3"]
    plane: Plane | None


def _assembled(
    bodies: list[_Body], points: Float[np.ndarray, "N 3"], coarse: Coarse, free: FreeSpace
) -> tuple[Piece, ...]:
    """Names, points and evidence for all bodies."""
    serial: Counter[str] = Counter()
    taken = np.zeros(len(points), dtype=bool)
    columns = np.floor(coarse.points[:, 0] / VOXEL)
    groups = _Groups.of(coarse.voxel, len(coarse.points))
    pieces = []
    for body in bodies:
        hull = hull_of(body.vertices, coarse.voxel[:0])
        mine = groups.members(_near(coarse.points, columns, hull, _WITHIN + VOXEL))
        mine = mine[~taken[mine]]
        mine = np.sort(mine[hull.is_within(points[mine], _WITHIN)])
        taken[mine] = True
        shape = ConvexPiece(f"{body.kind}/{serial[body.kind]}", body.vertices, kind=body.kind)
        serial[body.kind] += 1
        plane = None if body.plane is None else np.append(body.plane.normal, body.plane.offset)
        pieces.append(Piece(shape, mine, evidence_of(hull, free), plane))
    return tuple(pieces)


def _near(
    points: Float[np.ndarray, "M 3"], columns: Float[np.ndarray, "M"], hull: Hull, margin: float
) -> Int[np.ndarray, "K"]:
    """Points within ``margin`` of the hull's bounding box; they are in order of their columns of voxels along x."""
    lower, upper = hull.lower - margin, hull.upper + margin
    first = int(np.searchsorted(columns, np.floor(lower[0] / VOXEL)))
    last = int(np.searchsorted(columns, np.floor(upper[0] / VOXEL), side="right"))
    y, z = points[first:last, 1], points[first:last, 2]
    return first + np.flatnonzero((y >= lower[1]) & (y <= upper[1]) & (z >= lower[2]) & (z <= upper[2]))


@dataclass(frozen=True)
class _Groups:
    """Which points went into each voxel."""

    order: Int[np.ndarray, "N"]
    first: Int[np.ndarray, "M+1"]

    @classmethod
    def of(cls, voxel: Int[np.ndarray, "N"], n_voxels: int) -> _Groups:
        order = np.argsort(voxel, kind="stable")
        return cls(order, np.searchsorted(voxel[order], np.arange(n_voxels + 1)))

    def members(self, voxels: Int[np.ndarray, "K"]) -> Int[np.ndarray, "L"]:
        """Indices of all points in these voxels."""
        counts = self.first[voxels + 1] - self.first[voxels]
        ahead = np.repeat(self.first[voxels] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        return np.asarray(self.order[ahead + np.arange(len(ahead))])
