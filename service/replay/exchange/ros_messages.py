"""A recorded plan as messages of ROS 2: trajectories, the scene, and joint states to play back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from service.replay.exchange.recorded_plan import RecordedPlan
from service.replay.exchange.ros_types import DISPLAY_TRAJECTORY, JOINT_TRAJECTORY, PLANNING_SCENE, load_types

WORLD_FRAME = "world"
TRIANGLE_LIST = 11  # type of a marker
VIRTUAL_JOINT = "virtual_joint"  # of a floating base, as MoveIt's setup assistant names it
COLOURS = {"floor": (0.6, 0.6, 0.6, 0.5), "obstacle": (0.8, 0.5, 0.2, 0.9)}
EPOCH_NS = 10**9  # stamp of the first sample; some players treat 0 as unknown


@dataclass(frozen=True)
class StampedMessage:
    """A message with its topic, type and time since the beginning of the bag [ns]."""

    topic: str
    kind: str
    time_ns: int
    message: Any


def list_messages(plan: RecordedPlan) -> Iterator[StampedMessage]:
    """Yield what a bag of a plan holds: description, scene and trajectories first, then states sample by sample."""
    start = EPOCH_NS
    trajectory = _make_joint_trajectory(plan)
    yield StampedMessage(
        "/robot_description", "std_msgs/msg/String", start, make("std_msgs/msg/String", data=plan.urdf)
    )
    yield StampedMessage("/planning_scene", PLANNING_SCENE, start, _make_scene(plan))
    yield StampedMessage("/scene_markers", "visualization_msgs/msg/MarkerArray", start, _make_markers(plan))
    yield StampedMessage("/joint_trajectory", JOINT_TRAJECTORY, start, trajectory)
    yield StampedMessage("/display_planned_path", DISPLAY_TRAJECTORY, start, _make_display(plan, trajectory))
    for row, time in enumerate(plan.times):
        stamp = start + round(1e9 * float(time))
        yield StampedMessage("/joint_states", "sensor_msgs/msg/JointState", stamp, _make_state(plan, row, stamp))
        if plan.base is not None:
            transforms = [_make_transform(plan, row, stamp)]
            message = make("tf2_msgs/msg/TFMessage", transforms=transforms)
            yield StampedMessage("/tf", "tf2_msgs/msg/TFMessage", stamp, message)


def make_plain_trajectory(plan: RecordedPlan) -> dict[str, Any]:
    """Return the JointTrajectory message as plain data, as ``ros2 topic pub`` takes it."""
    points = []
    for row, time in enumerate(plan.times):
        point = {"positions": plan.positions[row].tolist(), "velocities": plan.velocities[row].tolist()}
        point |= {"accelerations": plan.accelerations[row].tolist()}
        points.append({**point, "time_from_start": _split(round(1e9 * float(time)))})
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": WORLD_FRAME}
    return {"header": header, "joint_names": list(plan.joint_names), "points": points}


def make(kind: str, **values: Any) -> Any:
    """Return a message; fields that are not given are zero, empty or false."""
    store = load_types()
    _, fields = store.fielddefs[kind]
    unknown = values.keys() - {name for name, _ in fields}
    if unknown:
        raise ValueError(f"{kind} has no field {min(unknown)}")
    return store.types[kind](**{name: values.get(name, _make_default(node)) for name, node in fields})


def _make_default(node: tuple[Any, Any]) -> Any:
    """Return the empty value of a field's type (base, named, array or sequence, in rosbags' numbering)."""
    kind, detail = int(node[0]), node[1]
    if kind == 1:
        return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
    if kind == 2:
        is_turn = detail == "geometry_msgs/msg/Quaternion"
        return make(detail, w=1.0) if is_turn else make(detail)
    (inner, inner_detail), length = detail
    if int(inner) == 1 and inner_detail[0] != "string":
        return np.zeros(length, dtype=inner_detail[0].replace("byte", "uint8"))
    return [_make_default((inner, inner_detail)) for _ in range(length)]


def _split(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def _duration(seconds: float) -> Any:
    return make("builtin_interfaces/msg/Duration", **_split(round(1e9 * float(seconds))))


def _header(time_ns: int = 0) -> Any:
    return make(
        "std_msgs/msg/Header", stamp=make("builtin_interfaces/msg/Time", **_split(time_ns)), frame_id=WORLD_FRAME
    )


def _make_joint_trajectory(plan: RecordedPlan) -> Any:
    points = [
        make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=plan.positions[row],
            velocities=plan.velocities[row],
            accelerations=plan.accelerations[row],
            time_from_start=_duration(time),
        )
        for row, time in enumerate(plan.times)
    ]
    return make(JOINT_TRAJECTORY, header=_header(), joint_names=list(plan.joint_names), points=points)


def _make_display(plan: RecordedPlan, trajectory: Any) -> Any:
    several = _make_base_trajectory(plan)
    start = _make_state(plan, 0, 0)
    robot = make("moveit_msgs/msg/RobotTrajectory", joint_trajectory=trajectory, multi_dof_joint_trajectory=several)
    base = make("sensor_msgs/msg/MultiDOFJointState", header=_header())
    if plan.base is not None:
        transform = _make_transform(plan, 0, 0).transform
        base = make(
            "sensor_msgs/msg/MultiDOFJointState",
            header=_header(),
            joint_names=[VIRTUAL_JOINT],
            transforms=[transform],
        )
    state = make("moveit_msgs/msg/RobotState", joint_state=start, multi_dof_joint_state=base)
    return make(DISPLAY_TRAJECTORY, model_id=plan.robot_name, trajectory=[robot], trajectory_start=state)


def _make_base_trajectory(plan: RecordedPlan) -> Any:
    kind = "trajectory_msgs/msg/MultiDOFJointTrajectory"
    if plan.base is None:
        return make(kind, header=_header())
    points = [
        make(
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
            transforms=[_make_transform(plan, row, 0).transform],
            velocities=[] if plan.base_velocities is None else [_make_twist(plan, row)],
            time_from_start=_duration(time),
        )
        for row, time in enumerate(plan.times)
    ]
    return make(kind, header=_header(), joint_names=[VIRTUAL_JOINT], points=points)


def _make_twist(plan: RecordedPlan, row: int) -> Any:
    """Return the base's velocity and angular velocity in the world's axes."""
    if plan.base is None or plan.base_velocities is None:
        raise ValueError("a fixed base has no velocity")
    x, y, z, yaws, pitches, rolls = (float(value) for value in plan.base_velocities[row])
    yaw, pitch, _ = Rotation.from_quat(plan.base[row, 3:], scalar_first=True).as_euler("ZYX")
    turn = (
        rolls * np.cos(yaw) * np.cos(pitch) - pitches * np.sin(yaw),
        rolls * np.sin(yaw) * np.cos(pitch) + pitches * np.cos(yaw),
        yaws - rolls * np.sin(pitch),
    )
    vector = "geometry_msgs/msg/Vector3"
    angular = make(vector, **dict(zip("xyz", map(float, turn), strict=True)))
    return make("geometry_msgs/msg/Twist", linear=make(vector, x=x, y=y, z=z), angular=angular)


def _make_state(plan: RecordedPlan, row: int, time_ns: int) -> Any:
    return make(
        "sensor_msgs/msg/JointState",
        header=_header(time_ns),
        name=list(plan.joint_names),
        position=plan.positions[row],
        velocity=plan.velocities[row],
    )


def _make_transform(plan: RecordedPlan, row: int, time_ns: int) -> Any:
    if plan.base is None:
        raise ValueError("a fixed base has no transform")
    x, y, z, qw, qx, qy, qz = (float(value) for value in plan.base[row])
    transform = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        rotation=make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=_header(time_ns),
        child_frame_id=plan.root_link,
        transform=transform,
    )


def _make_scene(plan: RecordedPlan) -> Any:
    """Return the pieces as a difference to MoveIt's planning scene, each a mesh in the world."""
    objects = []
    for name, (_, vertices) in plan.pieces.items():
        corners, triangles = triangulate(vertices)
        mesh = make(
            "shape_msgs/msg/Mesh",
            triangles=[
                make("shape_msgs/msg/MeshTriangle", vertex_indices=triangle.astype(np.uint32)) for triangle in triangles
            ],
            vertices=[_point(corner) for corner in corners],
        )
        objects.append(
            make(
                "moveit_msgs/msg/CollisionObject",
                header=_header(),
                id=name,
                meshes=[mesh],
                mesh_poses=[make("geometry_msgs/msg/Pose")],
            )
        )
    world = make("moveit_msgs/msg/PlanningSceneWorld", collision_objects=objects)
    state = make("moveit_msgs/msg/RobotState", is_diff=True)
    return make(
        PLANNING_SCENE, name="scopt", robot_state=state, robot_model_name=plan.robot_name, world=world, is_diff=True
    )


