"""The ``scene`` section of a request: scan, floor, and obstacles of several shapes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, StrictBool, Tag
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.choices import Method, SensorModel, Unknown
from service.request.fields import (
    SECTION,
    FilePath,
    Floor,
    Label,
    Length,
    MapPoint,
    Message,
    Number,
    Point,
    Quaternion,
    Section,
    Size,
    Sizes,
    at_most,
    find_repeated,
)
from service.request.shapes import MOST_PARTS, PartRequest

MESH_SUFFIXES = (".stl", ".obj", ".ply")
"""Suffixes of mesh files that refer to no other files and can be uploaded."""


def _check_mirrored(value: object) -> object:
    """Refuse a negative scale, which mirrors along all axes at once: no object is made so."""
    if isinstance(value, int | float) and not isinstance(value, bool) and value < 0.0:
        raise PydanticCustomError(
            "scale", "expected more than 0; scale_xyz: [1, -1, 1] mirrors the mesh along its y axis"
        )
    return value


def _check_factor(value: float) -> float:
    """Refuse a factor of a mesh by which nothing is left of it, or by which it is no object of a scene."""
    if not LEAST_FACTOR <= abs(value) <= 1.0 / LEAST_FACTOR:
        raise PydanticCustomError(
            "scale",
            "expected a factor of {least} to {most}, or its negative to mirror",
            {"least": "0.001", "most": "1000"},
        )
    return value


LEAST_FACTOR = 1e-3  # of a mesh along an axis
_Scale = Annotated[Length, BeforeValidator(_check_mirrored)]
_Factor = Annotated[Number, AfterValidator(_check_factor)]


@dataclass(config=SECTION)
class _Placed(Section):
    name: Label
    position: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def lengths(self) -> tuple[float, ...]:
        """Edge lengths of a box; radius and, if it has one, height of a round shape [m]; empty for others."""
        fields = vars(self)
        return (*fields.get("size", ()), *(fields[name] for name in ("radius", "height") if name in fields))


@dataclass(config=SECTION, kw_only=True)
class BoxRequest(_Placed):
    """A box with edge lengths ``size``, its centre at ``position``."""

    type: Literal["box"]
    size: Sizes


@dataclass(config=SECTION, kw_only=True)
class SphereRequest(_Placed):
    """A sphere."""

    type: Literal["sphere"]
    radius: Size


@dataclass(config=SECTION, kw_only=True)
class CylinderRequest(_Placed):
    """A cylinder of length ``height`` along its own z axis, its centre at ``position``."""

    type: Literal["cylinder"]
    radius: Size
    height: Size


@dataclass(config=SECTION, kw_only=True)
class CapsuleRequest(_Placed):
    """A cylinder of length ``height`` along its own z axis with a half sphere on either end."""

    type: Literal["capsule"]
    radius: Size
    height: Size


@dataclass(config=SECTION, kw_only=True)
class ConvexRequest(_Placed):
    """The convex hull of ``points``."""

    type: Literal["convex"]
    points: Annotated[tuple[Point, ...], Field(min_length=4), at_most(10_000)]


@dataclass(config=SECTION, kw_only=True)
class MeshRequest(_Placed):
    """A mesh file (STL, OBJ, PLY, DAE, GLB, glTF, or a URDF with every joint at zero), split into convex pieces.

    ``scale`` is metres per unit of the file, ``scale_xyz`` further factors along its axes, negative to mirror it.
    Without ``decompose`` the mesh's hull is the only piece.  With ``match`` its pose is searched in the scan near the
    given one, and points on or inside the mesh do not become pieces.
    """

    type: Literal["mesh"]
    file: FilePath
    scale: _Scale = 1.0
    scale_xyz: tuple[_Factor, _Factor, _Factor] = (1.0, 1.0, 1.0)
    decompose: StrictBool = True
    match: StrictBool = False


@dataclass(config=SECTION, kw_only=True)
class CarriedMesh(_Placed):
    """A mesh file of something that links carry or hands take, as of a ``MeshRequest``; planning reads it once."""

    type: Literal["mesh"]
    file: FilePath
    scale: _Scale = 1.0
    scale_xyz: tuple[_Factor, _Factor, _Factor] = (1.0, 1.0, 1.0)


@dataclass(config=SECTION, kw_only=True)
class _Obstacle:
    """A shape that a scan may show as well.

    With ``in_scan``, points of the scan on or inside it do not become pieces: it stands in their place.
    """

    in_scan: StrictBool = False


@dataclass(config=SECTION, kw_only=True)
class BoxObstacle(BoxRequest, _Obstacle):
    """A box in the robot's way."""


@dataclass(config=SECTION, kw_only=True)
class SphereObstacle(SphereRequest, _Obstacle):
    """A sphere in the robot's way."""


