"""A result as a binary glTF file with animation, for any 3D program."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from service.viewer.files import replace_file
from service.viewer.hulls import make_convex_mesh
from service.viewer.movables import make_local_bodies, place_movables
from service.viewer.objects import list_object_bodies
from service.viewer.payload import sample_times, select_samples
from service.viewer.placements import LinkPlacements

Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Rotation (xyzw) of the root node: world z up to glTF's y up."""

_FLOAT = 5126  # the format's number of the type of all that is in the buffer

COLOURS: Mapping[str, tuple[float, float, float, float]] = {
    "robot": (0.55, 0.60, 0.68, 1.0),
    "left": (0.05, 0.55, 0.50, 1.0),
    "right": (0.85, 0.50, 0.05, 1.0),
    "floor": (0.80, 0.82, 0.86, 1.0),
    "piece": (0.35, 0.50, 0.75, 0.35),
    "movable": (0.85, 0.22, 0.08, 1.0),
}


def write_glb(result: Mapping[str, Any], placements: LinkPlacements, path: Path) -> None:
    """Write the scene and, with two samples or more, one animation named ``trajectory``.

    Links, pieces and movables become nodes of the same names.  Arguments as for ``write_viewer``.

    Raises:
        ValueError: placements and trajectory have different numbers of samples.
    """
    times = sample_times(result, placements)
    kept = select_samples(times, [int(index) for index in result.get("waypoints") or []])
    writer = _Writer()
    moving = [*_add_links(writer, result, placements, kept), *_add_movables(writer, result, len(times), kept)]
    for piece in result.get("pieces") or []:
        material = "floor" if piece.get("kind") == "floor" else "piece"
        writer.add_node(str(piece["name"]), [(piece["vertices"], material)])
    if len(kept) > 1:
        writer.animate(times[kept] - times[kept[0]], moving)
    replace_file(path, writer.finish())


def _add_links(
    writer: _Writer, result: Mapping[str, Any], placements: LinkPlacements, kept: Shaped[np.ndarray, "F"]
) -> list[tuple[int, Float[np.ndarray, "F 7"]]]:
    """Add a node per link with bodies; return the nodes and their poses, none without samples."""
    if len(kept) == 0:
        return []
    moving = []
    bodies = (*(result.get("bodies") or []), *list_object_bodies(result))
    for column, link in enumerate(placements.links):
        shapes = [(body["vertices"], _choose_material(link)) for body in bodies if body["link"] == link]
        if shapes:
            poses = placements.poses[kept, column]
            moving.append((writer.add_node(link, shapes, poses[0]), poses))
    return moving


def _add_movables(
    writer: _Writer, result: Mapping[str, Any], n_samples: int, kept: Shaped[np.ndarray, "F"]
) -> list[tuple[int, Float[np.ndarray, "F 7"]]]:
    """Add a node per movable; return the nodes and their poses in the world."""
    movables = result.get("movables") or []
    placed = place_movables(movables, n_samples).poses
    moving = []
    for column, movable in enumerate(movables):
        poses = placed[kept, column] if len(kept) else placed[:, column]
        shapes = [(body["vertices"], "movable") for body in make_local_bodies(movable)]
        moving.append((writer.add_node(str(movable["name"]), shapes, poses[0]), poses))
    return moving


def _choose_material(link: str) -> str:
    if any(part in link for part in ("hand", "foot", "hook")):
        if link.startswith(("l_", "left")):
            return "left"
        if link.startswith(("r_", "right")):
            return "right"
    return "robot"


