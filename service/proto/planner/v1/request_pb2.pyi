from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PatchKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PATCH_KIND_UNSPECIFIED: _ClassVar[PatchKind]
    PATCH_KIND_FOOT: _ClassVar[PatchKind]
    PATCH_KIND_TRUNK: _ClassVar[PatchKind]
    PATCH_KIND_ARM: _ClassVar[PatchKind]

class RootJoint(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ROOT_JOINT_UNSPECIFIED: _ClassVar[RootJoint]
    ROOT_JOINT_FLOATING: _ClassVar[RootJoint]
    ROOT_JOINT_FIXED: _ClassVar[RootJoint]
    ROOT_JOINT_PLANAR: _ClassVar[RootJoint]
    ROOT_JOINT_DIFFERENTIAL: _ClassVar[RootJoint]

class FreeAxis(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FREE_AXIS_UNSPECIFIED: _ClassVar[FreeAxis]
    FREE_AXIS_NONE: _ClassVar[FreeAxis]
    FREE_AXIS_X: _ClassVar[FreeAxis]
    FREE_AXIS_Y: _ClassVar[FreeAxis]
    FREE_AXIS_Z: _ClassVar[FreeAxis]

class CarryingHand(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CARRYING_HAND_UNSPECIFIED: _ClassVar[CarryingHand]
    CARRYING_HAND_LEFT: _ClassVar[CarryingHand]
    CARRYING_HAND_RIGHT: _ClassVar[CarryingHand]
    CARRYING_HAND_AUTO: _ClassVar[CarryingHand]
    CARRYING_HAND_BOTH: _ClassVar[CarryingHand]

class StepHand(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STEP_HAND_UNSPECIFIED: _ClassVar[StepHand]
    STEP_HAND_LEFT: _ClassVar[StepHand]
    STEP_HAND_RIGHT: _ClassVar[StepHand]
    STEP_HAND_BOTH: _ClassVar[StepHand]

class Along(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ALONG_UNSPECIFIED: _ClassVar[Along]
    ALONG_FREE: _ClassVar[Along]
    ALONG_LINE: _ClassVar[Along]
    ALONG_ARC: _ClassVar[Along]
    ALONG_JOINT_LINEAR: _ClassVar[Along]
    ALONG_JOINT_CUBIC: _ClassVar[Along]
    ALONG_JOINT_QUINTIC: _ClassVar[Along]

class StepFreeAxis(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STEP_FREE_AXIS_UNSPECIFIED: _ClassVar[StepFreeAxis]
    STEP_FREE_AXIS_NONE: _ClassVar[StepFreeAxis]
    STEP_FREE_AXIS_X: _ClassVar[StepFreeAxis]
    STEP_FREE_AXIS_Y: _ClassVar[StepFreeAxis]
    STEP_FREE_AXIS_Z: _ClassVar[StepFreeAxis]
    STEP_FREE_AXIS_ALL: _ClassVar[StepFreeAxis]

class OtherHand(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OTHER_HAND_UNSPECIFIED: _ClassVar[OtherHand]
    OTHER_HAND_KEEP: _ClassVar[OtherHand]
    OTHER_HAND_LOCK: _ClassVar[OtherHand]
    OTHER_HAND_FREE: _ClassVar[OtherHand]

class StepAxes(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STEP_AXES_UNSPECIFIED: _ClassVar[StepAxes]
    STEP_AXES_WORLD: _ClassVar[StepAxes]
    STEP_AXES_HAND: _ClassVar[StepAxes]

class CircleSense(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CIRCLE_SENSE_UNSPECIFIED: _ClassVar[CircleSense]
    CIRCLE_SENSE_CLOCKWISE: _ClassVar[CircleSense]
    CIRCLE_SENSE_COUNTER_CLOCKWISE: _ClassVar[CircleSense]

class ToolTurn(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TOOL_TURN_UNSPECIFIED: _ClassVar[ToolTurn]
    TOOL_TURN_FREE: _ClassVar[ToolTurn]
    TOOL_TURN_KEEP: _ClassVar[ToolTurn]

class BodyHands(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    BODY_HANDS_UNSPECIFIED: _ClassVar[BodyHands]
    BODY_HANDS_STAY: _ClassVar[BodyHands]
    BODY_HANDS_ALONG: _ClassVar[BodyHands]

class HoldMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HOLD_MODE_UNSPECIFIED: _ClassVar[HoldMode]
    HOLD_MODE_HOOK: _ClassVar[HoldMode]
    HOLD_MODE_GRASP: _ClassVar[HoldMode]

class HandKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HAND_KIND_UNSPECIFIED: _ClassVar[HandKind]
    HAND_KIND_HOOK: _ClassVar[HandKind]
    HAND_KIND_GRIPPER: _ClassVar[HandKind]

class TurnSense(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TURN_SENSE_UNSPECIFIED: _ClassVar[TurnSense]
    TURN_SENSE_GIVEN: _ClassVar[TurnSense]
    TURN_SENSE_UNKNOWN: _ClassVar[TurnSense]

class Hand(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HAND_UNSPECIFIED: _ClassVar[Hand]
    HAND_LEFT: _ClassVar[Hand]
    HAND_RIGHT: _ClassVar[Hand]
    HAND_AUTO: _ClassVar[Hand]

class Opens(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OPENS_UNSPECIFIED: _ClassVar[Opens]
    OPENS_PUSH: _ClassVar[Opens]
    OPENS_PULL: _ClassVar[Opens]
    OPENS_AUTO: _ClassVar[Opens]

class HingeSide(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HINGE_SIDE_UNSPECIFIED: _ClassVar[HingeSide]
    HINGE_SIDE_LEFT: _ClassVar[HingeSide]
    HINGE_SIDE_RIGHT: _ClassVar[HingeSide]
    HINGE_SIDE_AUTO: _ClassVar[HingeSide]

class HandleKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HANDLE_KIND_UNSPECIFIED: _ClassVar[HandleKind]
    HANDLE_KIND_LEVER: _ClassVar[HandleKind]
    HANDLE_KIND_PULL: _ClassVar[HandleKind]
    HANDLE_KIND_PUSH_BAR: _ClassVar[HandleKind]
    HANDLE_KIND_KNOB: _ClassVar[HandleKind]

class HandTool(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HAND_TOOL_UNSPECIFIED: _ClassVar[HandTool]
    HAND_TOOL_PEG: _ClassVar[HandTool]
    HAND_TOOL_TIP: _ClassVar[HandTool]
    HAND_TOOL_STUB: _ClassVar[HandTool]

class Side(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SIDE_UNSPECIFIED: _ClassVar[Side]
    SIDE_LEFT: _ClassVar[Side]
    SIDE_RIGHT: _ClassVar[Side]

class UnknownSpace(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    UNKNOWN_SPACE_UNSPECIFIED: _ClassVar[UnknownSpace]
    UNKNOWN_SPACE_FREE: _ClassVar[UnknownSpace]
    UNKNOWN_SPACE_OCCUPIED: _ClassVar[UnknownSpace]

class SensorModel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SENSOR_MODEL_UNSPECIFIED: _ClassVar[SensorModel]
    SENSOR_MODEL_AUTO: _ClassVar[SensorModel]
    SENSOR_MODEL_SPINNING: _ClassVar[SensorModel]
    SENSOR_MODEL_DEPTH: _ClassVar[SensorModel]
    SENSOR_MODEL_TOF: _ClassVar[SensorModel]
    SENSOR_MODEL_SOLID: _ClassVar[SensorModel]
    SENSOR_MODEL_SURVEY: _ClassVar[SensorModel]

class PieceMethod(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PIECE_METHOD_UNSPECIFIED: _ClassVar[PieceMethod]
    PIECE_METHOD_PLANES: _ClassVar[PieceMethod]
    PIECE_METHOD_COACD: _ClassVar[PieceMethod]

class LengthUnit(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    LENGTH_UNIT_UNSPECIFIED: _ClassVar[LengthUnit]
    LENGTH_UNIT_M: _ClassVar[LengthUnit]
    LENGTH_UNIT_CM: _ClassVar[LengthUnit]
    LENGTH_UNIT_MM: _ClassVar[LengthUnit]
    LENGTH_UNIT_KM: _ClassVar[LengthUnit]
    LENGTH_UNIT_IN: _ClassVar[LengthUnit]
    LENGTH_UNIT_FT: _ClassVar[LengthUnit]

class Shape(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SHAPE_UNSPECIFIED: _ClassVar[Shape]
    SHAPE_BOX: _ClassVar[Shape]
    SHAPE_SPHERE: _ClassVar[Shape]
    SHAPE_CYLINDER: _ClassVar[Shape]
    SHAPE_CAPSULE: _ClassVar[Shape]
    SHAPE_CONVEX: _ClassVar[Shape]
    SHAPE_MESH: _ClassVar[Shape]

class QpSolver(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    QP_SOLVER_UNSPECIFIED: _ClassVar[QpSolver]
    QP_SOLVER_PIQP: _ClassVar[QpSolver]
    QP_SOLVER_CLARABEL: _ClassVar[QpSolver]
    QP_SOLVER_CVXPY: _ClassVar[QpSolver]

class Pace(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PACE_UNSPECIFIED: _ClassVar[Pace]
    PACE_CAREFUL: _ClassVar[Pace]
    PACE_NORMAL: _ClassVar[Pace]
    PACE_FAST: _ClassVar[Pace]
PATCH_KIND_UNSPECIFIED: PatchKind
PATCH_KIND_FOOT: PatchKind
PATCH_KIND_TRUNK: PatchKind
PATCH_KIND_ARM: PatchKind
ROOT_JOINT_UNSPECIFIED: RootJoint
ROOT_JOINT_FLOATING: RootJoint
ROOT_JOINT_FIXED: RootJoint
ROOT_JOINT_PLANAR: RootJoint
ROOT_JOINT_DIFFERENTIAL: RootJoint
FREE_AXIS_UNSPECIFIED: FreeAxis
FREE_AXIS_NONE: FreeAxis
FREE_AXIS_X: FreeAxis
FREE_AXIS_Y: FreeAxis
FREE_AXIS_Z: FreeAxis
CARRYING_HAND_UNSPECIFIED: CarryingHand
CARRYING_HAND_LEFT: CarryingHand
CARRYING_HAND_RIGHT: CarryingHand
CARRYING_HAND_AUTO: CarryingHand
CARRYING_HAND_BOTH: CarryingHand
STEP_HAND_UNSPECIFIED: StepHand
STEP_HAND_LEFT: StepHand
STEP_HAND_RIGHT: StepHand
STEP_HAND_BOTH: StepHand
ALONG_UNSPECIFIED: Along
ALONG_FREE: Along
ALONG_LINE: Along
ALONG_ARC: Along
ALONG_JOINT_LINEAR: Along
ALONG_JOINT_CUBIC: Along
ALONG_JOINT_QUINTIC: Along
STEP_FREE_AXIS_UNSPECIFIED: StepFreeAxis
STEP_FREE_AXIS_NONE: StepFreeAxis
STEP_FREE_AXIS_X: StepFreeAxis
STEP_FREE_AXIS_Y: StepFreeAxis
STEP_FREE_AXIS_Z: StepFreeAxis
STEP_FREE_AXIS_ALL: StepFreeAxis
OTHER_HAND_UNSPECIFIED: OtherHand
OTHER_HAND_KEEP: OtherHand
OTHER_HAND_LOCK: OtherHand
OTHER_HAND_FREE: OtherHand
STEP_AXES_UNSPECIFIED: StepAxes
STEP_AXES_WORLD: StepAxes
STEP_AXES_HAND: StepAxes
CIRCLE_SENSE_UNSPECIFIED: CircleSense
CIRCLE_SENSE_CLOCKWISE: CircleSense
CIRCLE_SENSE_COUNTER_CLOCKWISE: CircleSense
TOOL_TURN_UNSPECIFIED: ToolTurn
TOOL_TURN_FREE: ToolTurn
TOOL_TURN_KEEP: ToolTurn
BODY_HANDS_UNSPECIFIED: BodyHands
BODY_HANDS_STAY: BodyHands
BODY_HANDS_ALONG: BodyHands
HOLD_MODE_UNSPECIFIED: HoldMode
HOLD_MODE_HOOK: HoldMode
HOLD_MODE_GRASP: HoldMode
HAND_KIND_UNSPECIFIED: HandKind
HAND_KIND_HOOK: HandKind
HAND_KIND_GRIPPER: HandKind
TURN_SENSE_UNSPECIFIED: TurnSense
TURN_SENSE_GIVEN: TurnSense
TURN_SENSE_UNKNOWN: TurnSense
HAND_UNSPECIFIED: Hand
HAND_LEFT: Hand
HAND_RIGHT: Hand
HAND_AUTO: Hand
OPENS_UNSPECIFIED: Opens
OPENS_PUSH: Opens
OPENS_PULL: Opens
OPENS_AUTO: Opens
HINGE_SIDE_UNSPECIFIED: HingeSide
HINGE_SIDE_LEFT: HingeSide
HINGE_SIDE_RIGHT: HingeSide
HINGE_SIDE_AUTO: HingeSide
HANDLE_KIND_UNSPECIFIED: HandleKind
HANDLE_KIND_LEVER: HandleKind
HANDLE_KIND_PULL: HandleKind
HANDLE_KIND_PUSH_BAR: HandleKind
HANDLE_KIND_KNOB: HandleKind
HAND_TOOL_UNSPECIFIED: HandTool
HAND_TOOL_PEG: HandTool
HAND_TOOL_TIP: HandTool
HAND_TOOL_STUB: HandTool
SIDE_UNSPECIFIED: Side
SIDE_LEFT: Side
SIDE_RIGHT: Side
UNKNOWN_SPACE_UNSPECIFIED: UnknownSpace
UNKNOWN_SPACE_FREE: UnknownSpace
UNKNOWN_SPACE_OCCUPIED: UnknownSpace
SENSOR_MODEL_UNSPECIFIED: SensorModel
SENSOR_MODEL_AUTO: SensorModel
SENSOR_MODEL_SPINNING: SensorModel
SENSOR_MODEL_DEPTH: SensorModel
SENSOR_MODEL_TOF: SensorModel
SENSOR_MODEL_SOLID: SensorModel
SENSOR_MODEL_SURVEY: SensorModel
PIECE_METHOD_UNSPECIFIED: PieceMethod
PIECE_METHOD_PLANES: PieceMethod
PIECE_METHOD_COACD: PieceMethod
LENGTH_UNIT_UNSPECIFIED: LengthUnit
LENGTH_UNIT_M: LengthUnit
LENGTH_UNIT_CM: LengthUnit
LENGTH_UNIT_MM: LengthUnit
LENGTH_UNIT_KM: LengthUnit
LENGTH_UNIT_IN: LengthUnit
LENGTH_UNIT_FT: LengthUnit
SHAPE_UNSPECIFIED: Shape
SHAPE_BOX: Shape
SHAPE_SPHERE: Shape
SHAPE_CYLINDER: Shape
SHAPE_CAPSULE: Shape
SHAPE_CONVEX: Shape
SHAPE_MESH: Shape
QP_SOLVER_UNSPECIFIED: QpSolver
QP_SOLVER_PIQP: QpSolver
QP_SOLVER_CLARABEL: QpSolver
QP_SOLVER_CVXPY: QpSolver
PACE_UNSPECIFIED: Pace
PACE_CAREFUL: Pace
PACE_NORMAL: Pace
PACE_FAST: Pace

class MotionRequest(_message.Message):
    __slots__ = ("robot", "start", "scene", "goal", "task", "keep", "attached", "options", "resume")
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    SCENE_FIELD_NUMBER: _ClassVar[int]
    GOAL_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    KEEP_FIELD_NUMBER: _ClassVar[int]
    ATTACHED_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    RESUME_FIELD_NUMBER: _ClassVar[int]
    robot: Robot
    start: Start
    scene: SceneSpec
    goal: Goal
    task: Task
    keep: _containers.RepeatedCompositeFieldContainer[Keep]
    attached: _containers.RepeatedCompositeFieldContainer[Attached]
    options: Options
    resume: Resume
    def __init__(self, robot: _Optional[_Union[Robot, _Mapping]] = ..., start: _Optional[_Union[Start, _Mapping]] = ..., scene: _Optional[_Union[SceneSpec, _Mapping]] = ..., goal: _Optional[_Union[Goal, _Mapping]] = ..., task: _Optional[_Union[Task, _Mapping]] = ..., keep: _Optional[_Iterable[_Union[Keep, _Mapping]]] = ..., attached: _Optional[_Iterable[_Union[Attached, _Mapping]]] = ..., options: _Optional[_Union[Options, _Mapping]] = ..., resume: _Optional[_Union[Resume, _Mapping]] = ...) -> None: ...

class Robot(_message.Message):
    __slots__ = ("name", "urdf", "srdf", "package_dirs", "root", "tool_distance_m", "contacts", "hand", "hands", "servo", "locked", "torque", "drawn_links", "decompose")
    class ContactsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: ContactPatch
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[ContactPatch, _Mapping]] = ...) -> None: ...
    class HandsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: RobotHand
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[RobotHand, _Mapping]] = ...) -> None: ...
    class LockedEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    URDF_FIELD_NUMBER: _ClassVar[int]
    SRDF_FIELD_NUMBER: _ClassVar[int]
    PACKAGE_DIRS_FIELD_NUMBER: _ClassVar[int]
    ROOT_FIELD_NUMBER: _ClassVar[int]
    TOOL_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    CONTACTS_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    HANDS_FIELD_NUMBER: _ClassVar[int]
    SERVO_FIELD_NUMBER: _ClassVar[int]
    LOCKED_FIELD_NUMBER: _ClassVar[int]
    TORQUE_FIELD_NUMBER: _ClassVar[int]
    DRAWN_LINKS_FIELD_NUMBER: _ClassVar[int]
    DECOMPOSE_FIELD_NUMBER: _ClassVar[int]
    name: str
    urdf: str
    srdf: str
    package_dirs: _containers.RepeatedScalarFieldContainer[str]
    root: RootJoint
    tool_distance_m: float
    contacts: _containers.MessageMap[str, ContactPatch]
    hand: HandKind
    hands: _containers.MessageMap[str, RobotHand]
    servo: RobotServo
    locked: _containers.ScalarMap[str, float]
    torque: RobotTorque
    drawn_links: _containers.RepeatedScalarFieldContainer[str]
    decompose: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, name: _Optional[str] = ..., urdf: _Optional[str] = ..., srdf: _Optional[str] = ..., package_dirs: _Optional[_Iterable[str]] = ..., root: _Optional[_Union[RootJoint, str]] = ..., tool_distance_m: _Optional[float] = ..., contacts: _Optional[_Mapping[str, ContactPatch]] = ..., hand: _Optional[_Union[HandKind, str]] = ..., hands: _Optional[_Mapping[str, RobotHand]] = ..., servo: _Optional[_Union[RobotServo, _Mapping]] = ..., locked: _Optional[_Mapping[str, float]] = ..., torque: _Optional[_Union[RobotTorque, _Mapping]] = ..., drawn_links: _Optional[_Iterable[str]] = ..., decompose: _Optional[_Iterable[str]] = ...) -> None: ...

class RobotTorque(_message.Message):
    __slots__ = ("check", "unchecked")
    CHECK_FIELD_NUMBER: _ClassVar[int]
    UNCHECKED_FIELD_NUMBER: _ClassVar[int]
    check: bool
    unchecked: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, check: bool = ..., unchecked: _Optional[_Iterable[str]] = ...) -> None: ...

class RobotServo(_message.Message):
    __slots__ = ("stiffness", "hand_stiffness_n_m", "reaction_s", "force_noise_n", "hand_turn_stiffness_n_m_rad")
    class StiffnessEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    STIFFNESS_FIELD_NUMBER: _ClassVar[int]
    HAND_STIFFNESS_N_M_FIELD_NUMBER: _ClassVar[int]
    REACTION_S_FIELD_NUMBER: _ClassVar[int]
    FORCE_NOISE_N_FIELD_NUMBER: _ClassVar[int]
    HAND_TURN_STIFFNESS_N_M_RAD_FIELD_NUMBER: _ClassVar[int]
    stiffness: _containers.ScalarMap[str, float]
    hand_stiffness_n_m: float
    reaction_s: float
    force_noise_n: float
    hand_turn_stiffness_n_m_rad: float
    def __init__(self, stiffness: _Optional[_Mapping[str, float]] = ..., hand_stiffness_n_m: _Optional[float] = ..., reaction_s: _Optional[float] = ..., force_noise_n: _Optional[float] = ..., hand_turn_stiffness_n_m_rad: _Optional[float] = ...) -> None: ...

class RobotHand(_message.Message):
    __slots__ = ("link", "hook", "tool", "peg", "stub", "peg_radius_m", "fingers")
    LINK_FIELD_NUMBER: _ClassVar[int]
    HOOK_FIELD_NUMBER: _ClassVar[int]
    TOOL_FIELD_NUMBER: _ClassVar[int]
    PEG_FIELD_NUMBER: _ClassVar[int]
    STUB_FIELD_NUMBER: _ClassVar[int]
    PEG_RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    FINGERS_FIELD_NUMBER: _ClassVar[int]
    link: str
    hook: str
    tool: str
    peg: str
    stub: str
    peg_radius_m: float
    fingers: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, link: _Optional[str] = ..., hook: _Optional[str] = ..., tool: _Optional[str] = ..., peg: _Optional[str] = ..., stub: _Optional[str] = ..., peg_radius_m: _Optional[float] = ..., fingers: _Optional[_Iterable[str]] = ...) -> None: ...

class ContactPatch(_message.Message):
    __slots__ = ("link", "points", "normal", "kind", "friction", "force_cap_n")
    LINK_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    FRICTION_FIELD_NUMBER: _ClassVar[int]
    FORCE_CAP_N_FIELD_NUMBER: _ClassVar[int]
    link: str
    points: _containers.RepeatedCompositeFieldContainer[Point]
    normal: _containers.RepeatedScalarFieldContainer[float]
    kind: PatchKind
    friction: float
    force_cap_n: float
    def __init__(self, link: _Optional[str] = ..., points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., normal: _Optional[_Iterable[float]] = ..., kind: _Optional[_Union[PatchKind, str]] = ..., friction: _Optional[float] = ..., force_cap_n: _Optional[float] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("position", "quaternion_wxyz")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ...) -> None: ...

class Start(_message.Message):
    __slots__ = ("posture", "joints", "joint_names", "positions", "base", "rates")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    class RatesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    BASE_FIELD_NUMBER: _ClassVar[int]
    RATES_FIELD_NUMBER: _ClassVar[int]
    posture: str
    joints: _containers.ScalarMap[str, float]
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    positions: _containers.RepeatedScalarFieldContainer[float]
    base: Pose
    rates: _containers.ScalarMap[str, float]
    def __init__(self, posture: _Optional[str] = ..., joints: _Optional[_Mapping[str, float]] = ..., joint_names: _Optional[_Iterable[str]] = ..., positions: _Optional[_Iterable[float]] = ..., base: _Optional[_Union[Pose, _Mapping]] = ..., rates: _Optional[_Mapping[str, float]] = ...) -> None: ...

class Goal(_message.Message):
    __slots__ = ("joints", "poses", "posture", "any_of", "via", "rates")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    class RatesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    ANY_OF_FIELD_NUMBER: _ClassVar[int]
    VIA_FIELD_NUMBER: _ClassVar[int]
    RATES_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.ScalarMap[str, float]
    poses: _containers.RepeatedCompositeFieldContainer[PoseGoal]
    posture: str
    any_of: _containers.RepeatedCompositeFieldContainer[GoalPart]
    via: _containers.RepeatedCompositeFieldContainer[GoalPart]
    rates: _containers.ScalarMap[str, float]
    def __init__(self, joints: _Optional[_Mapping[str, float]] = ..., poses: _Optional[_Iterable[_Union[PoseGoal, _Mapping]]] = ..., posture: _Optional[str] = ..., any_of: _Optional[_Iterable[_Union[GoalPart, _Mapping]]] = ..., via: _Optional[_Iterable[_Union[GoalPart, _Mapping]]] = ..., rates: _Optional[_Mapping[str, float]] = ...) -> None: ...

class GoalPart(_message.Message):
    __slots__ = ("joints", "poses", "posture")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.ScalarMap[str, float]
    poses: _containers.RepeatedCompositeFieldContainer[PoseGoal]
    posture: str
    def __init__(self, joints: _Optional[_Mapping[str, float]] = ..., poses: _Optional[_Iterable[_Union[PoseGoal, _Mapping]]] = ..., posture: _Optional[str] = ...) -> None: ...

class PoseGoal(_message.Message):
    __slots__ = ("link", "position", "quaternion_wxyz", "position_tolerance_m", "rotation_tolerance_deg", "free_axis", "relative_to", "region", "look_at", "look_axis")
    LINK_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    POSITION_TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_TOLERANCE_DEG_FIELD_NUMBER: _ClassVar[int]
    FREE_AXIS_FIELD_NUMBER: _ClassVar[int]
    RELATIVE_TO_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    LOOK_AT_FIELD_NUMBER: _ClassVar[int]
    LOOK_AXIS_FIELD_NUMBER: _ClassVar[int]
    link: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    position_tolerance_m: float
    rotation_tolerance_deg: float
    free_axis: FreeAxis
    relative_to: str
    region: Region
    look_at: _containers.RepeatedScalarFieldContainer[float]
    look_axis: str
    def __init__(self, link: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., position_tolerance_m: _Optional[float] = ..., rotation_tolerance_deg: _Optional[float] = ..., free_axis: _Optional[_Union[FreeAxis, str]] = ..., relative_to: _Optional[str] = ..., region: _Optional[_Union[Region, _Mapping]] = ..., look_at: _Optional[_Iterable[float]] = ..., look_axis: _Optional[str] = ...) -> None: ...

class Region(_message.Message):
    __slots__ = ("x_min_m", "x_max_m", "y_min_m", "y_max_m", "z_min_m", "z_max_m", "radius_m", "about_x_deg", "about_y_deg", "about_z_deg")
    X_MIN_M_FIELD_NUMBER: _ClassVar[int]
    X_MAX_M_FIELD_NUMBER: _ClassVar[int]
    Y_MIN_M_FIELD_NUMBER: _ClassVar[int]
    Y_MAX_M_FIELD_NUMBER: _ClassVar[int]
    Z_MIN_M_FIELD_NUMBER: _ClassVar[int]
    Z_MAX_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    ABOUT_X_DEG_FIELD_NUMBER: _ClassVar[int]
    ABOUT_Y_DEG_FIELD_NUMBER: _ClassVar[int]
    ABOUT_Z_DEG_FIELD_NUMBER: _ClassVar[int]
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    z_min_m: float
    z_max_m: float
    radius_m: float
    about_x_deg: float
    about_y_deg: float
    about_z_deg: float
    def __init__(self, x_min_m: _Optional[float] = ..., x_max_m: _Optional[float] = ..., y_min_m: _Optional[float] = ..., y_max_m: _Optional[float] = ..., z_min_m: _Optional[float] = ..., z_max_m: _Optional[float] = ..., radius_m: _Optional[float] = ..., about_x_deg: _Optional[float] = ..., about_y_deg: _Optional[float] = ..., about_z_deg: _Optional[float] = ...) -> None: ...

class Task(_message.Message):
    __slots__ = ("valve", "door", "egress", "trajopt", "contacts", "mechanism", "pick_place", "steps", "use")
    VALVE_FIELD_NUMBER: _ClassVar[int]
    DOOR_FIELD_NUMBER: _ClassVar[int]
    EGRESS_FIELD_NUMBER: _ClassVar[int]
    TRAJOPT_FIELD_NUMBER: _ClassVar[int]
    CONTACTS_FIELD_NUMBER: _ClassVar[int]
    MECHANISM_FIELD_NUMBER: _ClassVar[int]
    PICK_PLACE_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    USE_FIELD_NUMBER: _ClassVar[int]
    WITH_FIELD_NUMBER: _ClassVar[int]
    valve: Valve
    door: Door
    egress: Egress
    trajopt: _struct_pb2.Struct
    contacts: Contacts
    mechanism: Mechanism
    pick_place: PickPlace
    steps: _containers.RepeatedCompositeFieldContainer[Step]
    use: str
    def __init__(self, valve: _Optional[_Union[Valve, _Mapping]] = ..., door: _Optional[_Union[Door, _Mapping]] = ..., egress: _Optional[_Union[Egress, _Mapping]] = ..., trajopt: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., contacts: _Optional[_Union[Contacts, _Mapping]] = ..., mechanism: _Optional[_Union[Mechanism, _Mapping]] = ..., pick_place: _Optional[_Union[PickPlace, _Mapping]] = ..., steps: _Optional[_Iterable[_Union[Step, _Mapping]]] = ..., use: _Optional[str] = ..., **kwargs) -> None: ...

class PickPlace(_message.Message):
    __slots__ = ("object", "to", "hand", "grip_n", "lift_m", "opening_m")
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    TO_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    GRIP_N_FIELD_NUMBER: _ClassVar[int]
    LIFT_M_FIELD_NUMBER: _ClassVar[int]
    OPENING_M_FIELD_NUMBER: _ClassVar[int]
    object: str
    to: ObjectPlace
    hand: CarryingHand
    grip_n: float
    lift_m: float
    opening_m: float
    def __init__(self, object: _Optional[str] = ..., to: _Optional[_Union[ObjectPlace, _Mapping]] = ..., hand: _Optional[_Union[CarryingHand, str]] = ..., grip_n: _Optional[float] = ..., lift_m: _Optional[float] = ..., opening_m: _Optional[float] = ...) -> None: ...

class ObjectPlace(_message.Message):
    __slots__ = ("position", "quaternion_wxyz")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ...) -> None: ...

class Step(_message.Message):
    __slots__ = ("name", "move", "screw", "follow", "touch", "press", "mechanism", "body", "wait", "check", "look", "grasp", "release", "insert", "withdraw", "walk", "contacts", "hold")
    NAME_FIELD_NUMBER: _ClassVar[int]
    MOVE_FIELD_NUMBER: _ClassVar[int]
    SCREW_FIELD_NUMBER: _ClassVar[int]
    FOLLOW_FIELD_NUMBER: _ClassVar[int]
    TOUCH_FIELD_NUMBER: _ClassVar[int]
    PRESS_FIELD_NUMBER: _ClassVar[int]
    MECHANISM_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    WAIT_FIELD_NUMBER: _ClassVar[int]
    CHECK_FIELD_NUMBER: _ClassVar[int]
    LOOK_FIELD_NUMBER: _ClassVar[int]
    GRASP_FIELD_NUMBER: _ClassVar[int]
    RELEASE_FIELD_NUMBER: _ClassVar[int]
    INSERT_FIELD_NUMBER: _ClassVar[int]
    WITHDRAW_FIELD_NUMBER: _ClassVar[int]
    WALK_FIELD_NUMBER: _ClassVar[int]
    CONTACTS_FIELD_NUMBER: _ClassVar[int]
    HOLD_FIELD_NUMBER: _ClassVar[int]
    name: str
    move: StepMove
    screw: Screw
    follow: Follow
    touch: Touch
    press: Press
    mechanism: Mechanism
    body: BodyMove
    wait: str
    check: str
    look: str
    grasp: GraspStep
    release: Release
    insert: Fit
    withdraw: Fit
    walk: Walk
    contacts: Contacts
    hold: Hold
    def __init__(self, name: _Optional[str] = ..., move: _Optional[_Union[StepMove, _Mapping]] = ..., screw: _Optional[_Union[Screw, _Mapping]] = ..., follow: _Optional[_Union[Follow, _Mapping]] = ..., touch: _Optional[_Union[Touch, _Mapping]] = ..., press: _Optional[_Union[Press, _Mapping]] = ..., mechanism: _Optional[_Union[Mechanism, _Mapping]] = ..., body: _Optional[_Union[BodyMove, _Mapping]] = ..., wait: _Optional[str] = ..., check: _Optional[str] = ..., look: _Optional[str] = ..., grasp: _Optional[_Union[GraspStep, _Mapping]] = ..., release: _Optional[_Union[Release, _Mapping]] = ..., insert: _Optional[_Union[Fit, _Mapping]] = ..., withdraw: _Optional[_Union[Fit, _Mapping]] = ..., walk: _Optional[_Union[Walk, _Mapping]] = ..., contacts: _Optional[_Union[Contacts, _Mapping]] = ..., hold: _Optional[_Union[Hold, _Mapping]] = ...) -> None: ...

class StepMove(_message.Message):
    __slots__ = ("joints", "posture", "poses", "by", "arc", "hand", "frame", "along", "free_axis", "other_hand", "speed_m_s", "duration_s", "tolerance_m", "rotation_tolerance_deg", "blend_m")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    BY_FIELD_NUMBER: _ClassVar[int]
    ARC_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ALONG_FIELD_NUMBER: _ClassVar[int]
    FREE_AXIS_FIELD_NUMBER: _ClassVar[int]
    OTHER_HAND_FIELD_NUMBER: _ClassVar[int]
    SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_TOLERANCE_DEG_FIELD_NUMBER: _ClassVar[int]
    BLEND_M_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.ScalarMap[str, float]
    posture: str
    poses: _containers.RepeatedCompositeFieldContainer[PoseGoal]
    by: Shift
    arc: Arc
    hand: StepHand
    frame: str
    along: Along
    free_axis: StepFreeAxis
    other_hand: OtherHand
    speed_m_s: float
    duration_s: float
    tolerance_m: float
    rotation_tolerance_deg: float
    blend_m: float
    def __init__(self, joints: _Optional[_Mapping[str, float]] = ..., posture: _Optional[str] = ..., poses: _Optional[_Iterable[_Union[PoseGoal, _Mapping]]] = ..., by: _Optional[_Union[Shift, _Mapping]] = ..., arc: _Optional[_Union[Arc, _Mapping]] = ..., hand: _Optional[_Union[StepHand, str]] = ..., frame: _Optional[str] = ..., along: _Optional[_Union[Along, str]] = ..., free_axis: _Optional[_Union[StepFreeAxis, str]] = ..., other_hand: _Optional[_Union[OtherHand, str]] = ..., speed_m_s: _Optional[float] = ..., duration_s: _Optional[float] = ..., tolerance_m: _Optional[float] = ..., rotation_tolerance_deg: _Optional[float] = ..., blend_m: _Optional[float] = ...) -> None: ...

class Shift(_message.Message):
    __slots__ = ("translation", "rotation_deg", "axes")
    TRANSLATION_FIELD_NUMBER: _ClassVar[int]
    ROTATION_DEG_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    translation: _containers.RepeatedScalarFieldContainer[float]
    rotation_deg: _containers.RepeatedScalarFieldContainer[float]
    axes: StepAxes
    def __init__(self, translation: _Optional[_Iterable[float]] = ..., rotation_deg: _Optional[_Iterable[float]] = ..., axes: _Optional[_Union[StepAxes, str]] = ...) -> None: ...

class Arc(_message.Message):
    __slots__ = ("centre", "axis", "angle_deg", "turns")
    CENTRE_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    ANGLE_DEG_FIELD_NUMBER: _ClassVar[int]
    TURNS_FIELD_NUMBER: _ClassVar[int]
    centre: _containers.RepeatedScalarFieldContainer[float]
    axis: _containers.RepeatedScalarFieldContainer[float]
    angle_deg: float
    turns: bool
    def __init__(self, centre: _Optional[_Iterable[float]] = ..., axis: _Optional[_Iterable[float]] = ..., angle_deg: _Optional[float] = ..., turns: bool = ...) -> None: ...

class Screw(_message.Message):
    __slots__ = ("axis", "centre", "axes", "translation_m", "rotation_deg", "hand", "frame", "free_axis", "other_hand", "speed_m_s", "duration_s", "tolerance_m", "rotation_tolerance_deg", "rate_deg_s")
    AXIS_FIELD_NUMBER: _ClassVar[int]
    CENTRE_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    TRANSLATION_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_DEG_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    FREE_AXIS_FIELD_NUMBER: _ClassVar[int]
    OTHER_HAND_FIELD_NUMBER: _ClassVar[int]
    SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_TOLERANCE_DEG_FIELD_NUMBER: _ClassVar[int]
    RATE_DEG_S_FIELD_NUMBER: _ClassVar[int]
    axis: _containers.RepeatedScalarFieldContainer[float]
    centre: _containers.RepeatedScalarFieldContainer[float]
    axes: StepAxes
    translation_m: float
    rotation_deg: float
    hand: StepHand
    frame: str
    free_axis: StepFreeAxis
    other_hand: OtherHand
    speed_m_s: float
    duration_s: float
    tolerance_m: float
    rotation_tolerance_deg: float
    rate_deg_s: float
    def __init__(self, axis: _Optional[_Iterable[float]] = ..., centre: _Optional[_Iterable[float]] = ..., axes: _Optional[_Union[StepAxes, str]] = ..., translation_m: _Optional[float] = ..., rotation_deg: _Optional[float] = ..., hand: _Optional[_Union[StepHand, str]] = ..., frame: _Optional[str] = ..., free_axis: _Optional[_Union[StepFreeAxis, str]] = ..., other_hand: _Optional[_Union[OtherHand, str]] = ..., speed_m_s: _Optional[float] = ..., duration_s: _Optional[float] = ..., tolerance_m: _Optional[float] = ..., rotation_tolerance_deg: _Optional[float] = ..., rate_deg_s: _Optional[float] = ...) -> None: ...

class Face(_message.Message):
    __slots__ = ("point", "normal", "pieces")
    POINT_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    PIECES_FIELD_NUMBER: _ClassVar[int]
    point: _containers.RepeatedScalarFieldContainer[float]
    normal: _containers.RepeatedScalarFieldContainer[float]
    pieces: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, point: _Optional[_Iterable[float]] = ..., normal: _Optional[_Iterable[float]] = ..., pieces: _Optional[_Iterable[str]] = ...) -> None: ...

class Circle(_message.Message):
    __slots__ = ("centre", "radius_m", "angle_deg", "begin_deg", "sense")
    CENTRE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    ANGLE_DEG_FIELD_NUMBER: _ClassVar[int]
    BEGIN_DEG_FIELD_NUMBER: _ClassVar[int]
    SENSE_FIELD_NUMBER: _ClassVar[int]
    centre: _containers.RepeatedScalarFieldContainer[float]
    radius_m: float
    angle_deg: float
    begin_deg: float
    sense: CircleSense
    def __init__(self, centre: _Optional[_Iterable[float]] = ..., radius_m: _Optional[float] = ..., angle_deg: _Optional[float] = ..., begin_deg: _Optional[float] = ..., sense: _Optional[_Union[CircleSense, str]] = ...) -> None: ...

class Follow(_message.Message):
    __slots__ = ("face", "circle", "polyline", "hand", "frame", "depth_m", "tilt_deg", "tilt_towards", "turn", "approach_m", "speed_m_s", "thrust_n", "touch_depth_m", "other_hand", "tolerance_m", "rotation_tolerance_deg", "blend_m", "tool_axis", "across_n", "twist_nm")
    FACE_FIELD_NUMBER: _ClassVar[int]
    CIRCLE_FIELD_NUMBER: _ClassVar[int]
    POLYLINE_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    DEPTH_M_FIELD_NUMBER: _ClassVar[int]
    TILT_DEG_FIELD_NUMBER: _ClassVar[int]
    TILT_TOWARDS_FIELD_NUMBER: _ClassVar[int]
    TURN_FIELD_NUMBER: _ClassVar[int]
    APPROACH_M_FIELD_NUMBER: _ClassVar[int]
    SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    THRUST_N_FIELD_NUMBER: _ClassVar[int]
    TOUCH_DEPTH_M_FIELD_NUMBER: _ClassVar[int]
    OTHER_HAND_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_TOLERANCE_DEG_FIELD_NUMBER: _ClassVar[int]
    BLEND_M_FIELD_NUMBER: _ClassVar[int]
    TOOL_AXIS_FIELD_NUMBER: _ClassVar[int]
    ACROSS_N_FIELD_NUMBER: _ClassVar[int]
    TWIST_NM_FIELD_NUMBER: _ClassVar[int]
    face: Face
    circle: Circle
    polyline: _containers.RepeatedCompositeFieldContainer[Point]
    hand: StepHand
    frame: str
    depth_m: float
    tilt_deg: float
    tilt_towards: _containers.RepeatedScalarFieldContainer[float]
    turn: ToolTurn
    approach_m: float
    speed_m_s: float
    thrust_n: float
    touch_depth_m: float
    other_hand: OtherHand
    tolerance_m: float
    rotation_tolerance_deg: float
    blend_m: float
    tool_axis: str
    across_n: float
    twist_nm: float
    def __init__(self, face: _Optional[_Union[Face, _Mapping]] = ..., circle: _Optional[_Union[Circle, _Mapping]] = ..., polyline: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., hand: _Optional[_Union[StepHand, str]] = ..., frame: _Optional[str] = ..., depth_m: _Optional[float] = ..., tilt_deg: _Optional[float] = ..., tilt_towards: _Optional[_Iterable[float]] = ..., turn: _Optional[_Union[ToolTurn, str]] = ..., approach_m: _Optional[float] = ..., speed_m_s: _Optional[float] = ..., thrust_n: _Optional[float] = ..., touch_depth_m: _Optional[float] = ..., other_hand: _Optional[_Union[OtherHand, str]] = ..., tolerance_m: _Optional[float] = ..., rotation_tolerance_deg: _Optional[float] = ..., blend_m: _Optional[float] = ..., tool_axis: _Optional[str] = ..., across_n: _Optional[float] = ..., twist_nm: _Optional[float] = ...) -> None: ...

class Touch(_message.Message):
    __slots__ = ("direction", "window_m", "force_n", "axes", "pieces", "hand", "frame", "free_axis", "other_hand", "speed_m_s", "tolerance_m", "rotation_tolerance_deg")
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    WINDOW_M_FIELD_NUMBER: _ClassVar[int]
    FORCE_N_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    PIECES_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    FREE_AXIS_FIELD_NUMBER: _ClassVar[int]
    OTHER_HAND_FIELD_NUMBER: _ClassVar[int]
    SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_TOLERANCE_DEG_FIELD_NUMBER: _ClassVar[int]
    direction: _containers.RepeatedScalarFieldContainer[float]
    window_m: _containers.RepeatedScalarFieldContainer[float]
    force_n: float
    axes: StepAxes
    pieces: _containers.RepeatedScalarFieldContainer[str]
    hand: StepHand
    frame: str
    free_axis: StepFreeAxis
    other_hand: OtherHand
    speed_m_s: float
    tolerance_m: float
    rotation_tolerance_deg: float
    def __init__(self, direction: _Optional[_Iterable[float]] = ..., window_m: _Optional[_Iterable[float]] = ..., force_n: _Optional[float] = ..., axes: _Optional[_Union[StepAxes, str]] = ..., pieces: _Optional[_Iterable[str]] = ..., hand: _Optional[_Union[StepHand, str]] = ..., frame: _Optional[str] = ..., free_axis: _Optional[_Union[StepFreeAxis, str]] = ..., other_hand: _Optional[_Union[OtherHand, str]] = ..., speed_m_s: _Optional[float] = ..., tolerance_m: _Optional[float] = ..., rotation_tolerance_deg: _Optional[float] = ...) -> None: ...

class Press(_message.Message):
    __slots__ = ("at", "normal", "force_n", "travel_m", "size_m", "height_m", "hand")
    AT_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    FORCE_N_FIELD_NUMBER: _ClassVar[int]
    TRAVEL_M_FIELD_NUMBER: _ClassVar[int]
    SIZE_M_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    at: _containers.RepeatedScalarFieldContainer[float]
    normal: _containers.RepeatedScalarFieldContainer[float]
    force_n: float
    travel_m: float
    size_m: float
    height_m: float
    hand: Hand
    def __init__(self, at: _Optional[_Iterable[float]] = ..., normal: _Optional[_Iterable[float]] = ..., force_n: _Optional[float] = ..., travel_m: _Optional[float] = ..., size_m: _Optional[float] = ..., height_m: _Optional[float] = ..., hand: _Optional[_Union[Hand, str]] = ...) -> None: ...

class GraspStep(_message.Message):
    __slots__ = ("object", "hand", "grasp", "force_n", "opening_m", "approach_m")
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    GRASP_FIELD_NUMBER: _ClassVar[int]
    FORCE_N_FIELD_NUMBER: _ClassVar[int]
    OPENING_M_FIELD_NUMBER: _ClassVar[int]
    APPROACH_M_FIELD_NUMBER: _ClassVar[int]
    object: str
    hand: CarryingHand
    grasp: int
    force_n: float
    opening_m: float
    approach_m: float
    def __init__(self, object: _Optional[str] = ..., hand: _Optional[_Union[CarryingHand, str]] = ..., grasp: _Optional[int] = ..., force_n: _Optional[float] = ..., opening_m: _Optional[float] = ..., approach_m: _Optional[float] = ...) -> None: ...

class Hold(_message.Message):
    __slots__ = ("object", "hand", "force_n")
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    FORCE_N_FIELD_NUMBER: _ClassVar[int]
    object: str
    hand: StepHand
    force_n: float
    def __init__(self, object: _Optional[str] = ..., hand: _Optional[_Union[StepHand, str]] = ..., force_n: _Optional[float] = ...) -> None: ...

class Release(_message.Message):
    __slots__ = ("object", "hand", "opening_m", "retreat_m")
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    OPENING_M_FIELD_NUMBER: _ClassVar[int]
    RETREAT_M_FIELD_NUMBER: _ClassVar[int]
    object: str
    hand: StepHand
    opening_m: float
    retreat_m: float
    def __init__(self, object: _Optional[str] = ..., hand: _Optional[_Union[StepHand, str]] = ..., opening_m: _Optional[float] = ..., retreat_m: _Optional[float] = ...) -> None: ...

class Fit(_message.Message):
    __slots__ = ("object", "axis", "depth_m", "clearance_m", "at", "pieces", "chamfer_m", "friction", "force_n", "speed_m_s")
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    DEPTH_M_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    AT_FIELD_NUMBER: _ClassVar[int]
    PIECES_FIELD_NUMBER: _ClassVar[int]
    CHAMFER_M_FIELD_NUMBER: _ClassVar[int]
    FRICTION_FIELD_NUMBER: _ClassVar[int]
    FORCE_N_FIELD_NUMBER: _ClassVar[int]
    SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    object: str
    axis: _containers.RepeatedScalarFieldContainer[float]
    depth_m: float
    clearance_m: float
    at: _containers.RepeatedScalarFieldContainer[float]
    pieces: _containers.RepeatedScalarFieldContainer[str]
    chamfer_m: float
    friction: float
    force_n: float
    speed_m_s: float
    def __init__(self, object: _Optional[str] = ..., axis: _Optional[_Iterable[float]] = ..., depth_m: _Optional[float] = ..., clearance_m: _Optional[float] = ..., at: _Optional[_Iterable[float]] = ..., pieces: _Optional[_Iterable[str]] = ..., chamfer_m: _Optional[float] = ..., friction: _Optional[float] = ..., force_n: _Optional[float] = ..., speed_m_s: _Optional[float] = ...) -> None: ...

class Walk(_message.Message):
    __slots__ = ("to", "yaw_deg", "stride_m", "finish")
    TO_FIELD_NUMBER: _ClassVar[int]
    YAW_DEG_FIELD_NUMBER: _ClassVar[int]
    STRIDE_M_FIELD_NUMBER: _ClassVar[int]
    FINISH_FIELD_NUMBER: _ClassVar[int]
    to: _containers.RepeatedScalarFieldContainer[float]
    yaw_deg: float
    stride_m: float
    finish: str
    def __init__(self, to: _Optional[_Iterable[float]] = ..., yaw_deg: _Optional[float] = ..., stride_m: _Optional[float] = ..., finish: _Optional[str] = ...) -> None: ...

class BodyMove(_message.Message):
    __slots__ = ("pelvis_m", "pelvis_rpy_deg", "torso_rpy_deg", "hands", "duration_s")
    PELVIS_M_FIELD_NUMBER: _ClassVar[int]
    PELVIS_RPY_DEG_FIELD_NUMBER: _ClassVar[int]
    TORSO_RPY_DEG_FIELD_NUMBER: _ClassVar[int]
    HANDS_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    pelvis_m: _containers.RepeatedScalarFieldContainer[float]
    pelvis_rpy_deg: _containers.RepeatedScalarFieldContainer[float]
    torso_rpy_deg: _containers.RepeatedScalarFieldContainer[float]
    hands: BodyHands
    duration_s: float
    def __init__(self, pelvis_m: _Optional[_Iterable[float]] = ..., pelvis_rpy_deg: _Optional[_Iterable[float]] = ..., torso_rpy_deg: _Optional[_Iterable[float]] = ..., hands: _Optional[_Union[BodyHands, str]] = ..., duration_s: _Optional[float] = ...) -> None: ...

class Contacts(_message.Message):
    __slots__ = ("surfaces", "start", "stances", "finish")
    class SurfacesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Surface
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Surface, _Mapping]] = ...) -> None: ...
    class StartEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    SURFACES_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    STANCES_FIELD_NUMBER: _ClassVar[int]
    FINISH_FIELD_NUMBER: _ClassVar[int]
    surfaces: _containers.MessageMap[str, Surface]
    start: _containers.ScalarMap[str, str]
    stances: _containers.RepeatedCompositeFieldContainer[ContactStance]
    finish: str
    def __init__(self, surfaces: _Optional[_Mapping[str, Surface]] = ..., start: _Optional[_Mapping[str, str]] = ..., stances: _Optional[_Iterable[_Union[ContactStance, _Mapping]]] = ..., finish: _Optional[str] = ...) -> None: ...

class Surface(_message.Message):
    __slots__ = ("piece", "normal", "corners", "pieces", "friction")
    PIECE_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    CORNERS_FIELD_NUMBER: _ClassVar[int]
    PIECES_FIELD_NUMBER: _ClassVar[int]
    FRICTION_FIELD_NUMBER: _ClassVar[int]
    piece: str
    normal: _containers.RepeatedScalarFieldContainer[float]
    corners: _containers.RepeatedCompositeFieldContainer[Point]
    pieces: _containers.RepeatedScalarFieldContainer[str]
    friction: float
    def __init__(self, piece: _Optional[str] = ..., normal: _Optional[_Iterable[float]] = ..., corners: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., pieces: _Optional[_Iterable[str]] = ..., friction: _Optional[float] = ...) -> None: ...

class ContactStance(_message.Message):
    __slots__ = ("name", "make", "release", "posture")
    class MakeEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: ContactPlace
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[ContactPlace, _Mapping]] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    MAKE_FIELD_NUMBER: _ClassVar[int]
    RELEASE_FIELD_NUMBER: _ClassVar[int]
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    name: str
    make: _containers.MessageMap[str, ContactPlace]
    release: _containers.RepeatedScalarFieldContainer[str]
    posture: NominalPose
    def __init__(self, name: _Optional[str] = ..., make: _Optional[_Mapping[str, ContactPlace]] = ..., release: _Optional[_Iterable[str]] = ..., posture: _Optional[_Union[NominalPose, _Mapping]] = ...) -> None: ...

class ContactPlace(_message.Message):
    __slots__ = ("surface", "at", "yaw_deg", "slack_m")
    SURFACE_FIELD_NUMBER: _ClassVar[int]
    AT_FIELD_NUMBER: _ClassVar[int]
    YAW_DEG_FIELD_NUMBER: _ClassVar[int]
    SLACK_M_FIELD_NUMBER: _ClassVar[int]
    surface: str
    at: _containers.RepeatedScalarFieldContainer[float]
    yaw_deg: float
    slack_m: float
    def __init__(self, surface: _Optional[str] = ..., at: _Optional[_Iterable[float]] = ..., yaw_deg: _Optional[float] = ..., slack_m: _Optional[float] = ...) -> None: ...

class Valve(_message.Message):
    __slots__ = ("mode", "hand", "turn_deg", "hint", "centre", "axis", "radius", "torque_nm", "sense", "stuck", "spokes_deg", "spoke_width_m", "lever", "stops_deg", "moved_m")
    MODE_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    TURN_DEG_FIELD_NUMBER: _ClassVar[int]
    HINT_FIELD_NUMBER: _ClassVar[int]
    CENTRE_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    TORQUE_NM_FIELD_NUMBER: _ClassVar[int]
    SENSE_FIELD_NUMBER: _ClassVar[int]
    STUCK_FIELD_NUMBER: _ClassVar[int]
    SPOKES_DEG_FIELD_NUMBER: _ClassVar[int]
    SPOKE_WIDTH_M_FIELD_NUMBER: _ClassVar[int]
    LEVER_FIELD_NUMBER: _ClassVar[int]
    STOPS_DEG_FIELD_NUMBER: _ClassVar[int]
    MOVED_M_FIELD_NUMBER: _ClassVar[int]
    mode: HoldMode
    hand: Hand
    turn_deg: float
    hint: _containers.RepeatedScalarFieldContainer[float]
    centre: _containers.RepeatedScalarFieldContainer[float]
    axis: _containers.RepeatedScalarFieldContainer[float]
    radius: float
    torque_nm: float
    sense: TurnSense
    stuck: bool
    spokes_deg: _containers.RepeatedScalarFieldContainer[float]
    spoke_width_m: float
    lever: Lever
    stops_deg: _containers.RepeatedScalarFieldContainer[float]
    moved_m: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, mode: _Optional[_Union[HoldMode, str]] = ..., hand: _Optional[_Union[Hand, str]] = ..., turn_deg: _Optional[float] = ..., hint: _Optional[_Iterable[float]] = ..., centre: _Optional[_Iterable[float]] = ..., axis: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., torque_nm: _Optional[float] = ..., sense: _Optional[_Union[TurnSense, str]] = ..., stuck: bool = ..., spokes_deg: _Optional[_Iterable[float]] = ..., spoke_width_m: _Optional[float] = ..., lever: _Optional[_Union[Lever, _Mapping]] = ..., stops_deg: _Optional[_Iterable[float]] = ..., moved_m: _Optional[_Iterable[float]] = ...) -> None: ...

class Lever(_message.Message):
    __slots__ = ("direction", "length_m", "radius_m", "grip_m")
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    LENGTH_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    GRIP_M_FIELD_NUMBER: _ClassVar[int]
    direction: _containers.RepeatedScalarFieldContainer[float]
    length_m: float
    radius_m: float
    grip_m: float
    def __init__(self, direction: _Optional[_Iterable[float]] = ..., length_m: _Optional[float] = ..., radius_m: _Optional[float] = ..., grip_m: _Optional[float] = ...) -> None: ...

class Door(_message.Message):
    __slots__ = ("hand", "open_deg", "hint", "opens", "leaf", "handle", "release_deg", "press_m", "lever_nm", "hinge_nm", "push_bar_n", "stays", "hinge", "moved_m")
    HAND_FIELD_NUMBER: _ClassVar[int]
    OPEN_DEG_FIELD_NUMBER: _ClassVar[int]
    HINT_FIELD_NUMBER: _ClassVar[int]
    OPENS_FIELD_NUMBER: _ClassVar[int]
    LEAF_FIELD_NUMBER: _ClassVar[int]
    HANDLE_FIELD_NUMBER: _ClassVar[int]
    RELEASE_DEG_FIELD_NUMBER: _ClassVar[int]
    PRESS_M_FIELD_NUMBER: _ClassVar[int]
    LEVER_NM_FIELD_NUMBER: _ClassVar[int]
    HINGE_NM_FIELD_NUMBER: _ClassVar[int]
    PUSH_BAR_N_FIELD_NUMBER: _ClassVar[int]
    STAYS_FIELD_NUMBER: _ClassVar[int]
    HINGE_FIELD_NUMBER: _ClassVar[int]
    MOVED_M_FIELD_NUMBER: _ClassVar[int]
    hand: Hand
    open_deg: float
    hint: _containers.RepeatedScalarFieldContainer[float]
    opens: Opens
    leaf: Leaf
    handle: Handle
    release_deg: float
    press_m: float
    lever_nm: float
    hinge_nm: float
    push_bar_n: float
    stays: bool
    hinge: HingeSide
    moved_m: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, hand: _Optional[_Union[Hand, str]] = ..., open_deg: _Optional[float] = ..., hint: _Optional[_Iterable[float]] = ..., opens: _Optional[_Union[Opens, str]] = ..., leaf: _Optional[_Union[Leaf, _Mapping]] = ..., handle: _Optional[_Union[Handle, _Mapping]] = ..., release_deg: _Optional[float] = ..., press_m: _Optional[float] = ..., lever_nm: _Optional[float] = ..., hinge_nm: _Optional[float] = ..., push_bar_n: _Optional[float] = ..., stays: bool = ..., hinge: _Optional[_Union[HingeSide, str]] = ..., moved_m: _Optional[_Iterable[float]] = ...) -> None: ...

class Leaf(_message.Message):
    __slots__ = ("hinge", "edge", "height_m", "thickness_m", "face_m", "ajar_deg")
    HINGE_FIELD_NUMBER: _ClassVar[int]
    EDGE_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    THICKNESS_M_FIELD_NUMBER: _ClassVar[int]
    FACE_M_FIELD_NUMBER: _ClassVar[int]
    AJAR_DEG_FIELD_NUMBER: _ClassVar[int]
    hinge: _containers.RepeatedScalarFieldContainer[float]
    edge: _containers.RepeatedScalarFieldContainer[float]
    height_m: float
    thickness_m: float
    face_m: float
    ajar_deg: float
    def __init__(self, hinge: _Optional[_Iterable[float]] = ..., edge: _Optional[_Iterable[float]] = ..., height_m: _Optional[float] = ..., thickness_m: _Optional[float] = ..., face_m: _Optional[float] = ..., ajar_deg: _Optional[float] = ...) -> None: ...

class Handle(_message.Message):
    __slots__ = ("kind", "centre", "direction", "length_m", "radius_m", "turned_deg")
    KIND_FIELD_NUMBER: _ClassVar[int]
    CENTRE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    LENGTH_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    TURNED_DEG_FIELD_NUMBER: _ClassVar[int]
    kind: HandleKind
    centre: _containers.RepeatedScalarFieldContainer[float]
    direction: _containers.RepeatedScalarFieldContainer[float]
    length_m: float
    radius_m: float
    turned_deg: float
    def __init__(self, kind: _Optional[_Union[HandleKind, str]] = ..., centre: _Optional[_Iterable[float]] = ..., direction: _Optional[_Iterable[float]] = ..., length_m: _Optional[float] = ..., radius_m: _Optional[float] = ..., turned_deg: _Optional[float] = ...) -> None: ...

class Mechanism(_message.Message):
    __slots__ = ("urdf", "position", "quaternion_wxyz", "joints", "handle", "moves", "releases", "hand", "stays", "meshes")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: MechanismJoint
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[MechanismJoint, _Mapping]] = ...) -> None: ...
    class MeshesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: MeshHull
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[MeshHull, _Mapping]] = ...) -> None: ...
    URDF_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    HANDLE_FIELD_NUMBER: _ClassVar[int]
    MOVES_FIELD_NUMBER: _ClassVar[int]
    RELEASES_FIELD_NUMBER: _ClassVar[int]
    HAND_FIELD_NUMBER: _ClassVar[int]
    STAYS_FIELD_NUMBER: _ClassVar[int]
    MESHES_FIELD_NUMBER: _ClassVar[int]
    urdf: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    joints: _containers.MessageMap[str, MechanismJoint]
    handle: MechanismHandle
    moves: _containers.RepeatedCompositeFieldContainer[Move]
    releases: _containers.RepeatedCompositeFieldContainer[LatchRelease]
    hand: Hand
    stays: bool
    meshes: _containers.MessageMap[str, MeshHull]
    def __init__(self, urdf: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., joints: _Optional[_Mapping[str, MechanismJoint]] = ..., handle: _Optional[_Union[MechanismHandle, _Mapping]] = ..., moves: _Optional[_Iterable[_Union[Move, _Mapping]]] = ..., releases: _Optional[_Iterable[_Union[LatchRelease, _Mapping]]] = ..., hand: _Optional[_Union[Hand, str]] = ..., stays: bool = ..., meshes: _Optional[_Mapping[str, MeshHull]] = ...) -> None: ...

class MechanismJoint(_message.Message):
    __slots__ = ("start", "friction", "preload", "stiffness")
    START_FIELD_NUMBER: _ClassVar[int]
    FRICTION_FIELD_NUMBER: _ClassVar[int]
    PRELOAD_FIELD_NUMBER: _ClassVar[int]
    STIFFNESS_FIELD_NUMBER: _ClassVar[int]
    start: float
    friction: float
    preload: float
    stiffness: float
    def __init__(self, start: _Optional[float] = ..., friction: _Optional[float] = ..., preload: _Optional[float] = ..., stiffness: _Optional[float] = ...) -> None: ...

class MechanismHandle(_message.Message):
    __slots__ = ("link", "place", "axis", "tool", "approach", "slide", "tilt_deg")
    LINK_FIELD_NUMBER: _ClassVar[int]
    PLACE_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    TOOL_FIELD_NUMBER: _ClassVar[int]
    APPROACH_FIELD_NUMBER: _ClassVar[int]
    SLIDE_FIELD_NUMBER: _ClassVar[int]
    TILT_DEG_FIELD_NUMBER: _ClassVar[int]
    link: str
    place: _containers.RepeatedScalarFieldContainer[float]
    axis: _containers.RepeatedScalarFieldContainer[float]
    tool: HandTool
    approach: _containers.RepeatedScalarFieldContainer[float]
    slide: _containers.RepeatedScalarFieldContainer[float]
    tilt_deg: float
    def __init__(self, link: _Optional[str] = ..., place: _Optional[_Iterable[float]] = ..., axis: _Optional[_Iterable[float]] = ..., tool: _Optional[_Union[HandTool, str]] = ..., approach: _Optional[_Iterable[float]] = ..., slide: _Optional[_Iterable[float]] = ..., tilt_deg: _Optional[float] = ...) -> None: ...

class Move(_message.Message):
    __slots__ = ("joint", "to")
    JOINT_FIELD_NUMBER: _ClassVar[int]
    TO_FIELD_NUMBER: _ClassVar[int]
    joint: str
    to: float
    def __init__(self, joint: _Optional[str] = ..., to: _Optional[float] = ...) -> None: ...

class LatchRelease(_message.Message):
    __slots__ = ("joint", "latch", "at", "free_beyond")
    JOINT_FIELD_NUMBER: _ClassVar[int]
    LATCH_FIELD_NUMBER: _ClassVar[int]
    AT_FIELD_NUMBER: _ClassVar[int]
    FREE_BEYOND_FIELD_NUMBER: _ClassVar[int]
    joint: str
    latch: str
    at: float
    free_beyond: float
    def __init__(self, joint: _Optional[str] = ..., latch: _Optional[str] = ..., at: _Optional[float] = ..., free_beyond: _Optional[float] = ...) -> None: ...

class MeshHull(_message.Message):
    __slots__ = ("points",)
    POINTS_FIELD_NUMBER: _ClassVar[int]
    points: _containers.RepeatedCompositeFieldContainer[Point]
    def __init__(self, points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ...) -> None: ...

class Egress(_message.Message):
    __slots__ = ("side", "hint", "surfaces", "phases", "phases_file", "samples", "torque_share", "margin_n", "until")
    class SurfacesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Surface
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Surface, _Mapping]] = ...) -> None: ...
    SIDE_FIELD_NUMBER: _ClassVar[int]
    HINT_FIELD_NUMBER: _ClassVar[int]
    SURFACES_FIELD_NUMBER: _ClassVar[int]
    PHASES_FIELD_NUMBER: _ClassVar[int]
    PHASES_FILE_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    TORQUE_SHARE_FIELD_NUMBER: _ClassVar[int]
    MARGIN_N_FIELD_NUMBER: _ClassVar[int]
    UNTIL_FIELD_NUMBER: _ClassVar[int]
    side: Side
    hint: _containers.RepeatedScalarFieldContainer[float]
    surfaces: _containers.MessageMap[str, Surface]
    phases: _containers.RepeatedCompositeFieldContainer[EgressPhase]
    phases_file: str
    samples: int
    torque_share: float
    margin_n: float
    until: str
    def __init__(self, side: _Optional[_Union[Side, str]] = ..., hint: _Optional[_Iterable[float]] = ..., surfaces: _Optional[_Mapping[str, Surface]] = ..., phases: _Optional[_Iterable[_Union[EgressPhase, _Mapping]]] = ..., phases_file: _Optional[str] = ..., samples: _Optional[int] = ..., torque_share: _Optional[float] = ..., margin_n: _Optional[float] = ..., until: _Optional[str] = ...) -> None: ...

class EgressPhase(_message.Message):
    __slots__ = ("name", "contacts", "postures", "weights", "sides", "sampled")
    class ContactsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: EgressContact
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[EgressContact, _Mapping]] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    CONTACTS_FIELD_NUMBER: _ClassVar[int]
    POSTURES_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    SIDES_FIELD_NUMBER: _ClassVar[int]
    SAMPLED_FIELD_NUMBER: _ClassVar[int]
    name: str
    contacts: _containers.MessageMap[str, EgressContact]
    postures: _containers.RepeatedCompositeFieldContainer[NominalPose]
    weights: ShapeWeights
    sides: _containers.RepeatedCompositeFieldContainer[PlaneSide]
    sampled: bool
    def __init__(self, name: _Optional[str] = ..., contacts: _Optional[_Mapping[str, EgressContact]] = ..., postures: _Optional[_Iterable[_Union[NominalPose, _Mapping]]] = ..., weights: _Optional[_Union[ShapeWeights, _Mapping]] = ..., sides: _Optional[_Iterable[_Union[PlaneSide, _Mapping]]] = ..., sampled: bool = ...) -> None: ...

