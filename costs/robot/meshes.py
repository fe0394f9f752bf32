"""Safe search and reading of collision meshes that a URDF names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float

from costs.robot.errors import RobotError

MAX_MESH_BYTES = 32 * 1024 * 1024
MAX_MESH_VERTICES = 1_000_000
_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def resolve_mesh(uri: str, roots: Sequence[Path], where: str) -> tuple[str, Path]:
    """Find the key and real path of a mesh inside one of ``roots``.

    ``package://name/rest`` is searched as ``root/name/rest`` (or ``root/rest`` where root is itself the package),
    anything else as a path relative to a root. The key is the path a result folder stores the mesh under.

    Raises:
        RobotError: for ``file://`` and other schemes, absolute paths, paths that leave every root (also through
            symbolic links) and files that are not there.
    """
    scheme, separator, rest = uri.partition("://")
    if separator and scheme != "package":
        raise RobotError(f"{where}: mesh '{uri}': {scheme}:// is refused; use package:// or a relative path")
    relative = PurePosixPath(rest if separator else uri)
    if relative.is_absolute() or "\\" in uri or "\0" in uri:
        raise RobotError(f"{where}: mesh '{uri}' is not a relative path; use package:// or a relative path")
    if separator and ".." in relative.parts:
        raise RobotError(f"{where}: mesh '{uri}': '..' is refused in package://; name the package it lies in")
    escaped = False
    for root in roots:
        real_root = root.resolve()
        candidates = [real_root / relative]
        if separator and len(relative.parts) > 1 and relative.parts[0] == real_root.name:
            candidates.append(real_root.joinpath(*relative.parts[1:]))
        for candidate in candidates:
            path = candidate.resolve()
            if not path.is_relative_to(real_root):
                escaped = True
            elif path.is_file():
                key = relative.as_posix() if ".." not in relative.parts else path.relative_to(real_root).as_posix()
                return key, path
    folders = ", ".join(str(root) for root in roots) or "none"
    if escaped:
        raise RobotError(f"{where}: mesh '{uri}' lies outside the package folders ({folders}); add its folder to them")
    raise RobotError(f"{where}: mesh '{uri}' not found in the package folders ({folders}); add its folder to them")


def read_vertices(path: Path, where: str) -> Float[np.ndarray, "V 3"]:
    """Read the vertices of an OBJ or STL file, in the file's units.

    Raises:
        RobotError: for another format, a file that is too large, states a wrong size or holds NaN.
    """
    readers = {".obj": _read_obj, ".stl": _read_stl}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise RobotError(f"{where}: mesh '{path.name}': format '{path.suffix}' is not read; convert it to .obj or .stl")
    size = path.stat().st_size
    if size > MAX_MESH_BYTES:
        raise RobotError(f"{where}: mesh '{path.name}' has {size} bytes; at most {MAX_MESH_BYTES} are read")
    vertices = reader(path.read_bytes(), f"{where}: mesh '{path.name}'")
    if len(vertices) < 4:
        raise RobotError(f"{where}: mesh '{path.name}' has {len(vertices)} vertices; a body needs at least 4")
    if not np.all(np.isfinite(vertices)):
        raise RobotError(f"{where}: mesh '{path.name}' has a vertex that is not finite; repair it")
    return vertices


def _read_obj(data: bytes, where: str) -> Float[np.ndarray, "V 3"]:
    return _read_vertex_lines(data, b"v", where)


def _read_stl(data: bytes, where: str) -> Float[np.ndarray, "V 3"]:
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
