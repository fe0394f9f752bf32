"""Schema of a request file, as frozen dataclasses that validate their fields.

Lengths in metres, angles in radians unless a suffix says otherwise, quaternions as w x y z, world frame z up.
Only the request itself is checked here; ``service.setup.prepare`` checks it against the robot.
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StrictInt
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.attached import AttachedRequest
from service.request.contact_patch import ContactPatchRequest
from service.request.fields import (
    HAND_FRICTION,
    LATER,
    MAX_JOINTS,
    SECTION,
    FilePath,
    Joints,
    Label,
    Name,
    Number,
    Point,
    Quaternion,
    Section,
    at_most,
    find_repeated,
    require_exactly_one,
)
from service.request.keep import KeepRequest, refuse_contradictions
from service.request.paces import PACES
from service.request.resume import Hash, ResumeRequest
from service.request.robot_parts import RobotHandRequest, RobotServoRequest, RobotTorqueRequest
from service.request.scene import SceneRequest
from service.request.tasks.kind import TaskKind, TaskSection
from service.request.tasks.reach import GoalRequest
from service.request.tasks.registry import REACH, TaskRequest

Friction = Annotated[Number, Field(ge=0.0, le=5.0)]


@dataclass(config=SECTION)
class RobotRequest(Section):
    """Robot: bundled (``name``), or read from ``urdf`` (with ``srdf``, ``package_dirs``).

    ``root`` is the joint of the base (by default floating for a bundled robot, else fixed; a planar one moves on the
    ground, a differential one without sliding sideways); ``tool_distance_m`` is the distance of the bundled robot's
    hook from the hand's origin; ``hand`` is what the bundled robot has on its hands.
    ``contacts`` are patches by name that may carry force, besides those of a bundled robot or in their place; ``hands``
    the hands of a robot that hold mechanisms. ``servo`` is the stiffness of its joints' servos, from which the expected
    sag of the centre of mass follows. ``locked`` joints are fixed at a position [rad, m]. ``torque`` says which torques
    are compared with the joints' limits, by default all. ``drawn_links`` are links of the URDF without a collision
    shape that get their drawn shapes as such; ``decompose`` are links of the URDF whose collision meshes are split
    into convex parts.
    """

    name: Label | None = None
    urdf: FilePath | None = None
    srdf: FilePath | None = None
    package_dirs: Annotated[tuple[FilePath, ...], at_most(20)] = ()
    root: Literal["floating", "planar", "differential", "fixed"] | None = None
    tool_distance_m: Annotated[Number, Field(ge=0.07, le=0.6)] | None = None
    contacts: Annotated[dict[Label, ContactPatchRequest], at_most(100)] = field(default_factory=dict)
    hand: Literal["hook", "gripper"] | None = None
    hands: Annotated[dict[Literal["left", "right"], RobotHandRequest], at_most(2)] = field(default_factory=dict)
    servo: RobotServoRequest | None = None
    locked: Joints = field(default_factory=dict)
    torque: RobotTorqueRequest | None = None
    drawn_links: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()
    decompose: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()

    def __post_init__(self) -> None:
        require_exactly_one(self, ("name", "urdf"))
        if self.name is not None and self.decompose:
            raise PydanticCustomError("robot", "decompose belongs to a robot given by urdf, not by name")
        if self.name is not None and self.drawn_links:
            raise PydanticCustomError("robot", "drawn_links belong to a robot given by urdf, not by name")
        if self.name is not None and (self.srdf or self.package_dirs):
            raise PydanticCustomError("robot", "srdf and package_dirs belong to a robot given by urdf, not by name")
        if self.urdf is not None and self.tool_distance_m is not None:
            raise PydanticCustomError("robot", "tool_distance_m belongs to a bundled robot given by name, not by urdf")
        if self.name is not None and self.root in ("planar", "differential"):
            raise PydanticCustomError(
                "robot", "root {root} belongs to a robot given by urdf, not by name", {"root": self.root}
            )
        if self.urdf is not None and self.hand is not None:
            raise PydanticCustomError("robot", "hand belongs to a bundled robot given by name, not by urdf")
        if self.hand == "gripper" and self.tool_distance_m is not None:
            raise PydanticCustomError("robot", "tool_distance_m is the length of a hook; hand is gripper")


@dataclass(config=SECTION)
class PoseRequest(Section):
    """A pose in the world."""

    position: Point
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(config=SECTION)
class StartRequest(Section):
    """Start of the robot: a named posture, with some joints overridden.

    Joints are given as ``joints`` (name to position) or as the two lists ``joint_names`` and ``positions``.
    ``rates`` are those of joints that move already, by name [rad/s, m/s].
    """

    posture: Label | None = None
    joints: Joints = field(default_factory=dict)
    joint_names: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()
    positions: Annotated[tuple[Number, ...], at_most(MAX_JOINTS)] = ()
    base: PoseRequest | None = None
    rates: Joints = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.joint_names) != len(self.positions):
            raise PydanticCustomError(
                "start",
                "joint_names has {names} entries and positions has {positions}; they must be as many",
                {"names": len(self.joint_names), "positions": len(self.positions)},
            )
        twice = find_repeated((*self.joint_names, *self.joints))
        if twice:
            raise PydanticCustomError("start", "joint {name} is given twice", {"name": shown(twice[0])})

    @property
    def positions_by_joint(self) -> dict[str, float]:
        """All given joint positions by name [rad, m]."""
        return {**self.joints, **dict(zip(self.joint_names, self.positions, strict=True))}


@dataclass(config=SECTION)
class StateRequest(Section):
    """State of a robot and of the mechanism it moves.

    Attributes:
        joints: position of every joint by name; or ``joint_names`` and ``positions``.
        base: pose of a floating base.
        mechanism: value of each joint of the task's mechanism [rad, m].
        contacts: planted links; by default those of the earlier plan.
        plan: hash of the plan that was executed, if known; another one is refused.
    """

    joints: Joints = field(default_factory=dict)
    joint_names: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()
    positions: Annotated[tuple[Number, ...], at_most(MAX_JOINTS)] = ()
    base: PoseRequest | None = None
    mechanism: Joints = field(default_factory=dict)
    contacts: Annotated[tuple[Name, ...], at_most(8)] | None = None
    plan: Hash | None = None


@dataclass(config=SECTION)
class Options(Section):
    """Options of planning.

    Attributes:
        waypoints: number per phase; chosen by the planner by default.
        time_limit_s: wall time for the whole plan; by default the plan is limited by processor time
            (``PlanRequest.limit_s``).
        margin_m: clearance aimed at.
        clearance_m: demanded distance of the robot from every obstacle that it may not touch; no certificate below it.
        sway_m, sway_deg: how far and by which angle something else that balances the robot lets its base move; within
            them clearance and reach hold.
        padding: what single links, carried bodies and obstacles add to the demanded distance of their pairs, by name: a
            pair of both demands the sum, at least ``clearance_m``.
        seed: seed of every random draw.
        balance_margin_m: smallest distance of the balance point from the support polygon's edges.
        feet: links planted at the start; by default the robot's feet.
        starts: largest number of starting trajectories.
        qp: solver of the convex subproblems.
        velocity_scale, acceleration_scale: share of the robot's limits that is used.
        jerk_scale: the same of the jerk limits, with which a joint reaches its acceleration limit within 0.1 s; no
            limit by default.
        tool_speed_m_s: largest speed of the hands' tools, or without hands of the last link of every chain.
        pace: how fast the motion goes, and what it leaves of torques and of the ZMP's room; by default
            ``velocity_scale`` and ``acceleration_scale`` alone say it.
        timed: whether the motion gets a time law; otherwise only the path is planned and certified.
        escape: whether to escape from a start in collision first instead of refusing it.
        hand_friction: least and largest coefficient between a hand and what it moves: contacts that stick hold at the
            least one, contacts that slide at every one.
    """

    waypoints: Annotated[StrictInt, Field(ge=3, le=500)] | None = None
    time_limit_s: Annotated[Number, Field(gt=0.0, le=3600.0)] | None = None
    margin_m: Annotated[Number, Field(ge=0.0, le=0.5)] = 0.02
    clearance_m: Annotated[Number, Field(ge=0.0, le=0.5)] = 0.0
    sway_m: Annotated[Number, Field(ge=0.0, le=0.2)] = 0.0
    sway_deg: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.0
    padding: Annotated[dict[Name, Annotated[Number, Field(gt=0.0, le=0.5)]], at_most(1000)] = field(
        default_factory=dict
    )
    seed: Annotated[StrictInt, Field(ge=0, lt=2**32)] = 0
    balance_margin_m: Annotated[Number, Field(ge=0.0, le=0.2)] = 0.02
    feet: Annotated[tuple[Name, ...], at_most(8)] | None = None
    starts: Annotated[StrictInt, Field(ge=1, le=1000)] = 1000
    qp: Literal["piqp", "clarabel", "cvxpy"] = "piqp"
    velocity_scale: Annotated[Number, Field(ge=1e-3, le=1.0)] = 0.5
    acceleration_scale: Annotated[Number, Field(ge=1e-3, le=1.0)] = 0.3
    jerk_scale: Annotated[Number, Field(ge=1e-3, le=1.0)] | None = None
    tool_speed_m_s: Annotated[Number, Field(ge=1e-3, le=10.0)] | None = None
    pace: Literal["careful", "normal", "fast"] | None = None
    timed: bool = True
    escape: bool = False
    hand_friction: tuple[Friction, Friction] = HAND_FRICTION

    def __post_init__(self) -> None:
        scales = ("velocity_scale", self.velocity_scale, 0.5), ("acceleration_scale", self.acceleration_scale, 0.3)
        other = [(name, value) for name, value, default in scales if value != default]
        if self.pace is not None and other:
            raise PydanticCustomError(
                "options",
                "{name} is {value} beside the pace {pace}, which sets it; leave one of them out",
                {"name": other[0][0], "value": f"{other[0][1]:g}", "pace": self.pace},
            )
        low, high = self.hand_friction
        if low > high:
            raise PydanticCustomError(
                "options",
                "hand_friction is {low} to {high}; expected the least coefficient first",
                {"low": f"{low:g}", "high": f"{high:g}"},
            )

    @property
    def speed_share(self) -> float:
        """Share of the robot's speed limits that is used."""
        return self.velocity_scale if self.pace is None else PACES[self.pace].velocity_scale

    @property
    def acceleration_share(self) -> float:
        """Share of the robot's acceleration limits that is used."""
        return self.acceleration_scale if self.pace is None else PACES[self.pace].acceleration_scale


