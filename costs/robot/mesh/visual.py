"""What a robot looks like: the <visual> shapes of its URDF as triangles, simplified to a budget."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from costs.robot.elements.shapes import parse_shape
from costs.robot.errors import RobotError
from costs.robot.mesh.locate import resolve_mesh
from costs.robot.mesh.read import read_mesh
from costs.robot.urdf import Urdf

MAX_TRIANGLES = 60_000
MOST_BYTES = 128 * 2**20  # of all mesh files together
_LEAST_TRIANGLES = 200
_MOST_CELLS = 1 << 20  # vertices nearer than this share of the mesh's extent are the same
_FINEST = 256  # cells along the longest edge of a mesh's box


@dataclass(frozen=True)
class VisualMesh:
    """Triangles that a link looks like.

    Attributes:
        link: name of the link.
        vertices: (V, 3) in the link's frame [m].
        triangles: (F, 3) indices.
    """

    link: str
    vertices: Float[np.ndarray, "V 3"]
    triangles: Int[np.ndarray, "F 3"]


def read_visuals(urdf: Urdf, roots: Sequence[Path], max_triangles: int = MAX_TRIANGLES) -> tuple[VisualMesh, ...]:
    """Read the meshes of a URDF's visual shapes, simplified to about ``max_triangles`` in all.

    Shapes that are no meshes, and meshes that are missing or cannot be read, are left out: they are not needed to plan.
    """
    found: list[VisualMesh] = []
    read = 0
    for element in urdf.tree.findall("link"):
        link = element.get("name") or ""
        for shape_element in element.findall("visual"):
            with suppress(RobotError, OSError):
                shape = parse_shape(shape_element, link, [])
                if shape is None or shape.kind != "mesh":
                    continue
                _, path = resolve_mesh(shape.uri, roots, link)
                read += path.stat().st_size
                if read > MOST_BYTES:
                    return _simplify_all(found, max_triangles)
                mesh = read_mesh(path, link)
                pose = shape.pose_link_shape
                vertices = (mesh.vertices * shape.size) @ pose[:3, :3].T + pose[:3, 3]
                # A mirrored mesh has its triangles the other way round.
                faces = mesh.faces if np.prod(shape.size) > 0.0 else mesh.faces[:, ::-1]
                if len(faces):
                    found.append(VisualMesh(link, vertices, faces))
    return _simplify_all(found, max_triangles)


def _simplify_all(found: Sequence[VisualMesh], max_triangles: int) -> tuple[VisualMesh, ...]:
    """Simplify meshes; larger ones may keep more triangles."""
    extents = np.array([np.linalg.norm(np.ptp(mesh.vertices, axis=0)) for mesh in found])
    shares = extents / extents.sum() if len(found) else extents
    simple = []
    for mesh, share in zip(found, shares, strict=True):
        budget = max(_LEAST_TRIANGLES, int(share * max_triangles))
        vertices, triangles = simplify_mesh(mesh.vertices, mesh.triangles, budget)
        if len(triangles):
            simple.append(VisualMesh(mesh.link, vertices, triangles))
    return tuple(simple)


def simplify_mesh(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], max_triangles: int
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """Simplify a mesh by moving all vertices in one cell of a grid to their mean; finer cells while few remain.

    Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.
    """
    merged, triangles = _merge(vertices, triangles, _MOST_CELLS)
    if len(triangles) <= max_triangles:
        return merged, triangles
    cells = _FINEST
    while True:
        simple = _merge(merged, triangles, cells)
        if len(simple[1]) <= max_triangles or cells <= 4:
            return simple
        # Triangles go with the square of the number of cells.
        cells = max(4, min(cells - 1, int(0.95 * cells * np.sqrt(max_triangles / len(simple[1])))))


def _merge(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], cells: int
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """Merge vertices in one cell, with ``cells`` along the longest edge; triangles that lose a corner or repeat go."""
    low, extent = vertices.min(axis=0), max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    x, y, z = np.floor((vertices - low) * (cells / extent)).astype(np.int64).T
    _, owner = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
    owner = owner.ravel()
    count = np.bincount(owner)
    means = np.stack([np.bincount(owner, weights=column) / count for column in vertices.T], axis=1)
    moved = owner[triangles]
    moved = moved[(moved[:, 0] != moved[:, 1]) & (moved[:, 1] != moved[:, 2]) & (moved[:, 2] != moved[:, 0])]
    a, b, c = np.sort(moved, axis=1).T
    _, first = np.unique((a * len(means) + b) * len(means) + c, return_index=True)
    moved = moved[np.sort(first)]
    used, compact = np.unique(moved, return_inverse=True)
    return means[used], compact.reshape(-1, 3)
