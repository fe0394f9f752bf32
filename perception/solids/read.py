"""Reader for mesh files (STL, OBJ, PLY); the file size is limited before anything is parsed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float

from perception.errors import MeshError
from perception.solids.mesh import MAX_TRIANGLES, Mesh

SUFFIXES = (".stl", ".obj", ".ply")
MAX_BYTES = 32 * 2**20
_LARGEST_M = 100.0
_SMALLEST_M = 1e-3


def read_mesh(path: Path | str, scale: float | Float[np.ndarray, "3"] = 1.0) -> Mesh:
    """Read the triangles of a mesh file, in metres; larger faces become triangle fans.

    Args:
        path: its suffix gives the format; text and binary STL are distinguished by content.
        scale: metres per unit of the file, one number or one for each axis; negative ones mirror.

    Raises:
        MeshError: names the file, the problem and what is expected.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise MeshError(f"{path.name}: format '{path.suffix}' is not read; expected {', '.join(SUFFIXES)}")
    mesh = _parse(_read_content(path), path)
    if not 1 <= len(mesh.triangles) <= MAX_TRIANGLES:
        what = "points but no triangles" if len(mesh.vertices) and not len(mesh.triangles) else ""
        what = what or f"{len(mesh.triangles)} triangles"
        raise MeshError(f"{path.name}: has {what}; expected 1 to {MAX_TRIANGLES} triangles")
    scaled = mesh.stretch(scale)
    if np.isfinite(scaled.vertices).all():
        _check_size(scaled, path)
    return scaled


def _read_content(path: Path) -> bytes:
    try:
        if not path.is_file():  # a pipe or a device would never end
            raise MeshError(f"{path.name}: {path} is not there or no regular file; a mesh file is needed")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise MeshError(f"{path.name}: has {size} bytes; at most {MAX_BYTES} are read, simplify it")
        return path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path.name}: cannot be read ({error.strerror})") from None


def _parse(data: bytes, path: Path) -> Mesh:
    import trimesh  # takes 0.4 s to import and is seldom needed

    kind = path.suffix.lower()[1:]
    options = {"skip_materials": True} if kind == "obj" else {}
    try:
        loaded = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False, **options)
        vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        triangles = np.asarray(loaded.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # a parser may raise anything for a broken file
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise MeshError(f"{path.name}: is no readable {kind.upper()} file ({reason}); repair or convert it") from None
    return Mesh(vertices, triangles)


def _check_size(mesh: Mesh, path: Path) -> None:
    span = float(np.ptp(mesh.vertices, axis=0).max())
    if span > _LARGEST_M:
        raise MeshError(
            f"{path.name}: spans {span:.0f} m; is it in millimetres? with scale 0.001 it would be {0.001 * span:.3g} m"
        )
    if span < _SMALLEST_M:
        raise MeshError(f"{path.name}: spans {span:.2g} m; give the scale that makes its units metres")
