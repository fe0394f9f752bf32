from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Verdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    VERDICT_UNSPECIFIED: _ClassVar[Verdict]
    VERDICT_CERTIFIED: _ClassVar[Verdict]
    VERDICT_FEASIBLE_AT_SAMPLES: _ClassVar[Verdict]
    VERDICT_NOT_FOUND: _ClassVar[Verdict]
    VERDICT_INFEASIBLE: _ClassVar[Verdict]
    VERDICT_TIME_LIMIT: _ClassVar[Verdict]
    VERDICT_CANCELLED: _ClassVar[Verdict]
    VERDICT_INVALID_REQUEST: _ClassVar[Verdict]
VERDICT_UNSPECIFIED: Verdict
VERDICT_CERTIFIED: Verdict
VERDICT_FEASIBLE_AT_SAMPLES: Verdict
VERDICT_NOT_FOUND: Verdict
VERDICT_INFEASIBLE: Verdict
VERDICT_TIME_LIMIT: Verdict
VERDICT_CANCELLED: Verdict
VERDICT_INVALID_REQUEST: Verdict

class MotionResult(_message.Message):
    __slots__ = ("verdict", "explanation", "notes", "found_from", "request_sha256", "trajectory", "certificate", "planning_time_s", "timings", "figures", "detections", "conflict", "phases")
    class TimingsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    EXPLANATION_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    FOUND_FROM_FIELD_NUMBER: _ClassVar[int]
    REQUEST_SHA256_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_FIELD_NUMBER: _ClassVar[int]
    PLANNING_TIME_S_FIELD_NUMBER: _ClassVar[int]
    TIMINGS_FIELD_NUMBER: _ClassVar[int]
    FIGURES_FIELD_NUMBER: _ClassVar[int]
    DETECTIONS_FIELD_NUMBER: _ClassVar[int]
    CONFLICT_FIELD_NUMBER: _ClassVar[int]
    PHASES_FIELD_NUMBER: _ClassVar[int]
    verdict: Verdict
    explanation: _containers.RepeatedScalarFieldContainer[str]
    notes: _containers.RepeatedScalarFieldContainer[str]
    found_from: str
    request_sha256: str
    trajectory: Trajectory
    certificate: Certificate
    planning_time_s: float
    timings: _containers.ScalarMap[str, float]
    figures: _struct_pb2.Struct
    detections: _containers.RepeatedCompositeFieldContainer[_struct_pb2.Struct]
    conflict: _struct_pb2.Struct
    phases: _containers.RepeatedCompositeFieldContainer[PhaseReport]
    def __init__(self, verdict: _Optional[_Union[Verdict, str]] = ..., explanation: _Optional[_Iterable[str]] = ..., notes: _Optional[_Iterable[str]] = ..., found_from: _Optional[str] = ..., request_sha256: _Optional[str] = ..., trajectory: _Optional[_Union[Trajectory, _Mapping]] = ..., certificate: _Optional[_Union[Certificate, _Mapping]] = ..., planning_time_s: _Optional[float] = ..., timings: _Optional[_Mapping[str, float]] = ..., figures: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., detections: _Optional[_Iterable[_Union[_struct_pb2.Struct, _Mapping]]] = ..., conflict: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., phases: _Optional[_Iterable[_Union[PhaseReport, _Mapping]]] = ...) -> None: ...

class Trajectory(_message.Message):
    __slots__ = ("joint_names", "times", "positions", "phases", "is_timed", "sha256")
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    TIMES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    PHASES_FIELD_NUMBER: _ClassVar[int]
    IS_TIMED_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    times: _containers.RepeatedScalarFieldContainer[float]
    positions: _containers.RepeatedScalarFieldContainer[float]
    phases: _containers.RepeatedCompositeFieldContainer[PhaseTimes]
    is_timed: bool
    sha256: str
    def __init__(self, joint_names: _Optional[_Iterable[str]] = ..., times: _Optional[_Iterable[float]] = ..., positions: _Optional[_Iterable[float]] = ..., phases: _Optional[_Iterable[_Union[PhaseTimes, _Mapping]]] = ..., is_timed: bool = ..., sha256: _Optional[str] = ...) -> None: ...

class PhaseTimes(_message.Message):
    __slots__ = ("name", "start_s", "end_s")
    NAME_FIELD_NUMBER: _ClassVar[int]
    START_S_FIELD_NUMBER: _ClassVar[int]
    END_S_FIELD_NUMBER: _ClassVar[int]
    name: str
    start_s: float
    end_s: float
    def __init__(self, name: _Optional[str] = ..., start_s: _Optional[float] = ..., end_s: _Optional[float] = ...) -> None: ...

class PhaseReport(_message.Message):
    __slots__ = ("name", "status", "checks", "start_s", "end_s")
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    CHECKS_FIELD_NUMBER: _ClassVar[int]
    START_S_FIELD_NUMBER: _ClassVar[int]
    END_S_FIELD_NUMBER: _ClassVar[int]
    name: str
    status: str
    checks: _containers.RepeatedScalarFieldContainer[int]
    start_s: float
    end_s: float
    def __init__(self, name: _Optional[str] = ..., status: _Optional[str] = ..., checks: _Optional[_Iterable[int]] = ..., start_s: _Optional[float] = ..., end_s: _Optional[float] = ...) -> None: ...

class Certificate(_message.Message):
    __slots__ = ("status", "checks", "min_clearance_m", "min_clearance_pair", "min_balance_margin_m", "json", "sha256")
    STATUS_FIELD_NUMBER: _ClassVar[int]
    CHECKS_FIELD_NUMBER: _ClassVar[int]
    MIN_CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    MIN_CLEARANCE_PAIR_FIELD_NUMBER: _ClassVar[int]
    MIN_BALANCE_MARGIN_M_FIELD_NUMBER: _ClassVar[int]
    JSON_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    status: str
    checks: _containers.RepeatedCompositeFieldContainer[Check]
    min_clearance_m: float
    min_clearance_pair: _containers.RepeatedScalarFieldContainer[str]
    min_balance_margin_m: float
    json: bytes
    sha256: str
    def __init__(self, status: _Optional[str] = ..., checks: _Optional[_Iterable[_Union[Check, _Mapping]]] = ..., min_clearance_m: _Optional[float] = ..., min_clearance_pair: _Optional[_Iterable[str]] = ..., min_balance_margin_m: _Optional[float] = ..., json: _Optional[bytes] = ..., sha256: _Optional[str] = ...) -> None: ...

class Check(_message.Message):
    __slots__ = ("name", "ok", "value", "limit", "unit", "text", "basis")
    NAME_FIELD_NUMBER: _ClassVar[int]
    OK_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    BASIS_FIELD_NUMBER: _ClassVar[int]
    name: str
    ok: bool
    value: float
    limit: float
    unit: str
    text: str
    basis: str
    def __init__(self, name: _Optional[str] = ..., ok: bool = ..., value: _Optional[float] = ..., limit: _Optional[float] = ..., unit: _Optional[str] = ..., text: _Optional[str] = ..., basis: _Optional[str] = ...) -> None: ...

class FileChunk(_message.Message):
    __slots__ = ("path", "data", "is_last")
    PATH_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    IS_LAST_FIELD_NUMBER: _ClassVar[int]
    path: str
    data: bytes
    is_last: bool
    def __init__(self, path: _Optional[str] = ..., data: _Optional[bytes] = ..., is_last: bool = ...) -> None: ...
