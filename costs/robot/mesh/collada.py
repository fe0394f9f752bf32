"""Vertices and triangles of a Collada file (.dae), as robot descriptions use it.

Of the format only the geometry of the scene is read: meshes, the nodes that place them and the unit of length.  The
up axis is not applied, which is how ROS reads such files (z is up in a URDF whatever the file says).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from lxml import etree

from costs.robot.errors import RobotError
from costs.robot.poses import axis_rotation
from costs.robot.xmlfile import parse_xml

_MOST_LEVELS = 32  # of nodes that hold each other
_MOST_NODES = 4_000


def read_collada(
    data: bytes, where: str, most_vertices: int, most_bytes: int
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Read vertices [m] and triangles of all meshes of a file's scene.

    Args:
        data: content of the file.
        where: names it in messages.
        most_vertices: largest number of vertices, those of repeated meshes counted each time; the same of triangles.
        most_bytes: largest size of the file.

    Raises:
        RobotError: one line: not Collada, a reference to something that is not there, too many vertices.
    """
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise RobotError(f"{where}: not UTF-8 (byte {error.start}); export it again") from None
    tree = parse_xml(text, where, "COLLADA", most_bytes)
    unit = tree.find("asset/unit")
    scale = 1.0 if unit is None else _numbers(unit.get("meter", "1"), where)[0]
    if not 1e-6 <= scale <= 1e3:
        raise RobotError(f"{where}: its unit is {scale:g} m; expected 1e-6 to 1000")
    reader = _Reader(tree, where, most_vertices)
    reader.read_scene()
    if not reader.vertices:
        raise RobotError(f"{where}: no mesh in its scene; export the shape with its geometry")
    return scale * np.concatenate(reader.vertices), np.concatenate(reader.faces)


@dataclass
class _Reader:
    """Walk through a file's scene; ``vertices`` and ``faces`` collect what it shows."""

    tree: etree._Element
    where: str
    most: int
    vertices: list[Float[np.ndarray, "V 3"]] = field(default_factory=list)
    faces: list[Int[np.ndarray, "F 3"]] = field(default_factory=list)
    n_vertices: int = 0
    n_faces: int = 0
    n_nodes: int = 0

    def __post_init__(self) -> None:
        tags = ("geometry", "node", "visual_scene", "controller")
        self.by_id = {tag: {e.get("id"): e for e in self.tree.iter(tag) if e.get("id")} for tag in tags}
        self.meshes: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def read_scene(self) -> None:
        """Collect the meshes of the scene; of all geometries where the file has no scene."""
        instance = self.tree.find("scene/instance_visual_scene")
        scenes = (
            [self._find("visual_scene", instance)]
            if instance is not None
            else list(self.by_id["visual_scene"].values())
        )
        for scene in scenes:
            for node in scene.findall("node"):
                self._add_node(node, np.eye(4), 0)
        if not scenes:
            for name in self.by_id["geometry"]:
                self._add_geometry(name, np.eye(4))

    def _add_node(self, node: etree._Element, pose: Float[np.ndarray, "4 4"], level: int) -> None:
        self.n_nodes += 1
        if level > _MOST_LEVELS or self.n_nodes > _MOST_NODES:
            raise RobotError(f"{self.where}: its nodes hold each other too deeply or too often; export it flat")
        pose = pose @ self._read_pose(node)
        for child in node:
            if child.tag == "node":
                self._add_node(child, pose, level + 1)
            elif child.tag == "instance_node":
                self._add_node(self._find("node", child), pose, level + 1)
            elif child.tag == "instance_geometry":
                self._add_geometry(self._find("geometry", child).get("id", ""), pose)
            elif child.tag == "instance_controller":
                skin = self._find("controller", child).find("skin")
                if skin is not None:
                    bind = skin.findtext("bind_shape_matrix")
                    shape = np.eye(4) if bind is None else _matrix(bind, self.where)
                    self._add_geometry(skin.get("source", "").lstrip("#"), pose @ shape)

    def _add_geometry(self, name: str, pose: Float[np.ndarray, "4 4"]) -> None:
        if name not in self.by_id["geometry"]:
            raise RobotError(f"{self.where}: refers to the geometry '{name[:40]}', which is not there; export it again")
        if name not in self.meshes:
            self.meshes[name] = self._read_mesh(self.by_id["geometry"][name])
        points, faces = self.meshes[name]
        self.n_vertices += len(points)
        self.n_faces += len(faces)
        if max(self.n_vertices, self.n_faces) > self.most:
            raise RobotError(f"{self.where} has more than {self.most} vertices; simplify it")
        if len(points):
            self.faces.append(faces + self.n_vertices - len(points))
            self.vertices.append(points @ pose[:3, :3].T + pose[:3, 3])

    def _read_mesh(self, geometry: etree._Element) -> tuple[np.ndarray, np.ndarray]:
        """Return the points that a geometry's faces use (all of them without faces), and its triangles."""
        mesh = geometry.find("mesh")
        if mesh is None:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
        sources = {source.get("id"): source for source in mesh.findall("source")}
        positions = {v.get("id"): i.get("source", "").lstrip("#")
                     for v in mesh.findall("vertices") for i in v.findall("input")
                     if i.get("semantic") == "POSITION"}  # fmt: skip
        points: list[np.ndarray] = []
        faces: list[np.ndarray] = []
        count = 0
        for source in dict.fromkeys(positions.values()):
            if source not in sources:
                raise RobotError(
                    f"{self.where}: refers to the source '{source[:40]}', which is not there; export it again"
                )
            table = self._read_points(sources[source])
            for parts in self._list_faces(mesh, {key for key, name in positions.items() if name == source}):
                if len(parts) and not 0 <= int(parts.min()) <= int(parts.max()) < len(table):
                    raise RobotError(f"{self.where}: a face names a vertex that is not there; export it again")
                faces.append(parts + count)
            points.append(table)
            count += len(table)
        if not points:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
        all_points, all_faces = np.concatenate(points), np.concatenate([np.zeros((0, 3), dtype=int), *faces])
        if not len(all_faces):
            return all_points, all_faces
        used, compact = np.unique(all_faces, return_inverse=True)
        return all_points[used], compact.reshape(-1, 3)

    def _read_points(self, source: etree._Element) -> Float[np.ndarray, "V 3"]:
        array, accessor = source.find("float_array"), source.find("technique_common/accessor")
        values = _numbers("" if array is None else array.text or "", self.where)
        stride = 3 if accessor is None else int(_numbers(accessor.get("stride", "3"), self.where)[0])
        if stride < 3 or len(values) % stride or len(values) > 3 * self.most:
            raise RobotError(f"{self.where}: a list of {len(values)} coordinates in steps of {stride}; export it again")
        return values.reshape(-1, stride)[:, :3]

    def _list_faces(self, mesh: etree._Element, vertices: set[str | None]) -> Iterator[Int[np.ndarray, "F 3"]]:
        """Yield the triangles of the primitives that use one of these vertex lists; polygons become fans."""
        for tag in ("triangles", "polylist", "polygons", "trifans", "tristrips"):
            for primitive in mesh.findall(tag):
                inputs = primitive.findall("input")
                own = next((i for i in inputs if i.get("semantic") == "VERTEX"), None)
                if own is None or own.get("source", "").lstrip("#") not in vertices:
                    continue
                offsets = [int(_numbers(i.get("offset", "0"), self.where)[0]) for i in inputs]
                step, offset = max(offsets) + 1, int(_numbers(own.get("offset", "0"), self.where)[0])
                if not 0 <= offset < step <= 64:
                    raise RobotError(f"{self.where}: a list of faces with an offset of {offset}; export it again")
                for index in (_integers(p.text or "", self.where)[offset::step] for p in primitive.findall("p")):
                    yield _make_triangles(tag, index, primitive, self.where)

    def _read_pose(self, node: etree._Element) -> Float[np.ndarray, "4 4"]:
        pose = np.eye(4)
        readers: dict[str, Callable[[str], np.ndarray]] = {
            "matrix": lambda text: _matrix(text, self.where),
            "translate": self._translation,
            "rotate": self._rotation,
            "scale": lambda text: np.diag([*_numbers(text, self.where, 3), 1.0]),
        }
        for child in node:
            if child.tag in readers:
                pose = pose @ readers[child.tag](child.text or "")
        return pose

    def _translation(self, text: str) -> Float[np.ndarray, "4 4"]:
        pose = np.eye(4)
        pose[:3, 3] = _numbers(text, self.where, 3)
        return pose

    def _rotation(self, text: str) -> Float[np.ndarray, "4 4"]:
        x, y, z, angle_deg = _numbers(text, self.where, 4)
        pose, length = np.eye(4), float(np.linalg.norm([x, y, z]))
        if length > 0.0:
            pose[:3, :3] = axis_rotation(np.array([x, y, z]) / length, float(np.deg2rad(angle_deg)))
        return pose

    def _find(self, tag: str, instance: etree._Element) -> etree._Element:
        name = instance.get("url", "").lstrip("#")
        if name not in self.by_id[tag]:
            raise RobotError(f"{self.where}: refers to the {tag} '{name[:40]}', which is not there; export it again")
        return self.by_id[tag][name]


