from service.proto.planner.v1 import request_pb2 as _request_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PoseStopKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    POSE_STOP_KIND_UNSPECIFIED: _ClassVar[PoseStopKind]
    POSE_STOP_KIND_PAIR: _ClassVar[PoseStopKind]
    POSE_STOP_KIND_JOINT_LIMIT: _ClassVar[PoseStopKind]
    POSE_STOP_KIND_BALANCE: _ClassVar[PoseStopKind]
    POSE_STOP_KIND_TORQUE: _ClassVar[PoseStopKind]
    POSE_STOP_KIND_REACH: _ClassVar[PoseStopKind]
    POSE_STOP_KIND_REFUSED: _ClassVar[PoseStopKind]
POSE_STOP_KIND_UNSPECIFIED: PoseStopKind
POSE_STOP_KIND_PAIR: PoseStopKind
POSE_STOP_KIND_JOINT_LIMIT: PoseStopKind
POSE_STOP_KIND_BALANCE: PoseStopKind
POSE_STOP_KIND_TORQUE: PoseStopKind
POSE_STOP_KIND_REACH: PoseStopKind
POSE_STOP_KIND_REFUSED: PoseStopKind

class PoseSessionRequest(_message.Message):
    __slots__ = ("open", "event")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    EVENT_FIELD_NUMBER: _ClassVar[int]
    open: OpenPoseSession
    event: PoseEvent
    def __init__(self, open: _Optional[_Union[OpenPoseSession, _Mapping]] = ..., event: _Optional[_Union[PoseEvent, _Mapping]] = ...) -> None: ...

class OpenPoseSession(_message.Message):
    __slots__ = ("request", "with_drawing")
    REQUEST_FIELD_NUMBER: _ClassVar[int]
    WITH_DRAWING_FIELD_NUMBER: _ClassVar[int]
    request: _request_pb2.MotionRequest
    with_drawing: bool
    def __init__(self, request: _Optional[_Union[_request_pb2.MotionRequest, _Mapping]] = ..., with_drawing: bool = ...) -> None: ...

class PoseEvent(_message.Message):
    __slots__ = ("number", "drag", "undo", "redo", "set", "with_preview")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    DRAG_FIELD_NUMBER: _ClassVar[int]
    UNDO_FIELD_NUMBER: _ClassVar[int]
    REDO_FIELD_NUMBER: _ClassVar[int]
    SET_FIELD_NUMBER: _ClassVar[int]
    WITH_PREVIEW_FIELD_NUMBER: _ClassVar[int]
    number: int
    drag: Drag
    undo: UndoPose
    redo: RedoPose
    set: SetPose
    with_preview: bool
    def __init__(self, number: _Optional[int] = ..., drag: _Optional[_Union[Drag, _Mapping]] = ..., undo: _Optional[_Union[UndoPose, _Mapping]] = ..., redo: _Optional[_Union[RedoPose, _Mapping]] = ..., set: _Optional[_Union[SetPose, _Mapping]] = ..., with_preview: bool = ...) -> None: ...

class Drag(_message.Message):
    __slots__ = ("targets", "joints", "is_last")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    TARGETS_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    IS_LAST_FIELD_NUMBER: _ClassVar[int]
    targets: _containers.RepeatedCompositeFieldContainer[DragTarget]
    joints: _containers.ScalarMap[str, float]
    is_last: bool
    def __init__(self, targets: _Optional[_Iterable[_Union[DragTarget, _Mapping]]] = ..., joints: _Optional[_Mapping[str, float]] = ..., is_last: bool = ...) -> None: ...

class DragTarget(_message.Message):
    __slots__ = ("link", "position", "quaternion_wxyz")
    LINK_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    link: str
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, link: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ...) -> None: ...

