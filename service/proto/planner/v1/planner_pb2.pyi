import datetime

from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from service.proto.planner.v1 import execution_pb2 as _execution_pb2
from service.proto.planner.v1 import pose_pb2 as _pose_pb2
from service.proto.planner.v1 import request_pb2 as _request_pb2
from service.proto.planner.v1 import result_pb2 as _result_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Priority(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PRIORITY_UNSPECIFIED: _ClassVar[Priority]
    PRIORITY_INTERACTIVE: _ClassVar[Priority]
    PRIORITY_BATCH: _ClassVar[Priority]

class PartShape(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PART_SHAPE_UNSPECIFIED: _ClassVar[PartShape]
    PART_SHAPE_BOX: _ClassVar[PartShape]
    PART_SHAPE_CYLINDER: _ClassVar[PartShape]
    PART_SHAPE_CAPSULE: _ClassVar[PartShape]
    PART_SHAPE_WHEEL: _ClassVar[PartShape]
    PART_SHAPE_LEVER: _ClassVar[PartShape]

class StandingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STANDING_STATE_UNSPECIFIED: _ClassVar[StandingState]
    STANDING_STATE_HOLDS: _ClassVar[StandingState]
    STANDING_STATE_HELD_BEFORE: _ClassVar[StandingState]

class SimulationVerdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SIMULATION_VERDICT_UNSPECIFIED: _ClassVar[SimulationVerdict]
    SIMULATION_VERDICT_DONE: _ClassVar[SimulationVerdict]
    SIMULATION_VERDICT_STOOD: _ClassVar[SimulationVerdict]
    SIMULATION_VERDICT_FELL: _ClassVar[SimulationVerdict]

class PlanState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PLAN_STATE_UNSPECIFIED: _ClassVar[PlanState]
    PLAN_STATE_QUEUED: _ClassVar[PlanState]
    PLAN_STATE_RUNNING: _ClassVar[PlanState]
    PLAN_STATE_FINISHED: _ClassVar[PlanState]
    PLAN_STATE_LOST: _ClassVar[PlanState]

class Decision(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DECISION_UNSPECIFIED: _ClassVar[Decision]
    DECISION_ACCEPTED: _ClassVar[Decision]
    DECISION_REJECTED: _ClassVar[Decision]
PRIORITY_UNSPECIFIED: Priority
PRIORITY_INTERACTIVE: Priority
PRIORITY_BATCH: Priority
PART_SHAPE_UNSPECIFIED: PartShape
PART_SHAPE_BOX: PartShape
PART_SHAPE_CYLINDER: PartShape
PART_SHAPE_CAPSULE: PartShape
PART_SHAPE_WHEEL: PartShape
PART_SHAPE_LEVER: PartShape
STANDING_STATE_UNSPECIFIED: StandingState
STANDING_STATE_HOLDS: StandingState
STANDING_STATE_HELD_BEFORE: StandingState
SIMULATION_VERDICT_UNSPECIFIED: SimulationVerdict
SIMULATION_VERDICT_DONE: SimulationVerdict
SIMULATION_VERDICT_STOOD: SimulationVerdict
SIMULATION_VERDICT_FELL: SimulationVerdict
PLAN_STATE_UNSPECIFIED: PlanState
PLAN_STATE_QUEUED: PlanState
PLAN_STATE_RUNNING: PlanState
PLAN_STATE_FINISHED: PlanState
PLAN_STATE_LOST: PlanState
DECISION_UNSPECIFIED: Decision
DECISION_ACCEPTED: Decision
DECISION_REJECTED: Decision

class PlanRequest(_message.Message):
    __slots__ = ("request_id", "request", "with_files", "with_waypoints", "priority", "known_format", "is_direct")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    REQUEST_FIELD_NUMBER: _ClassVar[int]
    WITH_FILES_FIELD_NUMBER: _ClassVar[int]
    WITH_WAYPOINTS_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FORMAT_FIELD_NUMBER: _ClassVar[int]
    IS_DIRECT_FIELD_NUMBER: _ClassVar[int]
    request_id: str
    request: _request_pb2.MotionRequest
    with_files: bool
    with_waypoints: bool
    priority: Priority
    known_format: int
    is_direct: bool
    def __init__(self, request_id: _Optional[str] = ..., request: _Optional[_Union[_request_pb2.MotionRequest, _Mapping]] = ..., with_files: bool = ..., with_waypoints: bool = ..., priority: _Optional[_Union[Priority, str]] = ..., known_format: _Optional[int] = ..., is_direct: bool = ...) -> None: ...

class PlanResponse(_message.Message):
    __slots__ = ("accepted", "queued", "progress", "finished", "file")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    QUEUED_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    FINISHED_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    accepted: PlanAccepted
    queued: PlanQueued
    progress: PlanProgress
    finished: PlanFinished
    file: _result_pb2.FileChunk
    def __init__(self, accepted: _Optional[_Union[PlanAccepted, _Mapping]] = ..., queued: _Optional[_Union[PlanQueued, _Mapping]] = ..., progress: _Optional[_Union[PlanProgress, _Mapping]] = ..., finished: _Optional[_Union[PlanFinished, _Mapping]] = ..., file: _Optional[_Union[_result_pb2.FileChunk, _Mapping]] = ...) -> None: ...

class PlanAccepted(_message.Message):
    __slots__ = ("plan_id", "request_id", "is_known", "warnings")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    IS_KNOWN_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    request_id: str
    is_known: bool
    warnings: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, plan_id: _Optional[str] = ..., request_id: _Optional[str] = ..., is_known: bool = ..., warnings: _Optional[_Iterable[str]] = ...) -> None: ...

class PlanQueued(_message.Message):
    __slots__ = ("place", "expected_wait_s")
    PLACE_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_WAIT_S_FIELD_NUMBER: _ClassVar[int]
    place: int
    expected_wait_s: float
    def __init__(self, place: _Optional[int] = ..., expected_wait_s: _Optional[float] = ...) -> None: ...

class PlanProgress(_message.Message):
    __slots__ = ("step", "fraction", "iteration")
    STEP_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    ITERATION_FIELD_NUMBER: _ClassVar[int]
    step: str
    fraction: float
    iteration: Iteration
    def __init__(self, step: _Optional[str] = ..., fraction: _Optional[float] = ..., iteration: _Optional[_Union[Iteration, _Mapping]] = ...) -> None: ...

class Iteration(_message.Message):
    __slots__ = ("index", "merit", "mu", "trust_radius", "violations", "is_accepted", "joint_names", "waypoints")
    class ViolationsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    INDEX_FIELD_NUMBER: _ClassVar[int]
    MERIT_FIELD_NUMBER: _ClassVar[int]
    MU_FIELD_NUMBER: _ClassVar[int]
    TRUST_RADIUS_FIELD_NUMBER: _ClassVar[int]
    VIOLATIONS_FIELD_NUMBER: _ClassVar[int]
    IS_ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    WAYPOINTS_FIELD_NUMBER: _ClassVar[int]
    index: int
    merit: float
    mu: float
    trust_radius: float
    violations: _containers.ScalarMap[str, float]
    is_accepted: bool
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    waypoints: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, index: _Optional[int] = ..., merit: _Optional[float] = ..., mu: _Optional[float] = ..., trust_radius: _Optional[float] = ..., violations: _Optional[_Mapping[str, float]] = ..., is_accepted: bool = ..., joint_names: _Optional[_Iterable[str]] = ..., waypoints: _Optional[_Iterable[float]] = ...) -> None: ...

class PlanFinished(_message.Message):
    __slots__ = ("plan_id", "result")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    result: _result_pb2.MotionResult
    def __init__(self, plan_id: _Optional[str] = ..., result: _Optional[_Union[_result_pb2.MotionResult, _Mapping]] = ...) -> None: ...

class UploadCloudRequest(_message.Message):
    __slots__ = ("header", "chunk")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    header: CloudHeader
    chunk: bytes
    def __init__(self, header: _Optional[_Union[CloudHeader, _Mapping]] = ..., chunk: _Optional[bytes] = ...) -> None: ...

class CloudHeader(_message.Message):
    __slots__ = ("format", "sha256", "size_bytes")
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    format: str
    sha256: str
    size_bytes: int
    def __init__(self, format: _Optional[str] = ..., sha256: _Optional[str] = ..., size_bytes: _Optional[int] = ...) -> None: ...

class UploadCloudResponse(_message.Message):
    __slots__ = ("cloud_id", "size_bytes", "was_known")
    CLOUD_ID_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    WAS_KNOWN_FIELD_NUMBER: _ClassVar[int]
    cloud_id: str
    size_bytes: int
    was_known: bool
    def __init__(self, cloud_id: _Optional[str] = ..., size_bytes: _Optional[int] = ..., was_known: bool = ...) -> None: ...

class CloudsSpec(_message.Message):
    __slots__ = ("clouds", "unit", "apply_viewpoint", "sensor", "reach_m", "robot", "start", "seed", "topic", "message", "top_m", "bottom_m", "level", "sensor_model", "sensor_sigma")
    CLOUDS_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    APPLY_VIEWPOINT_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    REACH_M_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    TOP_M_FIELD_NUMBER: _ClassVar[int]
    BOTTOM_M_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    SENSOR_MODEL_FIELD_NUMBER: _ClassVar[int]
    SENSOR_SIGMA_FIELD_NUMBER: _ClassVar[int]
    clouds: _containers.RepeatedCompositeFieldContainer[_request_pb2.CloudFile]
    unit: _request_pb2.LengthUnit
    apply_viewpoint: bool
    sensor: _containers.RepeatedScalarFieldContainer[float]
    reach_m: float
    robot: str
    start: _request_pb2.Start
    seed: int
    topic: str
    message: _request_pb2.MessageNumber
    top_m: float
    bottom_m: float
    level: bool
    sensor_model: _request_pb2.SensorModel
    sensor_sigma: float
    def __init__(self, clouds: _Optional[_Iterable[_Union[_request_pb2.CloudFile, _Mapping]]] = ..., unit: _Optional[_Union[_request_pb2.LengthUnit, str]] = ..., apply_viewpoint: bool = ..., sensor: _Optional[_Iterable[float]] = ..., reach_m: _Optional[float] = ..., robot: _Optional[str] = ..., start: _Optional[_Union[_request_pb2.Start, _Mapping]] = ..., seed: _Optional[int] = ..., topic: _Optional[str] = ..., message: _Optional[_Union[_request_pb2.MessageNumber, _Mapping]] = ..., top_m: _Optional[float] = ..., bottom_m: _Optional[float] = ..., level: bool = ..., sensor_model: _Optional[_Union[_request_pb2.SensorModel, str]] = ..., sensor_sigma: _Optional[float] = ...) -> None: ...

class BuildSceneRequest(_message.Message):
    __slots__ = ("clouds", "detect", "hint", "unknown", "method", "meshes", "update")
    CLOUDS_FIELD_NUMBER: _ClassVar[int]
    DETECT_FIELD_NUMBER: _ClassVar[int]
    HINT_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    MESHES_FIELD_NUMBER: _ClassVar[int]
    UPDATE_FIELD_NUMBER: _ClassVar[int]
    clouds: CloudsSpec
    detect: _containers.RepeatedScalarFieldContainer[str]
    hint: _containers.RepeatedScalarFieldContainer[float]
    unknown: _request_pb2.UnknownSpace
    method: _request_pb2.PieceMethod
    meshes: _containers.RepeatedCompositeFieldContainer[KnownMesh]
    update: str
    def __init__(self, clouds: _Optional[_Union[CloudsSpec, _Mapping]] = ..., detect: _Optional[_Iterable[str]] = ..., hint: _Optional[_Iterable[float]] = ..., unknown: _Optional[_Union[_request_pb2.UnknownSpace, str]] = ..., method: _Optional[_Union[_request_pb2.PieceMethod, str]] = ..., meshes: _Optional[_Iterable[_Union[KnownMesh, _Mapping]]] = ..., update: _Optional[str] = ...) -> None: ...

class KnownMesh(_message.Message):
    __slots__ = ("file", "name", "scale", "position", "quaternion_wxyz", "is_placed", "parts")
    FILE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    IS_PLACED_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    file: str
    name: str
    scale: float
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    is_placed: bool
    parts: _containers.RepeatedCompositeFieldContainer[ObjectPart]
    def __init__(self, file: _Optional[str] = ..., name: _Optional[str] = ..., scale: _Optional[float] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., is_placed: bool = ..., parts: _Optional[_Iterable[_Union[ObjectPart, _Mapping]]] = ...) -> None: ...

class ObjectPart(_message.Message):
    __slots__ = ("type", "position", "quaternion_wxyz", "size", "radius", "height", "rim_radius", "spokes", "spoke_radius", "hub_radius", "length", "grip_length", "grip_radius")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    RIM_RADIUS_FIELD_NUMBER: _ClassVar[int]
    SPOKES_FIELD_NUMBER: _ClassVar[int]
    SPOKE_RADIUS_FIELD_NUMBER: _ClassVar[int]
    HUB_RADIUS_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    GRIP_LENGTH_FIELD_NUMBER: _ClassVar[int]
    GRIP_RADIUS_FIELD_NUMBER: _ClassVar[int]
    type: PartShape
    position: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    size: _containers.RepeatedScalarFieldContainer[float]
    radius: float
    height: float
    rim_radius: float
    spokes: int
    spoke_radius: float
    hub_radius: float
    length: float
    grip_length: float
    grip_radius: float
    def __init__(self, type: _Optional[_Union[PartShape, str]] = ..., position: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., size: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., height: _Optional[float] = ..., rim_radius: _Optional[float] = ..., spokes: _Optional[int] = ..., spoke_radius: _Optional[float] = ..., hub_radius: _Optional[float] = ..., length: _Optional[float] = ..., grip_length: _Optional[float] = ..., grip_radius: _Optional[float] = ...) -> None: ...

class BuildSceneResponse(_message.Message):
    __slots__ = ("step", "scene")
    STEP_FIELD_NUMBER: _ClassVar[int]
    SCENE_FIELD_NUMBER: _ClassVar[int]
    step: str
    scene: BuiltScene
    def __init__(self, step: _Optional[str] = ..., scene: _Optional[_Union[BuiltScene, _Mapping]] = ...) -> None: ...

class GetSceneRequest(_message.Message):
    __slots__ = ("scene_id",)
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    def __init__(self, scene_id: _Optional[str] = ...) -> None: ...

class GetSceneResponse(_message.Message):
    __slots__ = ("scene",)
    SCENE_FIELD_NUMBER: _ClassVar[int]
    scene: BuiltScene
    def __init__(self, scene: _Optional[_Union[BuiltScene, _Mapping]] = ...) -> None: ...

class BuiltScene(_message.Message):
    __slots__ = ("scene_id", "pieces", "detections", "figures", "notes", "json")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PIECES_FIELD_NUMBER: _ClassVar[int]
    DETECTIONS_FIELD_NUMBER: _ClassVar[int]
    FIGURES_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    JSON_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    pieces: _containers.RepeatedCompositeFieldContainer[Piece]
    detections: _containers.RepeatedCompositeFieldContainer[Detection]
    figures: _struct_pb2.Struct
    notes: _containers.RepeatedScalarFieldContainer[str]
    json: bytes
    def __init__(self, scene_id: _Optional[str] = ..., pieces: _Optional[_Iterable[_Union[Piece, _Mapping]]] = ..., detections: _Optional[_Iterable[_Union[Detection, _Mapping]]] = ..., figures: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., notes: _Optional[_Iterable[str]] = ..., json: _Optional[bytes] = ...) -> None: ...

class Piece(_message.Message):
    __slots__ = ("name", "kind", "vertices")
    NAME_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    name: str
    kind: str
    vertices: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., kind: _Optional[str] = ..., vertices: _Optional[_Iterable[float]] = ...) -> None: ...

