"""Flat meshes (a wall or a ground of a few triangles) as solids: convex plates of a small thickness."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from perception.solids.mesh import Mesh, Solid, hull_mesh

THICKNESS_M = 1e-3  # of a plate, half of it on either side of the mesh [m]
_FLAT = 1e-6  # extent across the plane, as a share of the extent in it
_SAME_AREA = 1e-6  # share by which the hull of two polygons may be larger than both


def make_sheet(mesh: Mesh, name: str) -> Solid | None:
    """Return a mesh whose triangles lie in one plane as convex plates; None for any other mesh.

    Neighbouring triangles are joined as long as they stay convex, so that holes of the mesh stay open.
    """
    corners = mesh.vertices[np.unique(mesh.triangles)] if len(mesh.triangles) else np.zeros((0, 3))
    if len(corners) < 3 or not np.isfinite(corners).all():
        return None
    centre = corners.mean(axis=0)
    _, extent, axes = np.linalg.svd(corners - centre, full_matrices=False)
    if extent[1] <= _FLAT * extent[0] or extent[2] > _FLAT * extent[0]:
        return None
    flat = (mesh.vertices - centre) @ axes[:2].T
    polygons = _join_convex(flat, mesh.triangles)
    if not polygons:
        return None
    half = 0.5 * THICKNESS_M * axes[2]
    plates = [_make_plate(centre + polygon @ axes[:2], half) for polygon in polygons]
    note = f"{name}: is flat; taken for {len(plates)} plates {1e3 * THICKNESS_M:g} mm thick"
    return Solid(tuple(plates), (), (note,))


def _join_convex(points: Float[np.ndarray, "V 2"], triangles: Int[np.ndarray, "F 3"]) -> list[Float[np.ndarray, "K 2"]]:
    """Return convex polygons that cover the triangles, joined greedily across common edges."""
    cells, number = np.unique(np.round(points, 9), axis=0, return_inverse=True)
    members: dict[int, frozenset[int]] = {}
    areas: dict[int, float] = {}
    for k, triangle in enumerate(number.reshape(-1)[triangles].tolist()):
        area = _measure_area(cells[triangle])
        if area > 0.0:
            members[k], areas[k] = frozenset(triangle), area
    joined = True
    while joined:
        joined = False
        for a, b in _list_neighbours(members):
            if a not in members or b not in members:
                continue
            union = members[a] | members[b]
            area = _measure_area(cells[list(union)])
            if area <= (areas[a] + areas[b]) * (1.0 + _SAME_AREA):
                members[a], areas[a] = _take_corners(cells, union), area
                del members[b], areas[b]
                joined = True
    return [cells[list(corners)] for corners in members.values()]


def _list_neighbours(members: dict[int, frozenset[int]]) -> list[tuple[int, int]]:
    """Return pairs of polygons with two common corners."""
    by_corner: dict[int, list[int]] = {}
    for k, corners in members.items():
        for corner in corners:
            by_corner.setdefault(corner, []).append(k)
    common: dict[tuple[int, int], int] = {}
    for around in by_corner.values():
        for i, a in enumerate(around):
            for b in around[i + 1 :]:
                common[a, b] = common.get((a, b), 0) + 1
    return [pair for pair, count in common.items() if count > 1]


def _take_corners(cells: Float[np.ndarray, "C 2"], corners: frozenset[int]) -> frozenset[int]:
    """Return the corners of the hull of some cells; those on its edges stay, since neighbours end there."""
    chosen = sorted(corners)
    hull = ConvexHull(cells[chosen])
    distance = cells[chosen] @ hull.equations[:, :2].T + hull.equations[:, 2]
    on_border = (distance.max(axis=1) > -1e-9).tolist()
    return frozenset(corner for corner, is_corner in zip(chosen, on_border, strict=True) if is_corner)


def _measure_area(polygon: Float[np.ndarray, "K 2"]) -> float:
    """Return the area of the hull of points, 0 on a line."""
    try:
        return float(ConvexHull(polygon).volume)
    except QhullError:
        return 0.0


def _make_plate(polygon: Float[np.ndarray, "K 3"], half: Float[np.ndarray, "3"]) -> Mesh:
    """Return the closed prism over a convex polygon, wound outwards."""
    return hull_mesh(np.vstack([polygon - half, polygon + half]))
