import datetime

from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Order(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ORDER_UNSPECIFIED: _ClassVar[Order]
    ORDER_START: _ClassVar[Order]
    ORDER_PAUSE: _ClassVar[Order]
    ORDER_RESUME: _ClassVar[Order]
    ORDER_STOP: _ClassVar[Order]
    ORDER_ABORT: _ClassVar[Order]
    ORDER_SPEED: _ClassVar[Order]
    ORDER_TAKE_CONTROL: _ClassVar[Order]
    ORDER_TAKE_OVER: _ClassVar[Order]
    ORDER_RELEASE_CONTROL: _ClassVar[Order]
    ORDER_SHIFT: _ClassVar[Order]
    ORDER_RETREAT: _ClassVar[Order]

class ExecutionMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    EXECUTION_MODE_UNSPECIFIED: _ClassVar[ExecutionMode]
    EXECUTION_MODE_IDLE: _ClassVar[ExecutionMode]
    EXECUTION_MODE_LOADING: _ClassVar[ExecutionMode]
    EXECUTION_MODE_READY: _ClassVar[ExecutionMode]
    EXECUTION_MODE_RUNNING: _ClassVar[ExecutionMode]
    EXECUTION_MODE_PAUSED: _ClassVar[ExecutionMode]
    EXECUTION_MODE_WAITING: _ClassVar[ExecutionMode]
    EXECUTION_MODE_RETURNING: _ClassVar[ExecutionMode]
    EXECUTION_MODE_HOLDING: _ClassVar[ExecutionMode]
    EXECUTION_MODE_ABORTED: _ClassVar[ExecutionMode]
    EXECUTION_MODE_FALLEN: _ClassVar[ExecutionMode]
    EXECUTION_MODE_DONE: _ClassVar[ExecutionMode]
    EXECUTION_MODE_LOST: _ClassVar[ExecutionMode]
ORDER_UNSPECIFIED: Order
ORDER_START: Order
ORDER_PAUSE: Order
ORDER_RESUME: Order
ORDER_STOP: Order
ORDER_ABORT: Order
ORDER_SPEED: Order
ORDER_TAKE_CONTROL: Order
ORDER_TAKE_OVER: Order
ORDER_RELEASE_CONTROL: Order
ORDER_SHIFT: Order
ORDER_RETREAT: Order
EXECUTION_MODE_UNSPECIFIED: ExecutionMode
EXECUTION_MODE_IDLE: ExecutionMode
EXECUTION_MODE_LOADING: ExecutionMode
EXECUTION_MODE_READY: ExecutionMode
EXECUTION_MODE_RUNNING: ExecutionMode
EXECUTION_MODE_PAUSED: ExecutionMode
EXECUTION_MODE_WAITING: ExecutionMode
EXECUTION_MODE_RETURNING: ExecutionMode
EXECUTION_MODE_HOLDING: ExecutionMode
EXECUTION_MODE_ABORTED: ExecutionMode
EXECUTION_MODE_FALLEN: ExecutionMode
EXECUTION_MODE_DONE: ExecutionMode
EXECUTION_MODE_LOST: ExecutionMode

class ExecuteRequest(_message.Message):
    __slots__ = ("plan_id", "trajectory_sha256", "approval", "start_tolerance", "lease", "expected_revision", "waits_for_start", "is_placed", "accepted_scan_age_s", "lets_go")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_SHA256_FIELD_NUMBER: _ClassVar[int]
    APPROVAL_FIELD_NUMBER: _ClassVar[int]
    START_TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_REVISION_FIELD_NUMBER: _ClassVar[int]
    WAITS_FOR_START_FIELD_NUMBER: _ClassVar[int]
    IS_PLACED_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_SCAN_AGE_S_FIELD_NUMBER: _ClassVar[int]
    LETS_GO_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    trajectory_sha256: str
    approval: bytes
    start_tolerance: float
    lease: str
    expected_revision: int
    waits_for_start: bool
    is_placed: bool
    accepted_scan_age_s: float
    lets_go: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, plan_id: _Optional[str] = ..., trajectory_sha256: _Optional[str] = ..., approval: _Optional[bytes] = ..., start_tolerance: _Optional[float] = ..., lease: _Optional[str] = ..., expected_revision: _Optional[int] = ..., waits_for_start: bool = ..., is_placed: bool = ..., accepted_scan_age_s: _Optional[float] = ..., lets_go: _Optional[_Iterable[str]] = ...) -> None: ...