class EgressContact(_message.Message):
    __slots__ = ("surface", "at", "toe", "yaw_deg", "region", "slack_m")
    SURFACE_FIELD_NUMBER: _ClassVar[int]
    AT_FIELD_NUMBER: _ClassVar[int]
    TOE_FIELD_NUMBER: _ClassVar[int]
    YAW_DEG_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    SLACK_M_FIELD_NUMBER: _ClassVar[int]
    surface: str
    at: _containers.RepeatedScalarFieldContainer[float]
    toe: _containers.RepeatedScalarFieldContainer[float]
    yaw_deg: float
    region: _containers.RepeatedScalarFieldContainer[float]
    slack_m: float
    def __init__(self, surface: _Optional[str] = ..., at: _Optional[_Iterable[float]] = ..., toe: _Optional[_Iterable[float]] = ..., yaw_deg: _Optional[float] = ..., region: _Optional[_Iterable[float]] = ..., slack_m: _Optional[float] = ...) -> None: ...

class NominalPose(_message.Message):
    __slots__ = ("base", "joints", "posture")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    BASE_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    base: _containers.RepeatedScalarFieldContainer[float]
    joints: _containers.ScalarMap[str, float]
    posture: str
    def __init__(self, base: _Optional[_Iterable[float]] = ..., joints: _Optional[_Mapping[str, float]] = ..., posture: _Optional[str] = ...) -> None: ...

