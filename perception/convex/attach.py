"""Hulls that lie in the plane of a slab beside them become part of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull, hull_of
from perception.convex.planes import Plane
from perception.convex.slabs import Slab, joined

# Three times the range noise of a usual lidar.
_IN_PLANE = 0.03
_ASIDE = 0.12
_FEW = 1


def attached(
    slabs: Sequence[tuple[Plane, Slab]], hulls: Sequence[Hull], free: FreeSpace
) -> tuple[list[tuple[Plane, Slab]], list[Hull]]:
    """The slabs with the hulls that became part of them, and the hulls that did not.

    Where scan lines lie far apart, the ends of a surface are too few points to be found as part of its plane.  A hull
    joins when it lies in a slab's plane, at most 12 cm beside it, and the slab of both holds no more seen-free space
    than the slab did; of several slabs the one that grows least takes it.

    Args:
        slabs: with their planes.
        hulls: of what no plane explains, without skin.
        free: what was seen free.
    """
    grown, left = list(slabs), []
    free_before = [_free_cells(slab, free) for _, slab in slabs]
    lower = np.array([slab.vertices.min(axis=0) for _, slab in slabs]).reshape(-1, 3)
    upper = np.array([slab.vertices.max(axis=0) for _, slab in slabs]).reshape(-1, 3)
    for hull in sorted(hulls, key=lambda one: one.volume):
        options = []
        is_beside = (hull.lower <= upper + _ASIDE).all(axis=1) & (hull.upper >= lower - _ASIDE).all(axis=1)
        for i in map(int, np.flatnonzero(is_beside)):
            plane, slab = grown[i]
            if np.abs(hull.vertices @ plane.normal - plane.offset).max() > _IN_PLANE:
                continue
            joint = joined(plane, slab, hull.vertices @ plane.basis.T)
            if _free_cells(joint, free) <= free_before[i] + _FEW:
                options.append((joint.area - slab.area, i, joint))
        if options:
            _, i, joint = min(options, key=lambda option: option[:2])
            grown[i] = grown[i][0], joint
            lower[i], upper[i] = joint.vertices.min(axis=0), joint.vertices.max(axis=0)
        else:
            left.append(hull)
    return grown, left


def _free_cells(slab: Slab, free: FreeSpace) -> int:
    hull = hull_of(slab.vertices, np.zeros(0, dtype=np.int64))
    return free.count_inside(hull.simplified.faces, hull.vertices, 0.25 * free.size)
