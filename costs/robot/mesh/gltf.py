"""Vertices and triangles of a glTF file (.glb, or .gltf with its buffers embedded), as robot descriptions use it.

glTF has y up. As RViz, Drake and Meshcat do, it is turned so that z is up: (x, y, z) becomes (x, -z, y).
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from costs.robot.errors import RobotError

_MOST_NODES = 4_000
_GLB_MAGIC, _JSON_CHUNK = b"glTF", b"JSON"


def read_gltf(data: bytes, where: str, most_vertices: int) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Read vertices [m] and triangles of all meshes of a file's scene.

    Args:
        data: content of the file.
        where: names it in messages.
        most_vertices: largest number of vertices, those of repeated meshes counted each time; the same of triangles.

    Raises:
        RobotError: one line: not glTF, buffers in other files, no mesh, too many vertices.
    """
    is_binary = data[:4] == _GLB_MAGIC
    _check_content(_read_json(data, where) if is_binary else _parse_json(data, where), where, most_vertices)
    import trimesh  # takes 0.4 s to import and is seldom needed

    try:
        loaded = trimesh.load_scene(io.BytesIO(data), file_type="glb" if is_binary else "gltf", process=False)
        parts = [part for part in loaded.dump() if isinstance(part, trimesh.Trimesh)]
        vertices = [np.asarray(part.vertices, dtype=float).reshape(-1, 3) for part in parts]
        faces = [np.asarray(part.faces, dtype=int).reshape(-1, 3) for part in parts]
    except Exception as error:  # a parser may raise anything for a broken file
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise RobotError(f"{where}: is no readable glTF file ({reason}); repair or convert it") from None
    if not sum(len(part) for part in faces):
        raise RobotError(f"{where}: no mesh in its scene; export the shape with its geometry")
    if max(sum(len(part) for part in vertices), sum(len(part) for part in faces)) > most_vertices:
        raise RobotError(f"{where} has more than {most_vertices} vertices; simplify it")
    firsts = np.cumsum([0, *(len(part) for part in vertices[:-1])])
    x, y, z = np.concatenate(vertices).T
    return np.stack([x, -z, y], axis=1), np.concatenate([f + first for f, first in zip(faces, firsts, strict=True)])


def _read_json(data: bytes, where: str) -> dict[str, Any]:
    """Return the description in a binary file."""
    size = int.from_bytes(data[12:16], "little")
    if data[16:20] != _JSON_CHUNK or 20 + size > len(data):
        raise RobotError(f"{where}: a binary glTF file without its description; export it again")
    return _parse_json(data[20 : 20 + size], where)


def _parse_json(text: bytes, where: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise RobotError(f"{where}: neither binary nor text glTF; export it again") from None
    if not isinstance(content, dict):
        raise RobotError(f"{where}: its description is no JSON object; export it again")
    return content


def _check_content(content: dict[str, Any], where: str, most_vertices: int) -> None:
    """Refuse buffers that would be read from elsewhere, and sizes that a small file may claim."""
    buffers, nodes, accessors = (content.get(key) or [] for key in ("buffers", "nodes", "accessors"))
    for buffer in buffers:
        uri = buffer.get("uri") if isinstance(buffer, dict) else None
        if uri is not None and not str(uri).startswith("data:"):
            raise RobotError(f"{where}: its buffer '{str(uri)[:40]}' is another file; export it as .glb")
    if content.get("extensionsRequired"):
        names = ", ".join(str(name) for name in content["extensionsRequired"][:3])
        raise RobotError(f"{where}: needs the extensions {names}, which are not read; export it without compression")
    counts = [entry.get("count", 0) if isinstance(entry, dict) else 0 for entry in accessors]
    if any(not isinstance(count, int) or not 0 <= count <= 3 * most_vertices for count in counts):
        raise RobotError(f"{where} has more than {most_vertices} vertices; simplify it")
    children = [child for node in nodes if isinstance(node, dict) for child in node.get("children") or ()]
    if len(nodes) > _MOST_NODES or len({str(child) for child in children}) != len(children):
        raise RobotError(f"{where}: its scene is no tree of at most {_MOST_NODES} nodes; export it again")
