"""A result as a binary glTF file with animation, for any 3D program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
from jaxtyping import Float, Shaped

from service.viewer.files import replace_file
from service.viewer.hulls import make_convex_mesh
from service.viewer.movables import make_local_bodies, place_movables
from service.viewer.objects import list_object_bodies
from service.viewer.payload import sample_times, select_samples
from service.viewer.placements import LinkPlacements

Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Rotation (xyzw) of the root node: world z up to glTF's y up."""

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
    replace_file(path, b"".join(writer.finish().save_to_bytes()))


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
    """Writer of one glTF document: nodes, meshes and buffers."""

    def __init__(self) -> None:
        self._gltf = gltf.GLTF2(asset=gltf.Asset(version="2.0", generator="scopt"), scene=0)
        self._gltf.scenes = [gltf.Scene(nodes=[0])]
        self._gltf.nodes = [gltf.Node(name="world", rotation=Y_UP, children=[])]
        self._materials: dict[str, int] = {}
        self._blob = bytearray()

    def add_node(self, name: str, shapes: Sequence[tuple[Any, str]], pose: Float[np.ndarray, "7"] | None = None) -> int:
        """Add a child of the root with the hulls of ``shapes`` (vertices, material) at a pose; return its index."""
        primitives = [primitive for vertices, colour in shapes if (primitive := self._add_primitive(vertices, colour))]
        node = gltf.Node(name=name)
        if primitives:
            self._gltf.meshes.append(gltf.Mesh(name=name, primitives=primitives))
            node.mesh = len(self._gltf.meshes) - 1
        if pose is not None:
            node.translation, node.rotation = pose[:3].tolist(), pose[[4, 5, 6, 3]].tolist()
        self._gltf.nodes.append(node)
        index = len(self._gltf.nodes) - 1
        self._gltf.nodes[0].children.append(index)
        return index

    def animate(self, times: Float[np.ndarray, "F"], moving: Sequence[tuple[int, Float[np.ndarray, "F 7"]]]) -> None:
        """Add an animation that moves nodes along their poses (``x y z qw qx qy qz``, signs continuous)."""
        if not moving:
            return
        clock = self._add_accessor(times.astype(np.float32), gltf.SCALAR, with_bounds=True)
        animation = gltf.Animation(name="trajectory", samplers=[], channels=[])
        for node, poses in moving:
            # Translation and rotation (xyzw) of one node share its clock.
            for target, columns, kind in (("translation", [0, 1, 2], gltf.VEC3), ("rotation", [4, 5, 6, 3], gltf.VEC4)):
                output = self._add_accessor(poses[:, columns].astype(np.float32), kind)
                animation.samplers.append(gltf.AnimationSampler(input=clock, output=output, interpolation="LINEAR"))
                channel = gltf.AnimationChannelTarget(node=node, path=target)
                sampler = len(animation.samplers) - 1
                animation.channels.append(gltf.AnimationChannel(sampler=sampler, target=channel))
        self._gltf.animations.append(animation)

    def finish(self) -> gltf.GLTF2:
        """Return the document with its buffer."""
        self._gltf.buffers = [gltf.Buffer(byteLength=len(self._blob))]
        self._gltf.set_binary_blob(bytes(self._blob))
        return self._gltf

    def _add_primitive(self, vertices: Any, material: str) -> gltf.Primitive | None:
        """Add a flat-shaded hull; None for a set too thin to have a surface."""
        mesh = make_convex_mesh(np.asarray(vertices, dtype=float))
        if len(mesh.triangles) == 0:
            return None
        corners = mesh.vertices[mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        position = self._add_accessor(corners.reshape(-1, 3).astype(np.float32), gltf.VEC3, with_bounds=True)
        normal = self._add_accessor(np.repeat(normals, 3, axis=0).astype(np.float32), gltf.VEC3)
        attributes = gltf.Attributes(POSITION=position, NORMAL=normal)
        return gltf.Primitive(attributes=attributes, material=self._find_material(material))

    def _find_material(self, name: str) -> int:
        if name not in self._materials:
            colour = list(COLOURS[name])
            surface = gltf.PbrMetallicRoughness(baseColorFactor=colour, metallicFactor=0.05, roughnessFactor=0.7)
            blend = gltf.BLEND if colour[3] < 1.0 else gltf.OPAQUE
            self._gltf.materials.append(gltf.Material(name=name, pbrMetallicRoughness=surface, alphaMode=blend))
            self._materials[name] = len(self._gltf.materials) - 1
        return self._materials[name]

    def _add_accessor(self, array: Shaped[np.ndarray, "N ..."], kind: str, with_bounds: bool = False) -> int:
        """Append float32 rows to the buffer with a view and an accessor; return the accessor's index."""
        data = np.ascontiguousarray(array, dtype="<f4")
        view = gltf.BufferView(buffer=0, byteOffset=len(self._blob), byteLength=data.nbytes)
        self._blob.extend(data.tobytes())
        self._gltf.bufferViews.append(view)
        accessor = gltf.Accessor(
            bufferView=len(self._gltf.bufferViews) - 1, componentType=gltf.FLOAT, count=len(data), type=kind
        )
        if with_bounds:
            rows = data.reshape(len(data), -1)
            accessor.min, accessor.max = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self._gltf.accessors.append(accessor)
        return len(self._gltf.accessors) - 1