class ShapeWeights(_message.Message):
    __slots__ = ("posture", "torso", "pelvis", "feet", "hand_forces", "facing")
    POSTURE_FIELD_NUMBER: _ClassVar[int]
    TORSO_FIELD_NUMBER: _ClassVar[int]
    PELVIS_FIELD_NUMBER: _ClassVar[int]
    FEET_FIELD_NUMBER: _ClassVar[int]
    HAND_FORCES_FIELD_NUMBER: _ClassVar[int]
    FACING_FIELD_NUMBER: _ClassVar[int]
    posture: float
    torso: float
    pelvis: float
    feet: float
    hand_forces: float
    facing: float
    def __init__(self, posture: _Optional[float] = ..., torso: _Optional[float] = ..., pelvis: _Optional[float] = ..., feet: _Optional[float] = ..., hand_forces: _Optional[float] = ..., facing: _Optional[float] = ...) -> None: ...

class PlaneSide(_message.Message):
    __slots__ = ("link", "normal", "limit", "point", "weight")
    LINK_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    POINT_FIELD_NUMBER: _ClassVar[int]
    WEIGHT_FIELD_NUMBER: _ClassVar[int]
    link: str
    normal: _containers.RepeatedScalarFieldContainer[float]
    limit: float
    point: _containers.RepeatedScalarFieldContainer[float]
    weight: float
    def __init__(self, link: _Optional[str] = ..., normal: _Optional[_Iterable[float]] = ..., limit: _Optional[float] = ..., point: _Optional[_Iterable[float]] = ..., weight: _Optional[float] = ...) -> None: ...