class UndoPose(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class RedoPose(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class SetPose(_message.Message):
    __slots__ = ("pose",)
    POSE_FIELD_NUMBER: _ClassVar[int]
    pose: _request_pb2.Start
    def __init__(self, pose: _Optional[_Union[_request_pb2.Start, _Mapping]] = ...) -> None: ...

class PoseSessionResponse(_message.Message):
    __slots__ = ("opened", "pose")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    opened: PoseSessionOpened
    pose: SessionPose
    def __init__(self, opened: _Optional[_Union[PoseSessionOpened, _Mapping]] = ..., pose: _Optional[_Union[SessionPose, _Mapping]] = ...) -> None: ...

class PoseSessionOpened(_message.Message):
    __slots__ = ("joint_names", "links", "feet", "pose", "notes", "drawing")
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    LINKS_FIELD_NUMBER: _ClassVar[int]
    FEET_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    DRAWING_FIELD_NUMBER: _ClassVar[int]
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    links: _containers.RepeatedScalarFieldContainer[str]
    feet: _containers.RepeatedScalarFieldContainer[str]
    pose: SessionPose
    notes: _containers.RepeatedScalarFieldContainer[str]
    drawing: RobotDrawing
    def __init__(self, joint_names: _Optional[_Iterable[str]] = ..., links: _Optional[_Iterable[str]] = ..., feet: _Optional[_Iterable[str]] = ..., pose: _Optional[_Union[SessionPose, _Mapping]] = ..., notes: _Optional[_Iterable[str]] = ..., drawing: _Optional[_Union[RobotDrawing, _Mapping]] = ...) -> None: ...

class RobotDrawing(_message.Message):
    __slots__ = ("joints", "bodies", "frames", "tools")
    class ToolsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    TOOLS_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.RepeatedCompositeFieldContainer[DrawnJoint]
    bodies: _containers.RepeatedCompositeFieldContainer[DrawnBody]
    frames: _containers.RepeatedCompositeFieldContainer[DrawnFrame]
    tools: _containers.ScalarMap[str, str]
    def __init__(self, joints: _Optional[_Iterable[_Union[DrawnJoint, _Mapping]]] = ..., bodies: _Optional[_Iterable[_Union[DrawnBody, _Mapping]]] = ..., frames: _Optional[_Iterable[_Union[DrawnFrame, _Mapping]]] = ..., tools: _Optional[_Mapping[str, str]] = ...) -> None: ...

class DrawnJoint(_message.Message):
    __slots__ = ("parent", "rest", "motion", "position")
    PARENT_FIELD_NUMBER: _ClassVar[int]
    REST_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    parent: int
    rest: _containers.RepeatedScalarFieldContainer[float]
    motion: _containers.RepeatedScalarFieldContainer[float]
    position: int
    def __init__(self, parent: _Optional[int] = ..., rest: _Optional[_Iterable[float]] = ..., motion: _Optional[_Iterable[float]] = ..., position: _Optional[int] = ...) -> None: ...

class DrawnBody(_message.Message):
    __slots__ = ("name", "link", "joint", "vertices")
    NAME_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    JOINT_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    name: str
    link: str
    joint: int
    vertices: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., link: _Optional[str] = ..., joint: _Optional[int] = ..., vertices: _Optional[_Iterable[float]] = ...) -> None: ...

class DrawnFrame(_message.Message):
    __slots__ = ("name", "joint", "pose")
    NAME_FIELD_NUMBER: _ClassVar[int]
    JOINT_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    name: str
    joint: int
    pose: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., joint: _Optional[int] = ..., pose: _Optional[_Iterable[float]] = ...) -> None: ...

class SessionPose(_message.Message):
    __slots__ = ("number", "revision", "is_checked", "base", "positions", "miss_m", "miss_rad", "stops", "clearance_m", "balance_margin_m", "torque_share", "undo_steps", "redo_steps", "refusal")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    REVISION_FIELD_NUMBER: _ClassVar[int]
    IS_CHECKED_FIELD_NUMBER: _ClassVar[int]
    BASE_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    MISS_M_FIELD_NUMBER: _ClassVar[int]
    MISS_RAD_FIELD_NUMBER: _ClassVar[int]
    STOPS_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    BALANCE_MARGIN_M_FIELD_NUMBER: _ClassVar[int]
    TORQUE_SHARE_FIELD_NUMBER: _ClassVar[int]
    UNDO_STEPS_FIELD_NUMBER: _ClassVar[int]
    REDO_STEPS_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    number: int
    revision: int
    is_checked: bool
    base: _containers.RepeatedScalarFieldContainer[float]
    positions: _containers.RepeatedScalarFieldContainer[float]
    miss_m: _containers.RepeatedScalarFieldContainer[float]
    miss_rad: _containers.RepeatedScalarFieldContainer[float]
    stops: _containers.RepeatedCompositeFieldContainer[PoseStop]
    clearance_m: float
    balance_margin_m: float
    torque_share: float
    undo_steps: int
    redo_steps: int
    refusal: str
    def __init__(self, number: _Optional[int] = ..., revision: _Optional[int] = ..., is_checked: bool = ..., base: _Optional[_Iterable[float]] = ..., positions: _Optional[_Iterable[float]] = ..., miss_m: _Optional[_Iterable[float]] = ..., miss_rad: _Optional[_Iterable[float]] = ..., stops: _Optional[_Iterable[_Union[PoseStop, _Mapping]]] = ..., clearance_m: _Optional[float] = ..., balance_margin_m: _Optional[float] = ..., torque_share: _Optional[float] = ..., undo_steps: _Optional[int] = ..., redo_steps: _Optional[int] = ..., refusal: _Optional[str] = ...) -> None: ...

class PoseStop(_message.Message):
    __slots__ = ("kind", "names", "value", "text")
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    kind: PoseStopKind
    names: _containers.RepeatedScalarFieldContainer[str]
    value: float
    text: str
    def __init__(self, kind: _Optional[_Union[PoseStopKind, str]] = ..., names: _Optional[_Iterable[str]] = ..., value: _Optional[float] = ..., text: _Optional[str] = ...) -> None: ...
