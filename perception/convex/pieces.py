"""Convex pieces of a cleaned cloud: they cover its points and contain no space that rays passed through."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.progress import tell
from costs.scene import ConvexPiece
from perception.convex.body import Body
from perception.convex.clock import Clock
from perception.convex.coarse import Coarse, Groups, coarsen, measure_spacing, smooth_points
from perception.convex.freespace import Crossing, FreeSpace
from perception.convex.hulls import SKIN, Hull, limit_vertices, make_hull, thicken
from perception.convex.piece import Piece, measure_evidence
from perception.convex.planes import Plane, PlaneSettings, find_planes
from perception.convex.reduce import reduce_bodies
from perception.convex.slabs import FRONT, Slab, attach_hulls, make_slabs
from perception.convex.split import find_clusters, merge, refine_hulls, split
from perception.noise import MODELS, NoiseModel

VOXEL = 0.015
_CELL = 0.02
_WITHIN = 0.01
_BEHIND = 0.02
_NOISE = 0.002
_GAP = 0.06
_GAP_OF_RANGE = 0.06
_SKIN_OF_SPACING = 0.4
_MOST_SKIN = 0.02
AROUND = 0.1
_UPRIGHT = 0.17
_WALL = (0.8, 1.2)
# Slabs follow curved surfaces closely: a plane loses the members around which the points are off the plane.
_PLANES = PlaneSettings(covered=FRONT + _WITHIN, bias=0.007)


@dataclass(frozen=True)
class Pieces:
    """Convex pieces of a cloud.

    Attributes:
        pieces: ``plane/0`` ..., ``wall/0`` ... and ``clutter/0`` ...
        timings: time per step [s].
    """

    pieces: tuple[Piece, ...]
    timings: dict[str, float]


def make_pieces(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    seed: int = 0,
    noise: NoiseModel = MODELS["spinning"],
    doubt: float = 0.0,
) -> Pieces:
    """Return thin slabs for the planes of a cloud, and hulls without free space for the remaining points.

    Args:
        points: (N, 3) obstacle points, cleaned [m].
        rays: starts, (3,) or (R, 3), and ends (R, 3) of all rays of the scan, which show free space; rays that end on
            the floor, on the robot or nowhere are included [m].
        noise: of the sensor; pieces grow by what smoothing does not average out of it.
        doubt: distance from points within which no space counts as free, since the start of the rays is not known
            better [m].
        seed: of the plane search; the same points, in any order, and the same seed give the same pieces.
    """
    if not len(points):
        return Pieces((), {})
    clock = Clock()
    tell("find free space")
    rays = share_start(rays)
    coarse = coarsen(points, starts, VOXEL)
    free = make_crossing(coarse.points, rays).mark_free(coarse.points, doubt=doubt)
    clock.lap("free space")
    bodies = make_bodies(coarse, np.arange(len(coarse.points)), rays, free, seed, clock, noise, doubt)
    bodies = reduce_bodies(bodies, free)
    clock.lap("reduction")
    kept = np.ones(len(points), dtype=bool)
    pieces = assign_points(name_bodies(bodies, {}, free), points, kept, Groups.of(coarse), coarse)
    clock.lap("evidence")
    return Pieces(pieces, clock.timings)


def make_bodies(
    coarse: Coarse,
    left: Int[np.ndarray, "K"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    free: FreeSpace,
    seed: int,
    clock: Clock,
    noise: NoiseModel = MODELS["spinning"],
    doubt: float = 0.0,
) -> list[Body]:
    """Return slabs and hulls for the points with the indices ``left``."""
    if not len(left):
        return []
    points, starts = coarse.points[left], coarse.starts[left]
    tell("find planes")
    planes = find_planes(points, coarse.counts[left], starts, np.random.default_rng(seed), _PLANES)
    clock.lap("planes")
    apart = measure_spacing(coarse.points, coarse.starts, left)
    slabs: list[tuple[Plane, Slab]] = []
    for i, plane in enumerate(planes):
        tell("make slabs", i / len(planes))
        slabs += [(plane, slab) for slab in make_slabs(plane, points, *rays, free, apart)]
    clock.lap("slabs")
    points = smooth_points(coarse.points, coarse.counts, coarse.starts, left)
    rest = ~_find_covered(points, slabs)
    tell("make hulls")
    hulls = _make_clutter(points[rest], starts[rest], free)
    hulls = refine_hulls(hulls, points[rest], coarse.points, rays, _GAP, doubt)
    slabs, hulls = attach_hulls(slabs, hulls, free)
    bulge = noise.bulge(np.linalg.norm(points - starts, axis=1))
    bodies = [
        Body(_choose_kind(plane, slab), _bulge_slab(plane, slab, bulge, free), np.append(plane.normal, plane.offset))
        for plane, slab in slabs
    ]
    bodies += [Body("clutter", _add_skin(hull, apart[rest], bulge[rest], free), None) for hull in hulls]
    clock.lap("clutter")
    return bodies


def share_start(
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
) -> tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]:
    """Return the rays with a single start (3,) if all rays share it."""
    starts, ends = rays
    return (starts[0] if starts.ndim == 2 and len(starts) and (starts == starts[0]).all() else starts), ends


def make_crossing(
    held: Float[np.ndarray, "H 3"], rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]
) -> Crossing:
    """Clip the rays to a grid 10 cm larger than the bounding box of ``held`` [m], aligned with the world's origin."""
    lower = _CELL * np.floor((held.min(axis=0) - AROUND) / _CELL)
    return Crossing.of(*rays, lower, held.max(axis=0) + AROUND, _CELL)


