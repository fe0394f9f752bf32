"""Closed surfaces with few triangles for CoACD to split: around occupied cells, and of meshes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from perception.solids.mesh import Mesh, is_closed

_SIMPLER = 0.1  # share of the triangles that is left of a cell's own where the surface is smooth
_SIMPLER_SHELL = 0.01  # of a shell's, whose cells follow a surface without noise
_STRAY = 0.2  # of a cell: how far the simpler surface may lie from the cells' own
_CELLS_ACROSS = 40
_SMALLEST_CELL = 0.003
_LARGEST_CELL = 0.02


def wrap_cells(
    occupied: Bool[np.ndarray, "X Y Z"], lower: Float[np.ndarray, "3"], size: float, simpler: float = _SIMPLER
) -> Mesh:
    """Make a closed surface, wound outwards, half-way between the middles of occupied and empty cells.

    Args:
        simpler: share of the triangles to come down to where the surface is smooth.
    """
    # open3d takes 0.7 s to import; flying edges is marching cubes without doubled corners.
    import open3d as o3d

    volume = np.ascontiguousarray(np.pad(occupied, 1).transpose(2, 1, 0), dtype=np.float32)
    made = o3d.t.geometry.TriangleMesh.create_isosurfaces(o3d.core.Tensor.from_numpy(volume), [0.5])
    vertices = (made.vertex.positions.numpy().astype(np.float64) - 0.5) * size + lower
    full = Mesh(vertices, made.triangle.indices.numpy().astype(np.int64))
    return simplify_mesh(full, int(simpler * len(full.triangles)), _STRAY * size)


def wrap_mesh(mesh: Mesh) -> Mesh:
    """Make a closed surface around the triangles of an open mesh, as thick as one to two cells: 1/40 of its size."""
    span = float(np.ptp(mesh.vertices, axis=0).max())
    size = float(np.clip(span / _CELLS_ACROSS, min(_SMALLEST_CELL, span / 8), max(_LARGEST_CELL, span / 256)))
    points = sample_surface(mesh, 0.5 * size)
    lower = points.min(axis=0) - 0.5 * size
    cells = np.floor((points - lower) / size).astype(np.int64)
    occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    occupied[tuple(cells.T)] = True
    return wrap_cells(occupied, lower, size, _SIMPLER_SHELL)


def sample_surface(mesh: Mesh, spacing: float) -> Float[np.ndarray, "N 3"]:
    """Sample points on the triangles, nowhere farther from each other than ``spacing`` [m]."""
    corners = mesh.vertices[mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.maximum(1, np.ceil(longest / spacing).astype(int))
    clouds = [mesh.vertices]
    for n in np.unique(steps):
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
        u, v = i[i + j <= n] / n, j[i + j <= n] / n
        weights = np.column_stack([1.0 - u - v, u, v])
        clouds.append(np.einsum("kc,fcx->fkx", weights, corners[steps == n]).reshape(-1, 3))
    return np.concatenate(clouds)


def simplify_mesh(mesh: Mesh, n_triangles: int, stray: float) -> Mesh:
    """Reduce a closed mesh to about ``n_triangles``; unchanged if the simpler mesh would not be closed.

    Args:
        mesh: closed, wound outwards.
        n_triangles: to come down to where ``stray`` allows it.
        stray: how far the simpler surface may lie from the mesh, roughly [m].
    """
    if len(mesh.triangles) <= max(n_triangles, 12):
        return mesh
    # open3d takes 0.7 s to import; small meshes do without.
    import open3d as o3d

    full = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    fewer = full.simplify_quadric_decimation(max(n_triangles, 12), maximum_error=stray**2)
    simpler = Mesh(np.asarray(fewer.vertices), np.asarray(fewer.triangles).astype(np.int64))
    return simpler if is_closed(simpler) and simpler.volume > 0.0 else mesh
