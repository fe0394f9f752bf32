"""What a user asks: the schema of a request file, as frozen dataclasses that check themselves.

Lengths in metres, angles in radians unless a suffix says otherwise, quaternions as w x y z, world frame z up.
Only what a request can tell by itself is checked here; ``service.setup`` checks it against the robot.
"""

from __future__ import annotations

import math
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictInt,
    StrictStr,
    model_validator,
)
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown, would_do

QUATERNION_NORM_TOLERANCE = 1e-3  # what rounding to a few digits explains
WORKSPACE_M = 1000.0  # a coordinate beyond this is a unit mistake (millimetres)

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Coordinate = Annotated[Number, Field(ge=-WORKSPACE_M, le=WORKSPACE_M)]
Length = Annotated[Number, Field(gt=0.0, le=WORKSPACE_M)]
Name = Annotated[StrictStr, Field(min_length=1, max_length=200)]
Point = tuple[Coordinate, Coordinate, Coordinate]


def _unit(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        w, x, y, z = quaternion
        unit = f"[{w / norm:.6g}, {x / norm:.6g}, {y / norm:.6g}, {z / norm:.6g}]" if norm > 1e-9 else "[1, 0, 0, 0]"
        raise PydanticCustomError(
            "quaternion",
            "a quaternion (w, x, y, z) needs length 1, not {norm}; {unit} would do",
            {"norm": f"{norm:.6g}", "unit": unit},
        )
    w, x, y, z = (component / norm for component in quaternion)
    return (w, x, y, z)


def _flag_or_height(value: object) -> object:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(value, bool) or (is_number and abs(float(value)) <= WORKSPACE_M):  # type: ignore[arg-type]
        return value
    raise PydanticCustomError("floor", "true, false or a height in metres would do")


def _single_line(name: str) -> str:
    if not name.isprintable():
        raise PydanticCustomError("name", "a name has no control characters")
    return name


Quaternion = Annotated[tuple[Number, Number, Number, Number], AfterValidator(_unit)]
Floor = Annotated[bool | float, BeforeValidator(_flag_or_height)]
Label = Annotated[Name, AfterValidator(_single_line)]
FilePath = Annotated[StrictStr, Field(min_length=1, max_length=4096), AfterValidator(_single_line)]

_CONFIG = ConfigDict(extra="forbid", frozen=True)


class _Section:
    """Refuses keys that are not fields, naming the ones that may have been meant."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            known = [f.name for f in fields(cls) if f.name != "folder"]  # type: ignore[arg-type]
            for key in data:
                if key not in known:
                    raise PydanticCustomError(
                        "unknown_key",
                        "unknown key {key}; {known} would do",
                        {"key": shown(key), "known": would_do(key, known)},
                    )
        return data


def _exactly_one(section: object, names: tuple[str, ...]) -> None:
    given = [name for name in names if getattr(section, name)]
    if len(given) != 1:
        raise PydanticCustomError(
            "exactly_one",
            "exactly one of {names} is needed, {given}",
            {"names": ", ".join(names), "given": f"not {' and '.join(given)}" if given else "none is given"},
        )


@dataclass(config=_CONFIG)
class RobotRequest(_Section):
    """Which robot: a bundled one by ``name``, or one read from ``urdf`` (and ``srdf``, ``package_dirs``).

    ``root`` says whether the base is free (by default a bundled robot's is, another's is not); ``tool_distance_m`` is
    how far the bundled robot's hook reaches from the hand's origin.
    """

    name: Label | None = None
    urdf: FilePath | None = None
    srdf: FilePath | None = None
    package_dirs: tuple[FilePath, ...] = ()
    root: Literal["floating", "fixed"] | None = None
    tool_distance_m: Annotated[Number, Field(ge=0.0, le=0.5)] | None = None

    def __post_init__(self) -> None:
        _exactly_one(self, ("name", "urdf"))
        if self.name is not None and (self.srdf or self.package_dirs):
            raise PydanticCustomError("robot", "srdf and package_dirs belong to a robot given by urdf, not by name")
        if self.urdf is not None and self.tool_distance_m is not None:
            raise PydanticCustomError("robot", "tool_distance_m belongs to a bundled robot given by name, not by urdf")


@dataclass(config=_CONFIG)
class PoseRequest(_Section):
    """A pose in the world."""

    position: Point
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(config=_CONFIG)
class StartRequest(_Section):
    """Where the robot stands at first: a named posture, overridden joint by joint.

    Joints come as ``joints`` (name to position) or as the two lists ``joint_names`` and ``positions``.
    """

    posture: Label | None = None
    joints: dict[Name, Number] = field(default_factory=dict)
    joint_names: tuple[Name, ...] = ()
    positions: tuple[Number, ...] = ()
    base: PoseRequest | None = None

    def __post_init__(self) -> None:
        if len(self.joint_names) != len(self.positions):
            raise PydanticCustomError(
                "start",
                "joint_names has {names} entries and positions has {positions}; they must be as many",
                {"names": len(self.joint_names), "positions": len(self.positions)},
            )
        twice = sorted({name for name in self.joint_names if name in self.joints or self.joint_names.count(name) > 1})
        if twice:
            raise PydanticCustomError("start", "joint {name} is given twice", {"name": shown(twice[0])})

    @property
    def positions_by_joint(self) -> dict[str, float]:
        """All joint positions that were given [rad, m]."""
        return {**self.joints, **dict(zip(self.joint_names, self.positions, strict=True))}


@dataclass(config=_CONFIG)
class _Placed(_Section):
    name: Label
    position: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(config=_CONFIG, kw_only=True)
class BoxRequest(_Placed):
    """A box with edge lengths ``size``, its centre at ``position``."""

    type: Literal["box"]
    size: tuple[Length, Length, Length]


@dataclass(config=_CONFIG, kw_only=True)
class SphereRequest(_Placed):
    """A sphere."""

    type: Literal["sphere"]
    radius: Length


@dataclass(config=_CONFIG, kw_only=True)
class CylinderRequest(_Placed):
    """A cylinder of length ``height`` along its own z axis, its centre at ``position``."""

    type: Literal["cylinder"]
    radius: Length
    height: Length


@dataclass(config=_CONFIG, kw_only=True)
class CapsuleRequest(_Placed):
    """A cylinder of length ``height`` along its own z axis with a half sphere on either end."""

    type: Literal["capsule"]
    radius: Length
    height: Length


@dataclass(config=_CONFIG, kw_only=True)
class ConvexRequest(_Placed):
    """The convex hull of ``points``."""

    type: Literal["convex"]
    points: Annotated[tuple[Point, ...], Field(min_length=4, max_length=10_000)]


@dataclass(config=_CONFIG, kw_only=True)
class MeshRequest(_Placed):
    """A mesh file (STL, OBJ, PLY), split into convex pieces."""

    type: Literal["mesh"]
    file: FilePath


ObstacleRequest = Annotated[
    BoxRequest | SphereRequest | CylinderRequest | CapsuleRequest | ConvexRequest | MeshRequest,
    Field(discriminator="type"),
]


@dataclass(config=_CONFIG)
class SceneRequest(_Section):
    """What surrounds the robot: a scan, obstacles, or both.

    Attributes:
        cloud: point cloud file.
        apply_viewpoint: whether the points are in the sensor's frame and its VIEWPOINT takes them to the world.
        hint: a point in the world near the object of the task.
        obstacles: shapes with unique names.
        floor: a height [m], or whether there is a floor at 0 (a scan brings its own); by default there is one for a
            robot with a free base.
    """

    cloud: FilePath | None = None
    apply_viewpoint: StrictBool = False
    hint: Point | None = None
    obstacles: Annotated[tuple[ObstacleRequest, ...], Field(max_length=1000)] = ()
    floor: Floor | None = None

    def __post_init__(self) -> None:
        names = [obstacle.name for obstacle in self.obstacles]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise PydanticCustomError("obstacles", "obstacle name {name} is given twice", {"name": shown(twice[0])})


@dataclass(config=_CONFIG)
class PoseGoalRequest(_Section):
    """A pose that ``link`` (a link or frame of the robot) has at the end; no quaternion leaves the orientation free."""

    link: Name
    position: Point
    quaternion_wxyz: Quaternion | None = None
    position_tolerance_m: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.001
    rotation_tolerance_deg: Annotated[Number, Field(ge=0.0, le=180.0)] = 0.5
    free_axis: Literal["none", "x", "y", "z"] = "none"

    def __post_init__(self) -> None:
        if self.free_axis != "none" and self.quaternion_wxyz is None:
            raise PydanticCustomError("pose", "free_axis needs a quaternion_wxyz whose axis it frees")


@dataclass(config=_CONFIG)
class GoalRequest(_Section):
    """Where the motion ends: joint positions, poses of links, or a named posture."""

    joints: dict[Name, Number] = field(default_factory=dict)
    poses: Annotated[tuple[PoseGoalRequest, ...], Field(max_length=20)] = ()
    posture: Label | None = None

    def __post_init__(self) -> None:
        _exactly_one(self, ("joints", "poses", "posture"))


@dataclass(config=_CONFIG)
class ValveRequest(_Section):
    """Turn a valve: detected in the scan (near ``hint``), or given by ``centre``, ``axis`` and ``radius``.

    Attributes:
        mode: ``hook`` rests a hook between the spokes, ``grasp`` turns the hand with the wheel.
        hand: which hand; ``auto`` tries both.
        turn_deg: positive turns counter-clockwise as seen by the robot.
        centre, axis, radius: the rim's centre-line circle, axis towards the robot [m].
    """

    mode: Literal["hook", "grasp"] = "hook"
    hand: Literal["left", "right", "auto"] = "auto"
    turn_deg: Annotated[Number, Field(ge=-360.0, le=360.0)] = 360.0
    hint: Point | None = None
    centre: Point | None = None
    axis: Point | None = None
    radius: Annotated[Number, Field(gt=0.0, le=2.0)] | None = None

    def __post_init__(self) -> None:
        if self.turn_deg == 0.0:
            raise PydanticCustomError("valve", "turn_deg is 0: nothing to do; -360 to 360 except 0 would do")
        if self.axis is not None and math.hypot(*self.axis) < 1e-6:
            raise PydanticCustomError("valve", "axis has no length; a direction such as [-1, 0, 0] would do")


@dataclass(config=_CONFIG)
class TaskRequest(_Section):
    """What to do."""

    valve: ValveRequest | None = None

    def __post_init__(self) -> None:
        _exactly_one(self, ("valve",))


@dataclass(config=_CONFIG)
class Options(_Section):
    """How to plan.

    Attributes:
        waypoints: per phase; left to the planner when absent.
        time_limit_s: wall time for the whole plan.
        margin_m: clearance aimed at.
        seed: of every random draw.
        balance_margin_m: how far inside the support polygon the balance point stays.
        feet: links planted at the start; the robot's own when absent.
        starts: how many starting trajectories are tried at most.
        qp: solver of the convex subproblems.
        velocity_scale, acceleration_scale: share of the robot's limits that is used.
    """

    waypoints: Annotated[StrictInt, Field(ge=3, le=500)] | None = None
    time_limit_s: Annotated[Number, Field(gt=0.0, le=3600.0)] = 60.0
    margin_m: Annotated[Number, Field(ge=0.0, le=0.5)] = 0.02
    seed: Annotated[StrictInt, Field(ge=0, lt=2**32)] = 0
    balance_margin_m: Annotated[Number, Field(ge=0.0, le=0.2)] = 0.02
    feet: Annotated[tuple[Name, ...], Field(max_length=8)] | None = None
    starts: Annotated[StrictInt, Field(ge=1, le=64)] = 4
    qp: Literal["piqp", "clarabel", "cvxpy"] = "piqp"
    velocity_scale: Annotated[Number, Field(gt=0.0, le=1.0)] = 1.0
    acceleration_scale: Annotated[Number, Field(gt=0.0, le=1.0)] = 1.0


@dataclass(config=_CONFIG)
class PlanRequest(_Section):
    """What a user asks: a robot, where it stands, what surrounds it, and where it shall go or what it shall do.

    ``folder`` is where relative paths start; it is no part of the request's meaning, of its JSON or of its hash.
    """

    robot: RobotRequest
    start: StartRequest = field(default_factory=StartRequest)
    scene: SceneRequest = field(default_factory=SceneRequest)
    goal: GoalRequest | None = None
    task: TaskRequest | None = None
    options: Options = field(default_factory=Options)
    folder: Annotated[Path, Field(exclude=True)] = field(default=Path(), compare=False)

    def __post_init__(self) -> None:
        _exactly_one(self, ("goal", "task"))

    def resolve(self, path: str) -> Path:
        """The file or folder that ``path`` of this request means."""
        return self.folder / path