class SceneSpec(_message.Message):
    __slots__ = ("cloud", "unit", "apply_viewpoint", "sensor", "topic", "message", "hint", "obstacles", "floor", "method", "unknown", "file", "cuts", "level", "sensor_model", "sensor_sigma", "objects")
    CLOUD_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    APPLY_VIEWPOINT_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    HINT_FIELD_NUMBER: _ClassVar[int]
    OBSTACLES_FIELD_NUMBER: _ClassVar[int]
    FLOOR_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    CUTS_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    SENSOR_MODEL_FIELD_NUMBER: _ClassVar[int]
    SENSOR_SIGMA_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    cloud: Cloud
    unit: LengthUnit
    apply_viewpoint: bool
    sensor: _containers.RepeatedScalarFieldContainer[float]
    topic: str
    message: MessageNumber
    hint: _containers.RepeatedScalarFieldContainer[float]
    obstacles: _containers.RepeatedCompositeFieldContainer[Obstacle]
    floor: Floor
    method: PieceMethod
    unknown: UnknownSpace
    file: str
    cuts: _containers.RepeatedCompositeFieldContainer[Cut]
    level: bool
    sensor_model: SensorModel
    sensor_sigma: float
    objects: _containers.RepeatedCompositeFieldContainer[MovableObject]
    def __init__(self, cloud: _Optional[_Union[Cloud, _Mapping]] = ..., unit: _Optional[_Union[LengthUnit, str]] = ..., apply_viewpoint: bool = ..., sensor: _Optional[_Iterable[float]] = ..., topic: _Optional[str] = ..., message: _Optional[_Union[MessageNumber, _Mapping]] = ..., hint: _Optional[_Iterable[float]] = ..., obstacles: _Optional[_Iterable[_Union[Obstacle, _Mapping]]] = ..., floor: _Optional[_Union[Floor, _Mapping]] = ..., method: _Optional[_Union[PieceMethod, str]] = ..., unknown: _Optional[_Union[UnknownSpace, str]] = ..., file: _Optional[str] = ..., cuts: _Optional[_Iterable[_Union[Cut, _Mapping]]] = ..., level: bool = ..., sensor_model: _Optional[_Union[SensorModel, str]] = ..., sensor_sigma: _Optional[float] = ..., objects: _Optional[_Iterable[_Union[MovableObject, _Mapping]]] = ...) -> None: ...