def _make_markers(plan: RecordedPlan) -> Any:
    markers = []
    for number, (name, (kind, vertices)) in enumerate(plan.pieces.items()):
        corners, triangles = triangulate(vertices)
        red, green, blue, alpha = COLOURS.get(kind, COLOURS["obstacle"])
        markers.append(
            make(
                "visualization_msgs/msg/Marker",
                header=_header(),
                ns=name,
                id=number,
                type=TRIANGLE_LIST,
                scale=make("geometry_msgs/msg/Vector3", x=1.0, y=1.0, z=1.0),
                color=make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha),
                points=[_point(corners[index]) for index in triangles.ravel()],
            )
        )
    return make("visualization_msgs/msg/MarkerArray", markers=markers)


def _point(corner: Float[np.ndarray, "3"]) -> Any:
    x, y, z = (float(value) for value in corner)
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def triangulate(vertices: Float[np.ndarray, "V 3"]) -> tuple[Float[np.ndarray, "C 3"], Int[np.ndarray, "F 3"]]:
    """Return corners and outward triangles of a convex piece; no triangle for a piece without volume."""
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        return vertices, np.zeros((0, 3), dtype=int)
    index = {int(old): new for new, old in enumerate(hull.vertices)}
    corners = vertices[hull.vertices]
    triangles = np.array([[index[int(v)] for v in simplex] for simplex in hull.simplices])
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    is_inward = np.einsum("fk,fk->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    triangles[is_inward] = triangles[is_inward][:, ::-1]
    return corners, triangles


def describe(kind: str) -> str:
    """Return the definition of a message's type with all types that it holds, as bags keep it."""
    text: str = load_types().generate_msgdef(kind, ros_version=2)[0]
    return text


def encode(stamped: StampedMessage) -> bytes:
    """Return a message in CDR, little endian."""
    return bytes(load_types().serialize_cdr(stamped.message, stamped.kind))


def list_topics(messages: list[StampedMessage]) -> Mapping[str, str]:
    """Return the type of each topic."""
    return {stamped.topic: stamped.kind for stamped in messages}