class ExecuteResponse(_message.Message):
    __slots__ = ("revision", "trajectory_sha256")
    REVISION_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_SHA256_FIELD_NUMBER: _ClassVar[int]
    revision: int
    trajectory_sha256: str
    def __init__(self, revision: _Optional[int] = ..., trajectory_sha256: _Optional[str] = ...) -> None: ...

class CommandRequest(_message.Message):
    __slots__ = ("order", "expected_revision", "lease", "speed", "station", "link", "offset_m")
    ORDER_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_REVISION_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    STATION_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    OFFSET_M_FIELD_NUMBER: _ClassVar[int]
    order: Order
    expected_revision: int
    lease: str
    speed: float
    station: str
    link: str
    offset_m: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, order: _Optional[_Union[Order, str]] = ..., expected_revision: _Optional[int] = ..., lease: _Optional[str] = ..., speed: _Optional[float] = ..., station: _Optional[str] = ..., link: _Optional[str] = ..., offset_m: _Optional[_Iterable[float]] = ...) -> None: ...

class CommandResponse(_message.Message):
    __slots__ = ("revision", "lease")
    REVISION_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    revision: int
    lease: str
    def __init__(self, revision: _Optional[int] = ..., lease: _Optional[str] = ...) -> None: ...

class WatchRequest(_message.Message):
    __slots__ = ("lease", "rate_hz")
    LEASE_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    lease: str
    rate_hz: float
    def __init__(self, lease: _Optional[str] = ..., rate_hz: _Optional[float] = ...) -> None: ...

class WatchResponse(_message.Message):
    __slots__ = ("revision", "is_snapshot", "time", "status", "plan", "control", "pose")
    REVISION_FIELD_NUMBER: _ClassVar[int]
    IS_SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    PLAN_FIELD_NUMBER: _ClassVar[int]
    CONTROL_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    revision: int
    is_snapshot: bool
    time: _timestamp_pb2.Timestamp
    status: ExecutionStatus
    plan: LoadedPlan
    control: ControlHolder
    pose: RobotPose
    def __init__(self, revision: _Optional[int] = ..., is_snapshot: bool = ..., time: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., status: _Optional[_Union[ExecutionStatus, _Mapping]] = ..., plan: _Optional[_Union[LoadedPlan, _Mapping]] = ..., control: _Optional[_Union[ControlHolder, _Mapping]] = ..., pose: _Optional[_Union[RobotPose, _Mapping]] = ...) -> None: ...

class ExecutionStatus(_message.Message):
    __slots__ = ("mode", "phase", "reason", "findings", "speed", "last_order", "shifts", "held")
    MODE_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    FINDINGS_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    LAST_ORDER_FIELD_NUMBER: _ClassVar[int]
    SHIFTS_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    mode: ExecutionMode
    phase: str
    reason: str
    findings: _containers.RepeatedScalarFieldContainer[str]
    speed: float
    last_order: str
    shifts: _containers.RepeatedCompositeFieldContainer[ShiftedTarget]
    held: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, mode: _Optional[_Union[ExecutionMode, str]] = ..., phase: _Optional[str] = ..., reason: _Optional[str] = ..., findings: _Optional[_Iterable[str]] = ..., speed: _Optional[float] = ..., last_order: _Optional[str] = ..., shifts: _Optional[_Iterable[_Union[ShiftedTarget, _Mapping]]] = ..., held: _Optional[_Iterable[str]] = ...) -> None: ...