class MovableObject(_message.Message):
    __slots__ = ("type", "name", "position", "quaternion_wxyz", "size", "radius", "height", "points", "mass_kg", "grasps", "file", "scale", "scale_xyz")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    MASS_KG_FIELD_NUMBER: _ClassVar[int]
    GRASPS_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    SCALE_XYZ_FIELD_NUMBER: _ClassVar[int]
    type: Shape
    name: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    size: _containers.RepeatedScalarFieldContainer[float]
    radius: float
    height: float
    points: _containers.RepeatedCompositeFieldContainer[Point]
    mass_kg: float
    grasps: _containers.RepeatedCompositeFieldContainer[Grasp]
    file: str
    scale: float
    scale_xyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, type: _Optional[_Union[Shape, str]] = ..., name: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., size: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., height: _Optional[float] = ..., points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., mass_kg: _Optional[float] = ..., grasps: _Optional[_Iterable[_Union[Grasp, _Mapping]]] = ..., file: _Optional[str] = ..., scale: _Optional[float] = ..., scale_xyz: _Optional[_Iterable[float]] = ...) -> None: ...

class Grasp(_message.Message):
    __slots__ = ("position", "quaternion_wxyz")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ...) -> None: ...

class Cloud(_message.Message):
    __slots__ = ("file", "files")
    FILE_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    file: str
    files: CloudFiles
    def __init__(self, file: _Optional[str] = ..., files: _Optional[_Union[CloudFiles, _Mapping]] = ...) -> None: ...