class _Writer:
    """Writer of one document of glTF 2.0: its lists of nodes, meshes and the like, and its buffer."""

    def __init__(self) -> None:
        self._children: list[int] = []
        self._lists: dict[str, list[dict[str, Any]]] = {
            "nodes": [{"name": "world", "rotation": Y_UP, "children": self._children}],
            "scenes": [{"nodes": [0]}],
        }
        self._materials: dict[str, int] = {}
        self._blob = bytearray()

    def add_node(self, name: str, shapes: Sequence[tuple[Any, str]], pose: Float[np.ndarray, "7"] | None = None) -> int:
        """Add a child of the root with the hulls of ``shapes`` (vertices, material) at a pose; return its index."""
        primitives = [primitive for vertices, colour in shapes if (primitive := self._add_primitive(vertices, colour))]
        node: dict[str, Any] = {"name": name}
        if primitives:
            node["mesh"] = self._add("meshes", {"name": name, "primitives": primitives})
        if pose is not None:
            node |= {"translation": pose[:3].tolist(), "rotation": pose[[4, 5, 6, 3]].tolist()}
        self._children.append(self._add("nodes", node))
        return self._children[-1]

    def animate(self, times: Float[np.ndarray, "F"], moving: Sequence[tuple[int, Float[np.ndarray, "F 7"]]]) -> None:
        """Add an animation that moves nodes along their poses (``x y z qw qx qy qz``, signs continuous)."""
        if not moving:
            return
        clock = self._add_accessor(times.astype(np.float32), "SCALAR", with_bounds=True)
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        for node, poses in moving:
            # Translation and rotation (xyzw) of one node share its clock.
            for target, columns, kind in (("translation", [0, 1, 2], "VEC3"), ("rotation", [4, 5, 6, 3], "VEC4")):
                output = self._add_accessor(poses[:, columns].astype(np.float32), kind)
                channels.append({"sampler": len(samplers), "target": {"node": node, "path": target}})
                samplers.append({"input": clock, "output": output, "interpolation": "LINEAR"})
        self._add("animations", {"name": "trajectory", "samplers": samplers, "channels": channels})

    def finish(self) -> bytes:
        """Return the document and its buffer as a binary glTF file."""
        if self._blob:
            self._add("buffers", {"byteLength": len(self._blob)})
        document = {"asset": {"version": "2.0", "generator": "scopt"}, "scene": 0, **self._lists}
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        chunks = [_make_chunk(b"JSON", text, b" ")]
        if self._blob:
            chunks.append(_make_chunk(b"BIN\0", bytes(self._blob), b"\0"))
        return struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks)

    def _add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append an entry to a list of the document, which has no empty ones, and return its index."""
        entries = self._lists.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def _add_primitive(self, vertices: Any, material: str) -> dict[str, Any] | None:
        """Add a flat-shaded hull; None for a set too thin to have a surface."""
        mesh = make_convex_mesh(np.asarray(vertices, dtype=float))
        if len(mesh.triangles) == 0:
            return None
        corners = mesh.vertices[mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        position = self._add_accessor(corners.reshape(-1, 3).astype(np.float32), "VEC3", with_bounds=True)
        normal = self._add_accessor(np.repeat(normals, 3, axis=0).astype(np.float32), "VEC3")
        return {"attributes": {"POSITION": position, "NORMAL": normal}, "material": self._find_material(material)}

    def _find_material(self, name: str) -> int:
        if name not in self._materials:
            colour = list(COLOURS[name])
            surface = {"baseColorFactor": colour, "metallicFactor": 0.05, "roughnessFactor": 0.7}
            blend = "BLEND" if colour[3] < 1.0 else "OPAQUE"
            material = {"name": name, "pbrMetallicRoughness": surface, "alphaMode": blend}
            self._materials[name] = self._add("materials", material)
        return self._materials[name]

    def _add_accessor(self, array: Shaped[np.ndarray, "N ..."], kind: str, with_bounds: bool = False) -> int:
        """Append float32 rows to the buffer with a view and an accessor; return the accessor's index."""
        data = np.ascontiguousarray(array, dtype="<f4")
        view = self._add("bufferViews", {"buffer": 0, "byteOffset": len(self._blob), "byteLength": data.nbytes})
        self._blob.extend(data.tobytes())
        accessor: dict[str, Any] = {"bufferView": view, "componentType": _FLOAT, "count": len(data), "type": kind}
        if with_bounds:
            rows = data.reshape(len(data), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self._add("accessors", accessor)


def _make_chunk(kind: bytes, data: bytes, filling: bytes) -> bytes:
    """Return a part of a binary glTF file, filled up to whole words."""
    data += filling * (-len(data) % 4)
    return struct.pack("<I4s", len(data), kind) + data