class Detection(_message.Message):
    __slots__ = ("kind", "confidence", "pose_world_object", "sizes", "residuals", "doubts")
    class SizesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    class ResidualsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    KIND_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    POSE_WORLD_OBJECT_FIELD_NUMBER: _ClassVar[int]
    SIZES_FIELD_NUMBER: _ClassVar[int]
    RESIDUALS_FIELD_NUMBER: _ClassVar[int]
    DOUBTS_FIELD_NUMBER: _ClassVar[int]
    kind: str
    confidence: float
    pose_world_object: _containers.RepeatedScalarFieldContainer[float]
    sizes: _containers.ScalarMap[str, float]
    residuals: _containers.ScalarMap[str, float]
    doubts: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, kind: _Optional[str] = ..., confidence: _Optional[float] = ..., pose_world_object: _Optional[_Iterable[float]] = ..., sizes: _Optional[_Mapping[str, float]] = ..., residuals: _Optional[_Mapping[str, float]] = ..., doubts: _Optional[_Iterable[str]] = ...) -> None: ...

class DetectRequest(_message.Message):
    __slots__ = ("clouds", "kind", "hint", "objects")
    CLOUDS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    HINT_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    clouds: CloudsSpec
    kind: str
    hint: _containers.RepeatedScalarFieldContainer[float]
    objects: _containers.RepeatedCompositeFieldContainer[KnownMesh]
    def __init__(self, clouds: _Optional[_Union[CloudsSpec, _Mapping]] = ..., kind: _Optional[str] = ..., hint: _Optional[_Iterable[float]] = ..., objects: _Optional[_Iterable[_Union[KnownMesh, _Mapping]]] = ...) -> None: ...