class CloudFiles(_message.Message):
    __slots__ = ("value",)
    VALUE_FIELD_NUMBER: _ClassVar[int]
    value: _containers.RepeatedCompositeFieldContainer[CloudFile]
    def __init__(self, value: _Optional[_Iterable[_Union[CloudFile, _Mapping]]] = ...) -> None: ...

class CloudFile(_message.Message):
    __slots__ = ("file", "position", "quaternion_wxyz")
    FILE_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    file: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, file: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ...) -> None: ...

class MessageNumber(_message.Message):
    __slots__ = ("number", "word")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    WORD_FIELD_NUMBER: _ClassVar[int]
    number: int
    word: str
    def __init__(self, number: _Optional[int] = ..., word: _Optional[str] = ...) -> None: ...

class Floor(_message.Message):
    __slots__ = ("is_there", "height")
    IS_THERE_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    is_there: bool
    height: float
    def __init__(self, is_there: bool = ..., height: _Optional[float] = ...) -> None: ...

class Obstacle(_message.Message):
    __slots__ = ("type", "name", "position", "quaternion_wxyz", "size", "radius", "height", "points", "file", "scale", "decompose", "match", "in_scan", "scale_xyz")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    DECOMPOSE_FIELD_NUMBER: _ClassVar[int]
    MATCH_FIELD_NUMBER: _ClassVar[int]
    IN_SCAN_FIELD_NUMBER: _ClassVar[int]
    SCALE_XYZ_FIELD_NUMBER: _ClassVar[int]
    type: Shape
    name: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    size: _containers.RepeatedScalarFieldContainer[float]
    radius: float
    height: float
    points: _containers.RepeatedCompositeFieldContainer[Point]
    file: str
    scale: float
    decompose: bool
    match: bool
    in_scan: bool
    scale_xyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, type: _Optional[_Union[Shape, str]] = ..., name: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., size: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., height: _Optional[float] = ..., points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., file: _Optional[str] = ..., scale: _Optional[float] = ..., decompose: bool = ..., match: bool = ..., in_scan: bool = ..., scale_xyz: _Optional[_Iterable[float]] = ...) -> None: ...