@dataclass(config=SECTION)
class PlanRequest(Section):
    """A request: a robot, its start, its surroundings, and a goal or a task.

    ``keep`` lists relative poses to keep along the whole motion to a goal, ``attached`` the carried bodies;
    ``resume`` plans the rest of a task again from the start.
    Paths are relative to ``folder``, which is not part of the request's JSON or hash.
    """

    robot: RobotRequest
    start: StartRequest = field(default_factory=StartRequest)
    scene: SceneRequest = field(default_factory=SceneRequest)
    goal: GoalRequest | None = None
    task: Annotated[TaskRequest, LATER] | None = None
    keep: Annotated[tuple[KeepRequest, ...], at_most(8)] = ()
    attached: Annotated[tuple[AttachedRequest, ...], at_most(20)] = ()
    options: Options = field(default_factory=Options)
    resume: ResumeRequest | None = None
    folder: Annotated[Path, Field(exclude=True)] = field(default=Path(), compare=False)

    def __post_init__(self) -> None:
        require_exactly_one(self, ("goal", "task"))
        if self.task is not None and self.keep:
            raise PydanticCustomError("request", "keep belongs to a goal; a task knows itself what it holds")
        refuse_contradictions(self.keep)
        if self.resume is not None and not self.section.can_resume:
            words = "resume belongs to a goal or a task with phases; {field} has none"
            raise PydanticCustomError("request", words, {"field": self.kind.field})

    @property
    def kind(self) -> TaskKind:
        """The kind of what is to be done."""
        return REACH if self.task is None else self.task.kind

    @property
    def section(self) -> TaskSection:
        """The section that says what is to be done: the goal, or that of the task's kind."""
        if self.task is not None:
            return self.task.section
        assert self.goal is not None  # exactly one of them is given
        return self.goal

    @property
    def hand_servo(self) -> RobotServoRequest:
        """What is said of hands that meet a surface: the request's, or the defaults."""
        return RobotServoRequest() if self.robot.servo is None else self.robot.servo

    @property
    def end_rates(self) -> tuple[dict[str, float], dict[str, float]]:
        """Rates of the joints that move at the start and at the end of the motion, by name [rad/s, m/s]."""
        at_end = {} if self.goal is None else self.goal.rates
        start, end = ({name: rate for name, rate in rates.items() if rate} for rates in (self.start.rates, at_end))
        return start, end

    @property
    def limit_s(self) -> float:
        """Seconds that the plan may take: of wall time if the request states them, else of processor time."""
        if self.options.time_limit_s is not None:
            return self.options.time_limit_s
        return self.section.effort_s

    def resolve(self, path: str) -> Path:
        """Return a path of this request, resolved against its folder."""
        return self.folder / path