def _make_triangles(
    tag: str, index: Int[np.ndarray, "k"], primitive: etree._Element, where: str
) -> Int[np.ndarray, "F 3"]:
    if tag == "triangles":
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if tag == "tristrips":
        return np.stack([index[:-2], index[1:-1], index[2:]], axis=1) if len(index) > 2 else index[:0].reshape(-1, 3)
    counts = np.array([len(index)])
    if tag == "polylist":
        counts = _integers(primitive.findtext("vcount") or "", where)
        if counts.sum() != len(index) or (len(counts) and counts.min() < 0):
            raise RobotError(f"{where}: its faces have {counts.sum()} corners and name {len(index)}; export it again")
    # Face k with corners c_0 ... c_m gives the triangles (c_0, c_i, c_i+1).
    first = np.cumsum(counts) - counts
    inner = np.maximum(counts - 2, 0)
    start = np.repeat(first, inner)
    turn = np.arange(inner.sum()) - np.repeat(np.cumsum(inner) - inner, inner)
    return np.stack([index[start], index[start + turn + 1], index[start + turn + 2]], axis=1)


def _matrix(text: str, where: str) -> Float[np.ndarray, "4 4"]:
    return _numbers(text, where, 16).reshape(4, 4)


def _numbers(text: str, where: str, count: int | None = None) -> Float[np.ndarray, "k"]:
    """Return the numbers of a text, of which there have to be ``count``."""
    try:
        values = np.array(text.split(), dtype=float)
    except ValueError:
        raise RobotError(f"{where}: a list holds something that is not a number; export it again") from None
    if (
        (count is not None and len(values) != count)
        or (count is None and not len(values))
        or not np.all(np.isfinite(values))
    ):
        raise RobotError(
            f"{where}: a list of {len(values)} numbers is too short, too long or not finite; export it again"
        )
    return values


def _integers(text: str, where: str) -> Int[np.ndarray, "k"]:
    try:
        return np.array(text.split(), dtype=int)
    except (ValueError, OverflowError):
        raise RobotError(
            f"{where}: a list of faces holds something that is not a whole number; export it again"
        ) from None