class Cut(_message.Message):
    __slots__ = ("type", "name", "position", "quaternion_wxyz", "size", "radius", "height", "points")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    type: Shape
    name: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    size: _containers.RepeatedScalarFieldContainer[float]
    radius: float
    height: float
    points: _containers.RepeatedCompositeFieldContainer[Point]
    def __init__(self, type: _Optional[_Union[Shape, str]] = ..., name: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., size: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., height: _Optional[float] = ..., points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ...) -> None: ...

class Point(_message.Message):
    __slots__ = ("value",)
    VALUE_FIELD_NUMBER: _ClassVar[int]
    value: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, value: _Optional[_Iterable[float]] = ...) -> None: ...

class Attached(_message.Message):
    __slots__ = ("type", "name", "link", "touches", "mass_kg", "position", "quaternion_wxyz", "size", "radius", "height", "points", "file", "scale", "scale_xyz", "decompose", "parts")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    TOUCHES_FIELD_NUMBER: _ClassVar[int]
    MASS_KG_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    SCALE_XYZ_FIELD_NUMBER: _ClassVar[int]
    DECOMPOSE_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    type: Shape
    name: str
    link: str
    touches: _containers.RepeatedScalarFieldContainer[str]
    mass_kg: float
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    size: _containers.RepeatedScalarFieldContainer[float]
    radius: float
    height: float
    points: _containers.RepeatedCompositeFieldContainer[Point]
    file: str
    scale: float
    scale_xyz: _containers.RepeatedScalarFieldContainer[float]
    decompose: bool
    parts: _containers.RepeatedCompositeFieldContainer[MeshHull]
    def __init__(self, type: _Optional[_Union[Shape, str]] = ..., name: _Optional[str] = ..., link: _Optional[str] = ..., touches: _Optional[_Iterable[str]] = ..., mass_kg: _Optional[float] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., size: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., height: _Optional[float] = ..., points: _Optional[_Iterable[_Union[Point, _Mapping]]] = ..., file: _Optional[str] = ..., scale: _Optional[float] = ..., scale_xyz: _Optional[_Iterable[float]] = ..., decompose: bool = ..., parts: _Optional[_Iterable[_Union[MeshHull, _Mapping]]] = ...) -> None: ...

