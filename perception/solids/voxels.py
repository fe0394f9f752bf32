"""Closed surfaces with few triangles as input for CoACD: around occupied cells, and of meshes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from perception.solids.mesh import Mesh, is_closed

_SIMPLER = 0.1  # share of the triangles kept where the surface is smooth
_SIMPLER_SHELL = 0.01  # the same for shells, whose cells follow a surface without noise
_STRAY = 0.2  # largest distance of the simplified surface from the original one [cells]
_CELLS_ACROSS = 40
_SMALLEST_CELL = 0.003
_LARGEST_CELL = 0.02


def wrap_cells(
    occupied: Bool[np.ndarray, "X Y Z"], lower: Float[np.ndarray, "3"], size: float, simpler: float = _SIMPLER
) -> Mesh:
    """Return a closed surface, wound outwards, half-way between the centres of occupied and empty cells.

    Args:
        simpler: share of the triangles to keep where the surface is smooth.
    """
    # open3d takes 0.7 s to import; its flying edges are marching cubes without duplicate vertices.
    import open3d as o3d

    volume = np.ascontiguousarray(np.pad(occupied, 1).transpose(2, 1, 0), dtype=np.float32)
    made = o3d.t.geometry.TriangleMesh.create_isosurfaces(o3d.core.Tensor.from_numpy(volume), [0.5])
    vertices = (made.vertex.positions.numpy().astype(np.float64) - 0.5) * size + lower
    full = Mesh(vertices, made.triangle.indices.numpy().astype(np.int64))
    return simplify_mesh(full, int(simpler * len(full.triangles)), _STRAY * size)


def wrap_mesh(mesh: Mesh) -> Mesh:
    """Return a closed shell around the triangles of an open mesh, one to two cells (1/40 of its size) thick."""
    span = float(np.ptp(mesh.vertices, axis=0).max())
    size = float(np.clip(span / _CELLS_ACROSS, min(_SMALLEST_CELL, span / 8), max(_LARGEST_CELL, span / 256)))
    points = sample_surface(mesh, 0.5 * size)
    lower = points.min(axis=0) - 0.5 * size
    cells = np.floor((points - lower) / size).astype(np.int64)
    occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    occupied[tuple(cells.T)] = True
    return wrap_cells(occupied, lower, size, _SIMPLER_SHELL)


def sample_surface(mesh: Mesh, spacing: float) -> Float[np.ndarray, "N 3"]:
    """Return points on the triangles, at most ``spacing`` [m] apart."""
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
    """Return a closed mesh with about ``n_triangles``; the mesh itself if the simplified one is not closed.

    Args:
        mesh: closed, wound outwards.
        n_triangles: target number, reached where ``stray`` allows it.
        stray: approximate largest distance of the simplified surface from the mesh [m].
    """
    if len(mesh.triangles) <= max(n_triangles, 12):
        return mesh
    # open3d takes 0.7 s to import; small meshes do not need it.
    import open3d as o3d

    full = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    fewer = full.simplify_quadric_decimation(max(n_triangles, 12), maximum_error=stray**2)
    simpler = Mesh(np.asarray(fewer.vertices), np.asarray(fewer.triangles).astype(np.int64))
    return simpler if is_closed(simpler) and simpler.volume > 0.0 else mesh
