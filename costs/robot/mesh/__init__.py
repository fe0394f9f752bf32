"""Mesh files that a URDF names: where they lie, their vertices and triangles, and convex hulls of them."""

from costs.robot.mesh.derived import Derived, DerivedCache, make_key
from costs.robot.mesh.locate import find_package_folders, resolve_mesh
from costs.robot.mesh.read import MAX_MESH_BYTES, Mesh, read_bytes, read_mesh, read_vertices

__all__ = [
    "MAX_MESH_BYTES",
    "Derived",
    "DerivedCache",
    "Mesh",
    "find_package_folders",
    "make_key",
    "read_bytes",
    "read_mesh",
    "read_vertices",
    "resolve_mesh",
]