class DetectResponse(_message.Message):
    __slots__ = ("hits", "notes")
    HITS_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    hits: _containers.RepeatedCompositeFieldContainer[Detection]
    notes: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, hits: _Optional[_Iterable[_Union[Detection, _Mapping]]] = ..., notes: _Optional[_Iterable[str]] = ...) -> None: ...

class VerifyRequest(_message.Message):
    __slots__ = ("plan_id", "files")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    files: _containers.RepeatedCompositeFieldContainer[_result_pb2.FileChunk]
    def __init__(self, plan_id: _Optional[str] = ..., files: _Optional[_Iterable[_Union[_result_pb2.FileChunk, _Mapping]]] = ...) -> None: ...

class VerifyResponse(_message.Message):
    __slots__ = ("verdict", "explanation", "notes", "checks", "min_clearance_m", "min_balance_margin_m", "held_to", "standing")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    EXPLANATION_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    CHECKS_FIELD_NUMBER: _ClassVar[int]
    MIN_CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    MIN_BALANCE_MARGIN_M_FIELD_NUMBER: _ClassVar[int]
    HELD_TO_FIELD_NUMBER: _ClassVar[int]
    STANDING_FIELD_NUMBER: _ClassVar[int]
    verdict: _result_pb2.Verdict
    explanation: _containers.RepeatedScalarFieldContainer[str]
    notes: _containers.RepeatedScalarFieldContainer[str]
    checks: _containers.RepeatedCompositeFieldContainer[_result_pb2.Check]
    min_clearance_m: float
    min_balance_margin_m: float
    held_to: str
    standing: Standing
    def __init__(self, verdict: _Optional[_Union[_result_pb2.Verdict, str]] = ..., explanation: _Optional[_Iterable[str]] = ..., notes: _Optional[_Iterable[str]] = ..., checks: _Optional[_Iterable[_Union[_result_pb2.Check, _Mapping]]] = ..., min_clearance_m: _Optional[float] = ..., min_balance_margin_m: _Optional[float] = ..., held_to: _Optional[str] = ..., standing: _Optional[_Union[Standing, _Mapping]] = ...) -> None: ...