@dataclass(config=SECTION, kw_only=True)
class CylinderObstacle(CylinderRequest, _Obstacle):
    """A cylinder in the robot's way."""


@dataclass(config=SECTION, kw_only=True)
class CapsuleObstacle(CapsuleRequest, _Obstacle):
    """A capsule in the robot's way."""


@dataclass(config=SECTION, kw_only=True)
class ConvexObstacle(ConvexRequest, _Obstacle):
    """A convex hull in the robot's way."""


ObstacleRequest = Annotated[
    BoxObstacle | SphereObstacle | CylinderObstacle | CapsuleObstacle | ConvexObstacle | MeshRequest,
    Field(discriminator="type"),
]
CutRequest = Annotated[
    BoxRequest | SphereRequest | CylinderRequest | CapsuleRequest | ConvexRequest, Field(discriminator="type")
]


@dataclass(config=SECTION)
class GraspRequest(Section):
    """Pose of a hand's tool frame in the frame of an object that it holds; the tool's z axis points along the hand."""

    position: Point
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(config=SECTION, kw_only=True)
class _Movable:
    """An object that hands may take: its mass, evenly spread, and grasps by which they may hold it.

    Without grasps they are generated from its shape.
    """

    mass_kg: Annotated[Number, Field(gt=0.0, le=1000.0)]
    grasps: Annotated[tuple[GraspRequest, ...], at_most(50)] = ()


@dataclass(config=SECTION, kw_only=True)
class MovableBox(BoxRequest, _Movable):
    """A box that hands may take."""


@dataclass(config=SECTION, kw_only=True)
class MovableCylinder(CylinderRequest, _Movable):
    """A cylinder that hands may take."""


@dataclass(config=SECTION, kw_only=True)
class MovableConvex(ConvexRequest, _Movable):
    """A convex hull that hands may take."""


@dataclass(config=SECTION, kw_only=True)
class MovableMesh(CarriedMesh, _Movable):
    """A convex mesh that hands may take; planning reads the corners of its hull into ``points``."""

    points: Annotated[tuple[Point, ...], at_most(10_000)] = ()


ObjectRequest = Annotated[MovableBox | MovableCylinder | MovableConvex | MovableMesh, Field(discriminator="type")]


@dataclass(config=SECTION)
class CloudFileRequest(Section):
    """One of several cloud files, with the pose from its points' frame to the world."""

    file: FilePath
    position: MapPoint = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def transform(self) -> tuple[float, ...] | None:
        """Position and quaternion; None if the points are in the world frame."""
        pose = (*self.position, *self.quaternion_wxyz)
        return None if pose == (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0) else pose


def _path_or_list(value: object) -> str | None:
    return "path" if isinstance(value, str) else "list" if isinstance(value, list | tuple) and value else None


CloudRequest = Annotated[
    Annotated[FilePath, Tag("path")] | Annotated[tuple[CloudFileRequest, ...], at_most(64), Tag("list")],
    Discriminator(
        _path_or_list,
        custom_error_type="cloud",
        custom_error_message="a file, or a list of {file, position, quaternion_wxyz}, is needed",
    ),
]