class ShiftedTarget(_message.Message):
    __slots__ = ("link", "offset_m")
    LINK_FIELD_NUMBER: _ClassVar[int]
    OFFSET_M_FIELD_NUMBER: _ClassVar[int]
    link: str
    offset_m: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, link: _Optional[str] = ..., offset_m: _Optional[_Iterable[float]] = ...) -> None: ...

class LoadedPlan(_message.Message):
    __slots__ = ("plan_id", "trajectory_sha256", "certificate_sha256", "scene_sha256", "phases", "duration_s", "joint_names", "unwatched", "guards_json", "shiftable")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_SHA256_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_SHA256_FIELD_NUMBER: _ClassVar[int]
    SCENE_SHA256_FIELD_NUMBER: _ClassVar[int]
    PHASES_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    UNWATCHED_FIELD_NUMBER: _ClassVar[int]
    GUARDS_JSON_FIELD_NUMBER: _ClassVar[int]
    SHIFTABLE_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    trajectory_sha256: str
    certificate_sha256: str
    scene_sha256: str
    phases: _containers.RepeatedScalarFieldContainer[str]
    duration_s: float
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    unwatched: _containers.RepeatedScalarFieldContainer[str]
    guards_json: str
    shiftable: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, plan_id: _Optional[str] = ..., trajectory_sha256: _Optional[str] = ..., certificate_sha256: _Optional[str] = ..., scene_sha256: _Optional[str] = ..., phases: _Optional[_Iterable[str]] = ..., duration_s: _Optional[float] = ..., joint_names: _Optional[_Iterable[str]] = ..., unwatched: _Optional[_Iterable[str]] = ..., guards_json: _Optional[str] = ..., shiftable: _Optional[_Iterable[str]] = ...) -> None: ...

class ControlHolder(_message.Message):
    __slots__ = ("name", "station", "since", "is_present")
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATION_FIELD_NUMBER: _ClassVar[int]
    SINCE_FIELD_NUMBER: _ClassVar[int]
    IS_PRESENT_FIELD_NUMBER: _ClassVar[int]
    name: str
    station: str
    since: _timestamp_pb2.Timestamp
    is_present: bool
    def __init__(self, name: _Optional[str] = ..., station: _Optional[str] = ..., since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., is_present: bool = ...) -> None: ...

class RobotPose(_message.Message):
    __slots__ = ("clock_s", "rate", "measured", "planned", "measured_base", "planned_base", "forces")
    CLOCK_S_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    MEASURED_FIELD_NUMBER: _ClassVar[int]
    PLANNED_FIELD_NUMBER: _ClassVar[int]
    MEASURED_BASE_FIELD_NUMBER: _ClassVar[int]
    PLANNED_BASE_FIELD_NUMBER: _ClassVar[int]
    FORCES_FIELD_NUMBER: _ClassVar[int]
    clock_s: float
    rate: float
    measured: _containers.RepeatedScalarFieldContainer[float]
    planned: _containers.RepeatedScalarFieldContainer[float]
    measured_base: _containers.RepeatedScalarFieldContainer[float]
    planned_base: _containers.RepeatedScalarFieldContainer[float]
    forces: _containers.RepeatedCompositeFieldContainer[MeasuredForce]
    def __init__(self, clock_s: _Optional[float] = ..., rate: _Optional[float] = ..., measured: _Optional[_Iterable[float]] = ..., planned: _Optional[_Iterable[float]] = ..., measured_base: _Optional[_Iterable[float]] = ..., planned_base: _Optional[_Iterable[float]] = ..., forces: _Optional[_Iterable[_Union[MeasuredForce, _Mapping]]] = ...) -> None: ...

class MeasuredForce(_message.Message):
    __slots__ = ("link", "force", "planned")
    LINK_FIELD_NUMBER: _ClassVar[int]
    FORCE_FIELD_NUMBER: _ClassVar[int]
    PLANNED_FIELD_NUMBER: _ClassVar[int]
    link: str
    force: _containers.RepeatedScalarFieldContainer[float]
    planned: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, link: _Optional[str] = ..., force: _Optional[_Iterable[float]] = ..., planned: _Optional[_Iterable[float]] = ...) -> None: ...