class Standing(_message.Message):
    __slots__ = ("state", "release", "format", "lacks", "fails")
    STATE_FIELD_NUMBER: _ClassVar[int]
    RELEASE_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    LACKS_FIELD_NUMBER: _ClassVar[int]
    FAILS_FIELD_NUMBER: _ClassVar[int]
    state: StandingState
    release: str
    format: int
    lacks: _containers.RepeatedScalarFieldContainer[str]
    fails: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, state: _Optional[_Union[StandingState, str]] = ..., release: _Optional[str] = ..., format: _Optional[int] = ..., lacks: _Optional[_Iterable[str]] = ..., fails: _Optional[_Iterable[str]] = ...) -> None: ...

class SimulatePlanRequest(_message.Message):
    __slots__ = ("plan_id", "files", "friction", "feed_forward", "stiffness_scale", "noise", "delay_ms", "joint_friction", "seed", "perturb", "hand_friction")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    FRICTION_FIELD_NUMBER: _ClassVar[int]
    FEED_FORWARD_FIELD_NUMBER: _ClassVar[int]
    STIFFNESS_SCALE_FIELD_NUMBER: _ClassVar[int]
    NOISE_FIELD_NUMBER: _ClassVar[int]
    DELAY_MS_FIELD_NUMBER: _ClassVar[int]
    JOINT_FRICTION_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    PERTURB_FIELD_NUMBER: _ClassVar[int]
    HAND_FRICTION_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    files: _containers.RepeatedCompositeFieldContainer[_result_pb2.FileChunk]
    friction: float
    feed_forward: float
    stiffness_scale: float
    noise: float
    delay_ms: float
    joint_friction: float
    seed: int
    perturb: float
    hand_friction: float
    def __init__(self, plan_id: _Optional[str] = ..., files: _Optional[_Iterable[_Union[_result_pb2.FileChunk, _Mapping]]] = ..., friction: _Optional[float] = ..., feed_forward: _Optional[float] = ..., stiffness_scale: _Optional[float] = ..., noise: _Optional[float] = ..., delay_ms: _Optional[float] = ..., joint_friction: _Optional[float] = ..., seed: _Optional[int] = ..., perturb: _Optional[float] = ..., hand_friction: _Optional[float] = ...) -> None: ...