class Keep(_message.Message):
    __slots__ = ("link", "relative_to", "position", "quaternion_wxyz", "position_tolerance_m", "rotation_tolerance_deg", "free_axis", "region", "look_at", "look_axis", "after", "until")
    LINK_FIELD_NUMBER: _ClassVar[int]
    RELATIVE_TO_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    POSITION_TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_TOLERANCE_DEG_FIELD_NUMBER: _ClassVar[int]
    FREE_AXIS_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    LOOK_AT_FIELD_NUMBER: _ClassVar[int]
    LOOK_AXIS_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    UNTIL_FIELD_NUMBER: _ClassVar[int]
    link: str
    relative_to: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    position_tolerance_m: float
    rotation_tolerance_deg: float
    free_axis: FreeAxis
    region: Region
    look_at: _containers.RepeatedScalarFieldContainer[float]
    look_axis: str
    after: float
    until: float
    def __init__(self, link: _Optional[str] = ..., relative_to: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., position_tolerance_m: _Optional[float] = ..., rotation_tolerance_deg: _Optional[float] = ..., free_axis: _Optional[_Union[FreeAxis, str]] = ..., region: _Optional[_Union[Region, _Mapping]] = ..., look_at: _Optional[_Iterable[float]] = ..., look_axis: _Optional[str] = ..., after: _Optional[float] = ..., until: _Optional[float] = ...) -> None: ...

class Options(_message.Message):
    __slots__ = ("waypoints", "time_limit_s", "margin_m", "seed", "balance_margin_m", "feet", "starts", "qp", "velocity_scale", "acceleration_scale", "timed", "escape", "hand_friction", "clearance_m", "padding", "jerk_scale", "tool_speed_m_s", "pace", "sway_m", "sway_deg")
    class PaddingEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    WAYPOINTS_FIELD_NUMBER: _ClassVar[int]
    TIME_LIMIT_S_FIELD_NUMBER: _ClassVar[int]
    MARGIN_M_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    BALANCE_MARGIN_M_FIELD_NUMBER: _ClassVar[int]
    FEET_FIELD_NUMBER: _ClassVar[int]
    STARTS_FIELD_NUMBER: _ClassVar[int]
    QP_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_SCALE_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_SCALE_FIELD_NUMBER: _ClassVar[int]
    TIMED_FIELD_NUMBER: _ClassVar[int]
    ESCAPE_FIELD_NUMBER: _ClassVar[int]
    HAND_FRICTION_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    PADDING_FIELD_NUMBER: _ClassVar[int]
    JERK_SCALE_FIELD_NUMBER: _ClassVar[int]
    TOOL_SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    PACE_FIELD_NUMBER: _ClassVar[int]
    SWAY_M_FIELD_NUMBER: _ClassVar[int]
    SWAY_DEG_FIELD_NUMBER: _ClassVar[int]
    waypoints: int
    time_limit_s: float
    margin_m: float
    seed: int
    balance_margin_m: float
    feet: _containers.RepeatedScalarFieldContainer[str]
    starts: int
    qp: QpSolver
    velocity_scale: float
    acceleration_scale: float
    timed: bool
    escape: bool
    hand_friction: _containers.RepeatedScalarFieldContainer[float]
    clearance_m: float
    padding: _containers.ScalarMap[str, float]
    jerk_scale: float
    tool_speed_m_s: float
    pace: Pace
    sway_m: float
    sway_deg: float
    def __init__(self, waypoints: _Optional[int] = ..., time_limit_s: _Optional[float] = ..., margin_m: _Optional[float] = ..., seed: _Optional[int] = ..., balance_margin_m: _Optional[float] = ..., feet: _Optional[_Iterable[str]] = ..., starts: _Optional[int] = ..., qp: _Optional[_Union[QpSolver, str]] = ..., velocity_scale: _Optional[float] = ..., acceleration_scale: _Optional[float] = ..., timed: bool = ..., escape: bool = ..., hand_friction: _Optional[_Iterable[float]] = ..., clearance_m: _Optional[float] = ..., padding: _Optional[_Mapping[str, float]] = ..., jerk_scale: _Optional[float] = ..., tool_speed_m_s: _Optional[float] = ..., pace: _Optional[_Union[Pace, str]] = ..., sway_m: _Optional[float] = ..., sway_deg: _Optional[float] = ...) -> None: ...

class Resume(_message.Message):
    __slots__ = ("phase", "plan", "mechanism", "is_rescanned", "stroke", "handle", "leaf", "hold", "nominal", "is_compliant")
    class MechanismEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    PHASE_FIELD_NUMBER: _ClassVar[int]
    PLAN_FIELD_NUMBER: _ClassVar[int]
    MECHANISM_FIELD_NUMBER: _ClassVar[int]
    IS_RESCANNED_FIELD_NUMBER: _ClassVar[int]
    STROKE_FIELD_NUMBER: _ClassVar[int]
    HANDLE_FIELD_NUMBER: _ClassVar[int]
    LEAF_FIELD_NUMBER: _ClassVar[int]
    HOLD_FIELD_NUMBER: _ClassVar[int]
    NOMINAL_FIELD_NUMBER: _ClassVar[int]
    IS_COMPLIANT_FIELD_NUMBER: _ClassVar[int]
    phase: str
    plan: str
    mechanism: _containers.ScalarMap[str, float]
    is_rescanned: bool
    stroke: StrokeChoice
    handle: HandleChoice
    leaf: LeafChoice
    hold: HoldChoice
    nominal: NominalMotion
    is_compliant: bool
    def __init__(self, phase: _Optional[str] = ..., plan: _Optional[str] = ..., mechanism: _Optional[_Mapping[str, float]] = ..., is_rescanned: bool = ..., stroke: _Optional[_Union[StrokeChoice, _Mapping]] = ..., handle: _Optional[_Union[HandleChoice, _Mapping]] = ..., leaf: _Optional[_Union[LeafChoice, _Mapping]] = ..., hold: _Optional[_Union[HoldChoice, _Mapping]] = ..., nominal: _Optional[_Union[NominalMotion, _Mapping]] = ..., is_compliant: bool = ...) -> None: ...

class NominalMotion(_message.Message):
    __slots__ = ("joint_names", "phases", "law_path", "law_speed")
    class PhasesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: NominalPhase
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[NominalPhase, _Mapping]] = ...) -> None: ...
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    PHASES_FIELD_NUMBER: _ClassVar[int]
    LAW_PATH_FIELD_NUMBER: _ClassVar[int]
    LAW_SPEED_FIELD_NUMBER: _ClassVar[int]
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    phases: _containers.MessageMap[str, NominalPhase]
    law_path: _containers.RepeatedScalarFieldContainer[float]
    law_speed: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, joint_names: _Optional[_Iterable[str]] = ..., phases: _Optional[_Mapping[str, NominalPhase]] = ..., law_path: _Optional[_Iterable[float]] = ..., law_speed: _Optional[_Iterable[float]] = ...) -> None: ...

class NominalPhase(_message.Message):
    __slots__ = ("positions", "knots", "tangents")
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    KNOTS_FIELD_NUMBER: _ClassVar[int]
    TANGENTS_FIELD_NUMBER: _ClassVar[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    knots: _containers.RepeatedScalarFieldContainer[float]
    tangents: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, positions: _Optional[_Iterable[float]] = ..., knots: _Optional[_Iterable[float]] = ..., tangents: _Optional[_Iterable[float]] = ...) -> None: ...

class HoldChoice(_message.Message):
    __slots__ = ("hand",)
    HAND_FIELD_NUMBER: _ClassVar[int]
    hand: Hand
    def __init__(self, hand: _Optional[_Union[Hand, str]] = ...) -> None: ...

class StrokeChoice(_message.Message):
    __slots__ = ("hand", "gap_rad", "strokes", "is_flipped")
    HAND_FIELD_NUMBER: _ClassVar[int]
    GAP_RAD_FIELD_NUMBER: _ClassVar[int]
    STROKES_FIELD_NUMBER: _ClassVar[int]
    IS_FLIPPED_FIELD_NUMBER: _ClassVar[int]
    hand: Hand
    gap_rad: float
    strokes: int
    is_flipped: bool
    def __init__(self, hand: _Optional[_Union[Hand, str]] = ..., gap_rad: _Optional[float] = ..., strokes: _Optional[int] = ..., is_flipped: bool = ...) -> None: ...

class HandleChoice(_message.Message):
    __slots__ = ("hand", "grip_m", "until_rad", "is_towards_hinge", "ajar_rad", "turned_rad")
    HAND_FIELD_NUMBER: _ClassVar[int]
    GRIP_M_FIELD_NUMBER: _ClassVar[int]
    UNTIL_RAD_FIELD_NUMBER: _ClassVar[int]
    IS_TOWARDS_HINGE_FIELD_NUMBER: _ClassVar[int]
    AJAR_RAD_FIELD_NUMBER: _ClassVar[int]
    TURNED_RAD_FIELD_NUMBER: _ClassVar[int]
    hand: Hand
    grip_m: float
    until_rad: float
    is_towards_hinge: bool
    ajar_rad: float
    turned_rad: float
    def __init__(self, hand: _Optional[_Union[Hand, str]] = ..., grip_m: _Optional[float] = ..., until_rad: _Optional[float] = ..., is_towards_hinge: bool = ..., ajar_rad: _Optional[float] = ..., turned_rad: _Optional[float] = ...) -> None: ...

class LeafChoice(_message.Message):
    __slots__ = ("hand", "along_m", "up_m", "until_rad", "slant_rad")
    HAND_FIELD_NUMBER: _ClassVar[int]
    ALONG_M_FIELD_NUMBER: _ClassVar[int]
    UP_M_FIELD_NUMBER: _ClassVar[int]
    UNTIL_RAD_FIELD_NUMBER: _ClassVar[int]
    SLANT_RAD_FIELD_NUMBER: _ClassVar[int]
    hand: Hand
    along_m: float
    up_m: float
    until_rad: float
    slant_rad: float
    def __init__(self, hand: _Optional[_Union[Hand, str]] = ..., along_m: _Optional[float] = ..., up_m: _Optional[float] = ..., until_rad: _Optional[float] = ..., slant_rad: _Optional[float] = ...) -> None: ...
