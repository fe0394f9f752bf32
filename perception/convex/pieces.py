"""A cleaned cloud to convex pieces that cover what is there and leave free what was seen free."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece
from perception.clean import voxel_downsample
from perception.convex.freespace import FreeSpace, carve
from perception.convex.hulls import Hull, hull_of, limited, thickened
from perception.convex.planes import Plane, PlaneSettings, find_planes
from perception.convex.slabs import FRONT, Slab, slabs_of
from perception.convex.split import clusters, is_free_of, merge, split

_VOXEL = 0.015
_WITHIN = 0.01
_BEHIND = 0.02
_SKIN = 0.005
_GAP = 0.06


@dataclass(frozen=True)
class Pieces:
    """Convex pieces of a cloud.

    Attributes:
        pieces: ``plane/0`` ... and ``clutter/0`` ...
        timings: seconds by step.
    """

    pieces: tuple[ConvexPiece, ...]
    timings: dict[str, float]


def make_pieces(
    points: Float[np.ndarray, "N 3"],
    origin: Float[np.ndarray, "3"],
    ends: Float[np.ndarray, "M 3"],
    seed: int = 0,
    plane_settings: PlaneSettings | None = None,
) -> Pieces:
    """Planes become thin slabs; what is left becomes hulls that hold no seen-free space.

    Args:
        points: (N, 3) obstacle points, cleaned [m].
        origin: (3,) of the rays [m].
        ends: (M, 3) ends of all rays of the scan, the floor's and the robot's included: evidence of free space [m].
        seed: of the plane search; the same seed gives the same pieces.
        plane_settings: what counts as a plane.
    """
    timings: dict[str, float] = {}
    if not len(points):
        return Pieces((), timings)
    clock = time.perf_counter()
    coarse, counts = voxel_downsample(points, _VOXEL)
    planes = find_planes(coarse, counts, origin, np.random.default_rng(seed), plane_settings)
    timings["planes"] = time.perf_counter() - clock
    clock = time.perf_counter()
    slabs = [(plane, slab) for plane in planes for slab in slabs_of(plane, coarse, origin, ends)]
    timings["slabs"] = time.perf_counter() - clock
    clock = time.perf_counter()
    margin = 0.1
    free = carve(origin, ends, coarse, coarse.min(axis=0) - margin, coarse.max(axis=0) + margin)
    timings["free space"] = time.perf_counter() - clock
    clock = time.perf_counter()
    rest = coarse[~_covered(coarse, slabs)]
    hulls = _clutter(rest, origin, free)
    timings["clutter"] = time.perf_counter() - clock
    named = [ConvexPiece(f"plane/{i}", slab.vertices, kind="plane") for i, (_, slab) in enumerate(slabs)]
    named += [ConvexPiece(f"clutter/{i}", _skinned(hull), kind="clutter") for i, hull in enumerate(hulls)]
    return Pieces(tuple(named), timings)


def _clutter(points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], free: FreeSpace) -> list[Hull]:
    """Hulls of what no plane explains, merged while they stay free."""
    if not len(points):
        return []
    hulls = [hull for members in clusters(points, origin) for hull in split(points, members, free)]
    return merge(hulls, lambda joint: is_free_of(joint, free), _GAP)


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