class SimulatePlanResponse(_message.Message):
    __slots__ = ("has_stood", "explanation", "notes", "figures", "verdict")
    HAS_STOOD_FIELD_NUMBER: _ClassVar[int]
    EXPLANATION_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    FIGURES_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    has_stood: bool
    explanation: _containers.RepeatedScalarFieldContainer[str]
    notes: _containers.RepeatedScalarFieldContainer[str]
    figures: _struct_pb2.Struct
    verdict: SimulationVerdict
    def __init__(self, has_stood: bool = ..., explanation: _Optional[_Iterable[str]] = ..., notes: _Optional[_Iterable[str]] = ..., figures: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., verdict: _Optional[_Union[SimulationVerdict, str]] = ...) -> None: ...

class ListRobotsRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListRobotsResponse(_message.Message):
    __slots__ = ("robots",)
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    robots: _containers.RepeatedCompositeFieldContainer[RobotInfo]
    def __init__(self, robots: _Optional[_Iterable[_Union[RobotInfo, _Mapping]]] = ...) -> None: ...

class RobotInfo(_message.Message):
    __slots__ = ("name", "description", "joint_names", "postures", "contacts")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    POSTURES_FIELD_NUMBER: _ClassVar[int]
    CONTACTS_FIELD_NUMBER: _ClassVar[int]
    name: str
    description: str
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    postures: _containers.RepeatedScalarFieldContainer[str]
    contacts: _containers.RepeatedCompositeFieldContainer[ContactInfo]
    def __init__(self, name: _Optional[str] = ..., description: _Optional[str] = ..., joint_names: _Optional[_Iterable[str]] = ..., postures: _Optional[_Iterable[str]] = ..., contacts: _Optional[_Iterable[_Union[ContactInfo, _Mapping]]] = ...) -> None: ...