def _make_clutter(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], free: FreeSpace) -> list[Hull]:
    """Return hulls of points that are on no plane, merged while they contain no free space."""
    if not len(points):
        return []
    hulls: list[Hull] = []
    n_done = 0
    for members in find_clusters(points, starts):
        hulls += split(points, members, free)
        n_done += len(members)
        tell("make hulls", n_done / len(points))
    ranges = np.linalg.norm(points - starts, axis=1)
    gaps = np.array([max(_GAP, _GAP_OF_RANGE * float(np.median(ranges[hull.members]))) for hull in hulls])
    return merge(hulls, free, gaps)


def _find_covered(points: Float[np.ndarray, "N 3"], slabs: list[tuple[Plane, Slab]]) -> Bool[np.ndarray, "N"]:
    """Return which points a slab represents: points inside it, noise of its plane, and points up to 2 cm behind it.

    Points that protrude farther than the slab's front face belong to another object, such as a button.

    Args:
        points: (N, 3) smoothed points [m].
    """
    covered = np.zeros(len(points), dtype=bool)
    for plane, slab in slabs:
        covered[plane.noise] = True
        distance = points @ plane.normal - plane.offset
        near = np.flatnonzero(~covered & (distance <= FRONT + _NOISE) & (distance >= -_BEHIND))
        flat = points[near] @ plane.basis.T
        inside = (flat @ slab.faces[:, :2].T + slab.faces[:, 2] <= _WITHIN).all(axis=1)
        covered[near[inside]] = True
    return covered


def _bulge_slab(plane: Plane, slab: Slab, bulge: Float[np.ndarray, "N"], free: FreeSpace) -> Float[np.ndarray, "V 3"]:
    """Return the vertices of a slab, thicker by the bulge of its points if it then contains no more free space."""
    grown = float(np.median(bulge[plane.members]))
    if grown <= 0.0:
        return slab.vertices
    side = np.sign(slab.vertices @ plane.normal - plane.offset)
    thick = slab.vertices + (grown * side)[:, None] * plane.normal
    before, after = (free.count_inside(make_hull(vertices)) for vertices in (slab.vertices, thick))
    return thick if after <= before else slab.vertices


def _add_skin(
    hull: Hull, apart: Float[np.ndarray, "N"], bulge: Float[np.ndarray, "N"], free: FreeSpace
) -> Float[np.ndarray, "V 3"]:
    """Return at most 64 vertices of the hull grown by a skin that covers the surface between its points.

    The skin is 5 mm and the bulge of the points, or two fifths of a larger point spacing, if the hull then contains no
    more free space than with 5 mm.

    Args:
        hull: its members index ``apart``.
        apart: (N,) distance of each point to its neighbours [m].
        bulge: (N,) what smoothing leaves of their noise [m].
    """
    skinned = make_hull(thicken(hull.vertices, SKIN), hull.members)
    spaced = _SKIN_OF_SPACING * float(np.median(apart[hull.members]))
    skin = min(max(spaced, SKIN + float(np.median(bulge[hull.members]))), _MOST_SKIN)
    if skin > SKIN:
        thick = make_hull(thicken(hull.vertices, skin), hull.members)
        if free.count_inside(thick) <= free.count_inside(skinned):
            skinned = thick
    return limit_vertices(skinned.vertices)


def _choose_kind(plane: Plane, slab: Slab) -> str:
    """Return ``wall`` for an upright slab at least 0.8 m wide and 1.2 m high, else ``plane``."""
    width, height = np.ptp(slab.outline, axis=0)
    is_wall = abs(plane.normal[2]) < _UPRIGHT and width >= _WALL[0] and height >= _WALL[1]
    return "wall" if is_wall else "plane"


def name_bodies(bodies: Sequence[Body], first: Mapping[str, int], free: FreeSpace) -> list[Piece]:
    """Return pieces without points; the numbers in their names start at ``first[kind]``."""
    serial, nothing = Counter(first), np.zeros(0, dtype=np.int64)
    pieces = []
    for body in bodies:
        hull = make_hull(body.vertices, nothing)
        shape = ConvexPiece(f"{body.kind}/{serial[body.kind]}", body.vertices, kind=body.kind)
        serial[body.kind] += 1
        pieces.append(Piece(shape, nothing, measure_evidence(hull, free), hull.simplified, body.plane))
    return pieces


def assign_points(
    pieces: Sequence[Piece],
    points: Float[np.ndarray, "N 3"],
    kept: Bool[np.ndarray, "N"],
    groups: Groups,
    coarse: Coarse,
) -> tuple[Piece, ...]:
    """Return the pieces with their points: kept points within 1 cm of the piece and of no earlier piece."""
    taken = ~kept
    made = []
    for piece in pieces:
        hull = piece.hull
        mine = groups.list_members(coarse.select_within(hull.lower - (_WITHIN + VOXEL), hull.upper + (_WITHIN + VOXEL)))
        mine = mine[~taken[mine]]
        mine = np.sort(mine[hull.is_within(points[mine], _WITHIN)])
        taken[mine] = True
        made.append(replace(piece, points=mine))
    return tuple(made)