@dataclass(config=SECTION)
class SceneRequest(Section):
    """Surroundings of the robot: a scan or a scene made from one, obstacles, or both.

    Attributes:
        file: a scene file of ``scopt scene``; its pieces and its valve are used unchanged.
        cloud: point cloud file, or several with their poses, which are merged.
        unit: length unit of the files.
        apply_viewpoint: whether the points are in the sensor's frame and must be transformed by the file's VIEWPOINT,
            before ``position`` and ``quaternion_wxyz``.
        sensor: start of the rays in the world if the file does not give it [m].
        level: whether the merged cloud is turned z up and its floor put at 0, after ``position`` and
            ``quaternion_wxyz``.
        sensor_model: kind of sensor, for its noise; ``auto``: by the file, or estimated from the points.
        sensor_sigma: standard deviation of the start of the rays [m].
        topic: topic of a bag with several clouds.
        message: index of a bag's message, or ``all`` to merge them.
        method: method of making pieces from the scan.
        unknown: treatment of space that no ray has seen.
        hint: a point in the world near the object of the task.
        obstacles: shapes with unique names.
        cuts: shapes with unique names that are no obstacles; points of the scan on or inside them do not become pieces.
        objects: movable objects with unique names; what the task does not move is an obstacle.
        floor: a height [m], or whether there is a floor at 0 (a scan provides its own); by default true for a robot
            with a free base.
    """

    file: FilePath | None = None
    cloud: CloudRequest | None = None
    unit: Literal["m", "cm", "mm", "km", "in", "ft"] = "m"
    apply_viewpoint: StrictBool = False
    sensor: Point | None = None
    level: StrictBool = False
    sensor_model: SensorModel = "auto"
    sensor_sigma: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.0
    topic: Label | None = None
    message: Message = 0
    method: Method = "planes"
    unknown: Unknown = "free"
    hint: Point | None = None
    obstacles: Annotated[tuple[ObstacleRequest, ...], at_most(1000)] = ()
    cuts: Annotated[tuple[CutRequest, ...], at_most(100)] = ()
    floor: Floor | None = None
    objects: Annotated[tuple[ObjectRequest, ...], at_most(100)] = ()

    @property
    def cloud_files(self) -> tuple[CloudFileRequest, ...]:
        """The cloud files; empty without a cloud."""
        if self.cloud is None:
            return ()
        return (CloudFileRequest(self.cloud),) if isinstance(self.cloud, str) else self.cloud

    @property
    def taken_out(self) -> tuple[CutRequest, ...]:
        """Shapes whose points in the scan do not become pieces."""
        given = (shape for shape in self.obstacles if not isinstance(shape, MeshRequest) and shape.in_scan)
        return (*given, *self.cuts)

    def __post_init__(self) -> None:
        twice = find_repeated(obstacle.name for obstacle in self.obstacles)
        if twice:
            raise PydanticCustomError("obstacles", "obstacle name {name} is given twice", {"name": shown(twice[0])})
        twice = find_repeated(named.name for named in (*self.obstacles, *self.objects))
        if twice:
            raise PydanticCustomError("objects", "object name {name} is given twice", {"name": shown(twice[0])})
        twice = find_repeated(cut.name for cut in self.cuts)
        if twice:
            raise PydanticCustomError("cuts", "cut name {name} is given twice", {"name": shown(twice[0])})
        if self.taken_out and not self.cloud:
            words = "{name} is taken out of a scan; give scene.cloud, or leave in_scan and cuts out"
            raise PydanticCustomError("cuts", words, {"name": shown(self.taken_out[0].name)})
        if self.file is not None and self.cloud is not None:
            raise PydanticCustomError("file", "file and cloud exclude each other: a scene was made of its own scan")
        if self.unknown == "occupied" and not self.cloud:
            raise PydanticCustomError("unknown", "unknown: occupied needs a scan that says what was seen; give cloud")
        lost = [mesh.name for mesh in self.obstacles if isinstance(mesh, MeshRequest) and mesh.match]
        if lost and not self.cloud:
            raise PydanticCustomError(
                "obstacles", "match of {name} needs a scan to look in; give scene.cloud", {"name": shown(lost[0])}
            )


@dataclass(config=SECTION)
class KnownMeshRequest(Section):
    """An object of known shape, as for ``scopt scene --mesh`` and ``scopt detect --object``: a file, or parts.

    Attributes:
        file: STL, OBJ, PLY, URDF or object file.
        name: name of its pieces and hits; by default the file's, or the type of the first part.
        scale: metres per unit of the file or of the parts.
        position: its position, or the position to search around; by default the whole scan is searched.
        quaternion_wxyz: its rotation; by default all rotations are searched, and a placed mesh is not rotated.
        is_placed: whether this pose is exact; else the pose is found in the scan.
        parts: its shape by parameters, in place of a file.
    """

    file: FilePath | None = None
    name: Label | None = None
    scale: Annotated[Number, Field(ge=1e-6, le=1e6)] = 1.0
    position: Point | None = None
    quaternion_wxyz: Quaternion | None = None
    is_placed: StrictBool = False
    parts: Annotated[tuple[PartRequest, ...], at_most(MOST_PARTS)] = ()

    def __post_init__(self) -> None:
        if (self.file is None) == (not self.parts):
            raise PydanticCustomError("known_mesh", "give either a file or parts")
        if self.position is None and (self.quaternion_wxyz is not None or self.is_placed):
            raise PydanticCustomError("known_mesh", "a pose needs a position; give position as well")
        if self.name is not None and "/" in self.name:
            raise PydanticCustomError(
                "known_mesh", "name: expected a name without '/', which separates the numbers of its pieces"
            )


@dataclass(config=SECTION)
class KnownRequest(Section):
    """Known objects of a scene, a scene file to update by the clouds, and objects to detect."""

    meshes: Annotated[tuple[KnownMeshRequest, ...], at_most(20)] = ()
    update: FilePath | None = None
    objects: Annotated[tuple[KnownMeshRequest, ...], at_most(20)] = ()

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all files as written in the request."""
        given = (*self.meshes, *self.objects)
        named = tuple(mesh.file for mesh in given if mesh.file is not None)
        return named if self.update is None else (*named, self.update)