class ContactInfo(_message.Message):
    __slots__ = ("name", "link", "points", "normal", "friction", "force_cap_n")
    NAME_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    FRICTION_FIELD_NUMBER: _ClassVar[int]
    FORCE_CAP_N_FIELD_NUMBER: _ClassVar[int]
    name: str
    link: str
    points: _containers.RepeatedCompositeFieldContainer[_request_pb2.Point]
    normal: _containers.RepeatedScalarFieldContainer[float]
    friction: float
    force_cap_n: float
    def __init__(self, name: _Optional[str] = ..., link: _Optional[str] = ..., points: _Optional[_Iterable[_Union[_request_pb2.Point, _Mapping]]] = ..., normal: _Optional[_Iterable[float]] = ..., friction: _Optional[float] = ..., force_cap_n: _Optional[float] = ...) -> None: ...

class GetPlanRequest(_message.Message):
    __slots__ = ("plan_id", "with_files", "known_format")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    WITH_FILES_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FORMAT_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    with_files: bool
    known_format: int
    def __init__(self, plan_id: _Optional[str] = ..., with_files: bool = ..., known_format: _Optional[int] = ...) -> None: ...

class GetPlanResponse(_message.Message):
    __slots__ = ("record", "file")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    record: PlanRecord
    file: _result_pb2.FileChunk
    def __init__(self, record: _Optional[_Union[PlanRecord, _Mapping]] = ..., file: _Optional[_Union[_result_pb2.FileChunk, _Mapping]] = ...) -> None: ...

class PlanRecord(_message.Message):
    __slots__ = ("plan_id", "request_id", "state", "result", "reviews", "is_approved", "created", "finished", "reason", "page_sha256", "needs_review")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    REVIEWS_FIELD_NUMBER: _ClassVar[int]
    IS_APPROVED_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    FINISHED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    PAGE_SHA256_FIELD_NUMBER: _ClassVar[int]
    NEEDS_REVIEW_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    request_id: str
    state: PlanState
    result: _result_pb2.MotionResult
    reviews: _containers.RepeatedCompositeFieldContainer[Review]
    is_approved: bool
    created: _timestamp_pb2.Timestamp
    finished: _timestamp_pb2.Timestamp
    reason: str
    page_sha256: str
    needs_review: bool
    def __init__(self, plan_id: _Optional[str] = ..., request_id: _Optional[str] = ..., state: _Optional[_Union[PlanState, str]] = ..., result: _Optional[_Union[_result_pb2.MotionResult, _Mapping]] = ..., reviews: _Optional[_Iterable[_Union[Review, _Mapping]]] = ..., is_approved: bool = ..., created: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., finished: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., reason: _Optional[str] = ..., page_sha256: _Optional[str] = ..., needs_review: bool = ...) -> None: ...

