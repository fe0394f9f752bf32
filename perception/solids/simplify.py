"""Fewer triangles: CoACD's time goes with their number."""

from __future__ import annotations

import numpy as np

from perception.solids.closed import is_closed
from perception.solids.mesh import Mesh


def simplified(mesh: Mesh, n_triangles: int, stray: float) -> Mesh:
    """The closed mesh with about ``n_triangles``, or as it is where fewer would not be closed.

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
