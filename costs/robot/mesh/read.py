"""Reading of untrusted mesh files: OBJ, STL, Collada and glTF, of limited size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from costs.robot.errors import RobotError
from costs.robot.mesh.collada import read_collada
from costs.robot.mesh.gltf import read_gltf

MAX_MESH_BYTES = 32 * 1024 * 1024
MAX_MESH_VERTICES = 1_000_000
_FORMATS = (".obj", ".stl", ".dae", ".glb", ".gltf")
_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True)
class Mesh:
    """Triangles of a mesh file, in the file's units.

    Attributes:
        vertices: (V, 3).
        faces: (F, 3) indices of the corners.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


def read_bytes(path: Path, where: str) -> bytes:
    """Read a mesh file.

    Raises:
        RobotError: it is too large, or of a format that is not known.
    """
    if path.suffix.lower() not in _FORMATS:
        raise RobotError(
            f"{where}: mesh '{path.name}': format '{path.suffix}' is not read; convert it to .obj, .stl, .dae or .glb"
        )
    size = path.stat().st_size
    if size > MAX_MESH_BYTES:
        raise RobotError(f"{where}: mesh '{path.name}' has {size} bytes; at most {MAX_MESH_BYTES} are read")
    return path.read_bytes()


def read_vertices(path: Path, where: str, data: bytes | None = None) -> Float[np.ndarray, "V 3"]:
    """Read the vertices of an OBJ, STL, Collada or glTF file, in the file's units; Collada's and glTF's in metres.

    Args:
        path: of the file.
        where: names it in messages.
        data: the file's content, if it was read already.

    Raises:
        RobotError: for another format, a file that is too large, states a wrong size or holds NaN.
    """
    readers = {
        ".obj": _read_obj_vertices,
        ".stl": _read_stl_vertices,
        ".dae": _read_dae_vertices,
        ".glb": _read_gltf_vertices,
        ".gltf": _read_gltf_vertices,
    }
    vertices = readers[path.suffix.lower()](
        read_bytes(path, where) if data is None else data, f"{where}: mesh '{path.name}'"
    )
    _check(vertices, f"{where}: mesh '{path.name}'")
    return vertices


def read_mesh(path: Path, where: str) -> Mesh:
    """Read the triangles of an OBJ, STL, Collada or glTF file, in the file's units; Collada's and glTF's in metres.

    Raises:
        RobotError: as ``read_vertices``, and for faces that name vertices that are not there.
    """
    inside = f"{where}: mesh '{path.name}'"
    data = read_bytes(path, where)
    readers = {".obj": _read_obj, ".stl": _read_stl, ".dae": _read_dae, ".glb": _read_gltf, ".gltf": _read_gltf}
    mesh = readers[path.suffix.lower()](data, inside)
    _check(mesh.vertices, inside)
    if len(mesh.faces) and not 0 <= int(mesh.faces.min()) <= int(mesh.faces.max()) < len(mesh.vertices):
        raise RobotError(f"{inside} has a face whose corner is no vertex; repair it")
    return mesh


def _check(vertices: Float[np.ndarray, "V 3"], where: str) -> None:
    if len(vertices) < 3:
        raise RobotError(f"{where} has {len(vertices)} vertices; a body needs at least 3")
    if not np.all(np.isfinite(vertices)):
        raise RobotError(f"{where} has a vertex that is not finite; repair it")


def _read_dae(data: bytes, where: str) -> Mesh:
    return Mesh(*read_collada(data, where, MAX_MESH_VERTICES, MAX_MESH_BYTES))


def _read_dae_vertices(data: bytes, where: str) -> Float[np.ndarray, "V 3"]:
    vertices, _ = read_collada(data, where, MAX_MESH_VERTICES, MAX_MESH_BYTES)
    return vertices


def _read_gltf(data: bytes, where: str) -> Mesh:
    return Mesh(*read_gltf(data, where, MAX_MESH_VERTICES))


def _read_gltf_vertices(data: bytes, where: str) -> Float[np.ndarray, "V 3"]:
    return _read_gltf(data, where).vertices


def _read_obj_vertices(data: bytes, where: str) -> Float[np.ndarray, "V 3"]:
    return _read_vertex_lines(data, b"v", where)


def _read_obj(data: bytes, where: str) -> Mesh:
    """Read vertices and faces; a face with more than three corners becomes a fan."""
    vertices = _read_obj_vertices(data, where)
    corners: list[tuple[int, int, int]] = []
    seen = 0
    for line in data.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            seen += 1
        elif words[0] == b"f":
            try:
                index = [int(word.split(b"/", 1)[0]) for word in words[1:]]
            except ValueError:
                raise RobotError(f"{where}: a face line does not hold whole numbers") from None
            # Counted from 1; negative ones from the last vertex so far.
            index = [k - 1 if k > 0 else seen + k for k in index]
            corners += [(index[0], index[k], index[k + 1]) for k in range(1, len(index) - 1)]
            if len(corners) > MAX_MESH_VERTICES:
                raise RobotError(f"{where} has more than {MAX_MESH_VERTICES} triangles; simplify it")
    return Mesh(vertices, np.array(corners, dtype=int).reshape(-1, 3))


def _read_stl_vertices(data: bytes, where: str) -> Float[np.ndarray, "V 3"]:
    if len(data) >= 84:
        count = int.from_bytes(data[80:84], "little")
        if 84 + count * _STL_FACET.itemsize == len(data):
            if 3 * count > MAX_MESH_VERTICES:
                raise RobotError(f"{where} has more than {MAX_MESH_VERTICES} vertices; simplify it")
            facets = np.frombuffer(data, _STL_FACET, count, offset=84)
            return facets["corners"].reshape(-1, 3).astype(float)
    if not data.lstrip().startswith(b"solid"):
        raise RobotError(f"{where}: neither text STL nor a binary one of the length its header claims")
    return _read_vertex_lines(data, b"vertex", where)


def _read_stl(data: bytes, where: str) -> Mesh:
    vertices = _read_stl_vertices(data, where)
    return Mesh(vertices, np.arange(len(vertices) // 3 * 3).reshape(-1, 3))


def _read_vertex_lines(data: bytes, keyword: bytes, where: str) -> Float[np.ndarray, "V 3"]:
    """Read the coordinates of lines that begin with ``keyword``; only the first three numbers count."""
    values: list[float] = []
    for line in data.splitlines():
        words = line.split(None, 4)
        if not words or words[0] != keyword:
            continue
        try:
            x, y, z = (float(word) for word in words[1:4])
        except ValueError:
            raise RobotError(f"{where}: a vertex line does not hold three numbers") from None
        values += (x, y, z)
        if len(values) > 3 * MAX_MESH_VERTICES:
            raise RobotError(f"{where} has more than {MAX_MESH_VERTICES} vertices; simplify it")
    return np.array(values).reshape(-1, 3)