class ListPlansRequest(_message.Message):
    __slots__ = ("state", "since", "task", "needs_review", "page_size", "page_token")
    STATE_FIELD_NUMBER: _ClassVar[int]
    SINCE_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    NEEDS_REVIEW_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    state: PlanState
    since: _timestamp_pb2.Timestamp
    task: str
    needs_review: bool
    page_size: int
    page_token: str
    def __init__(self, state: _Optional[_Union[PlanState, str]] = ..., since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., task: _Optional[str] = ..., needs_review: bool = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListPlansResponse(_message.Message):
    __slots__ = ("plans", "next_page_token")
    PLANS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    plans: _containers.RepeatedCompositeFieldContainer[PlanSummary]
    next_page_token: str
    def __init__(self, plans: _Optional[_Iterable[_Union[PlanSummary, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class PlanSummary(_message.Message):
    __slots__ = ("plan_id", "request_id", "client", "task", "state", "verdict", "created", "finished", "is_approved", "needs_review", "trajectory_sha256", "certificate_sha256", "page_sha256", "reason")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    CLIENT_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    FINISHED_FIELD_NUMBER: _ClassVar[int]
    IS_APPROVED_FIELD_NUMBER: _ClassVar[int]
    NEEDS_REVIEW_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_SHA256_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_SHA256_FIELD_NUMBER: _ClassVar[int]
    PAGE_SHA256_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    request_id: str
    client: str
    task: str
    state: PlanState
    verdict: _result_pb2.Verdict
    created: _timestamp_pb2.Timestamp
    finished: _timestamp_pb2.Timestamp
    is_approved: bool
    needs_review: bool
    trajectory_sha256: str
    certificate_sha256: str
    page_sha256: str
    reason: str
    def __init__(self, plan_id: _Optional[str] = ..., request_id: _Optional[str] = ..., client: _Optional[str] = ..., task: _Optional[str] = ..., state: _Optional[_Union[PlanState, str]] = ..., verdict: _Optional[_Union[_result_pb2.Verdict, str]] = ..., created: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., finished: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., is_approved: bool = ..., needs_review: bool = ..., trajectory_sha256: _Optional[str] = ..., certificate_sha256: _Optional[str] = ..., page_sha256: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class ListScenesRequest(_message.Message):
    __slots__ = ("since", "page_size", "page_token")
    SINCE_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    since: _timestamp_pb2.Timestamp
    page_size: int
    page_token: str
    def __init__(self, since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListScenesResponse(_message.Message):
    __slots__ = ("scenes", "next_page_token")
    SCENES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scenes: _containers.RepeatedCompositeFieldContainer[SceneSummary]
    next_page_token: str
    def __init__(self, scenes: _Optional[_Iterable[_Union[SceneSummary, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class SceneSummary(_message.Message):
    __slots__ = ("scene_id", "client", "created", "stored_bytes")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    CLIENT_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    STORED_BYTES_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    client: str
    created: _timestamp_pb2.Timestamp
    stored_bytes: int
    def __init__(self, scene_id: _Optional[str] = ..., client: _Optional[str] = ..., created: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., stored_bytes: _Optional[int] = ...) -> None: ...

class Review(_message.Message):
    __slots__ = ("decision", "reviewer", "comment", "trajectory_sha256", "certificate_sha256", "time", "page_sha256", "approval", "verdict", "expires")
    DECISION_FIELD_NUMBER: _ClassVar[int]
    REVIEWER_FIELD_NUMBER: _ClassVar[int]
    COMMENT_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_SHA256_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_SHA256_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    PAGE_SHA256_FIELD_NUMBER: _ClassVar[int]
    APPROVAL_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    EXPIRES_FIELD_NUMBER: _ClassVar[int]
    decision: Decision
    reviewer: str
    comment: str
    trajectory_sha256: str
    certificate_sha256: str
    time: _timestamp_pb2.Timestamp
    page_sha256: str
    approval: bytes
    verdict: _result_pb2.Verdict
    expires: _timestamp_pb2.Timestamp
    def __init__(self, decision: _Optional[_Union[Decision, str]] = ..., reviewer: _Optional[str] = ..., comment: _Optional[str] = ..., trajectory_sha256: _Optional[str] = ..., certificate_sha256: _Optional[str] = ..., time: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., page_sha256: _Optional[str] = ..., approval: _Optional[bytes] = ..., verdict: _Optional[_Union[_result_pb2.Verdict, str]] = ..., expires: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ...) -> None: ...

class ReviewPlanRequest(_message.Message):
    __slots__ = ("plan_id", "decision", "comment", "trajectory_sha256", "certificate_sha256", "page_sha256", "verdict", "despite", "valid_s")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    DECISION_FIELD_NUMBER: _ClassVar[int]
    COMMENT_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_SHA256_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_SHA256_FIELD_NUMBER: _ClassVar[int]
    PAGE_SHA256_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    DESPITE_FIELD_NUMBER: _ClassVar[int]
    VALID_S_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    decision: Decision
    comment: str
    trajectory_sha256: str
    certificate_sha256: str
    page_sha256: str
    verdict: _result_pb2.Verdict
    despite: _result_pb2.Verdict
    valid_s: float
    def __init__(self, plan_id: _Optional[str] = ..., decision: _Optional[_Union[Decision, str]] = ..., comment: _Optional[str] = ..., trajectory_sha256: _Optional[str] = ..., certificate_sha256: _Optional[str] = ..., page_sha256: _Optional[str] = ..., verdict: _Optional[_Union[_result_pb2.Verdict, str]] = ..., despite: _Optional[_Union[_result_pb2.Verdict, str]] = ..., valid_s: _Optional[float] = ...) -> None: ...

class ReviewPlanResponse(_message.Message):
    __slots__ = ("review",)
    REVIEW_FIELD_NUMBER: _ClassVar[int]
    review: Review
    def __init__(self, review: _Optional[_Union[Review, _Mapping]] = ...) -> None: ...

class GetStatusRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GetStatusResponse(_message.Message):
    __slots__ = ("version", "uptime_s", "queued", "queue_limit", "workers", "worker_restarts", "verdicts", "solve_p50_s", "solve_p99_s", "is_draining", "resident_bytes")
    class VerdictsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    VERSION_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    QUEUED_FIELD_NUMBER: _ClassVar[int]
    QUEUE_LIMIT_FIELD_NUMBER: _ClassVar[int]
    WORKERS_FIELD_NUMBER: _ClassVar[int]
    WORKER_RESTARTS_FIELD_NUMBER: _ClassVar[int]
    VERDICTS_FIELD_NUMBER: _ClassVar[int]
    SOLVE_P50_S_FIELD_NUMBER: _ClassVar[int]
    SOLVE_P99_S_FIELD_NUMBER: _ClassVar[int]
    IS_DRAINING_FIELD_NUMBER: _ClassVar[int]
    RESIDENT_BYTES_FIELD_NUMBER: _ClassVar[int]
    version: str
    uptime_s: float
    queued: int
    queue_limit: int
    workers: _containers.RepeatedCompositeFieldContainer[WorkerStatus]
    worker_restarts: int
    verdicts: _containers.ScalarMap[str, int]
    solve_p50_s: float
    solve_p99_s: float
    is_draining: bool
    resident_bytes: int
    def __init__(self, version: _Optional[str] = ..., uptime_s: _Optional[float] = ..., queued: _Optional[int] = ..., queue_limit: _Optional[int] = ..., workers: _Optional[_Iterable[_Union[WorkerStatus, _Mapping]]] = ..., worker_restarts: _Optional[int] = ..., verdicts: _Optional[_Mapping[str, int]] = ..., solve_p50_s: _Optional[float] = ..., solve_p99_s: _Optional[float] = ..., is_draining: bool = ..., resident_bytes: _Optional[int] = ...) -> None: ...

class WorkerStatus(_message.Message):
    __slots__ = ("pid", "state", "work", "jobs_done", "resident_bytes")
    PID_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    WORK_FIELD_NUMBER: _ClassVar[int]
    JOBS_DONE_FIELD_NUMBER: _ClassVar[int]
    RESIDENT_BYTES_FIELD_NUMBER: _ClassVar[int]
    pid: int
    state: str
    work: str
    jobs_done: int
    resident_bytes: int
    def __init__(self, pid: _Optional[int] = ..., state: _Optional[str] = ..., work: _Optional[str] = ..., jobs_done: _Optional[int] = ..., resident_bytes: _Optional[int] = ...) -> None: ...
