"""A result as the plain data of ``result.json`` (docs/result-format.md), and robot coordinates as its columns."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES, RobotModel
from costs.scene import ConvexPiece
from service.request_file import request_hash, to_json
from service.result import Movable, PlanResult

FORMAT = "scopt-result/1"
BASE_COLUMNS = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
MAX_CLOUD_POINTS = 60_000


def to_result_json(result: PlanResult) -> dict[str, Any]:
    """Everything ``result.json`` holds, as JSON-ready data."""
    return {
        "format": FORMAT,
        "request": to_json(result.request),
        "request_hash": request_hash(result.request),
        **_summary(result),
        "robot": _robot(result.robot),
        "bodies": [_body(result.robot, index) for index in range(len(result.robot.bodies))],
        "ignored_pairs": sorted(result.robot.ignored_pairs),
        "pieces": [_piece(piece) for piece in result.scene.pieces],
        "movables": [_movable(movable) for movable in result.movables],
        "trajectory": _trajectory(result),
        "curve": _curve(result),
        **{
            name: plain(getattr(result, name))
            for name in ("waypoints", "phases", "support_polygons", "com", "zmp", "checks", "certificate")
        },
        "figures": plain(result.figures),
        "detections": plain(result.detections),
        "cloud": _thinned(result.cloud).tolist(),
    }


def summary_json(result: PlanResult) -> dict[str, Any]:
    """What ``--json`` prints: the verdict and its figures, without the motion and its proof."""
    return {
        "format": FORMAT,
        "request_hash": request_hash(result.request),
        **_summary(result),
        "phases": [{"name": p.name, "first": p.first, "last": p.last} for p in result.phases],
        "duration_s": float(result.times[-1]) if len(result.times) else None,
        "checks": plain(result.checks),
        "figures": plain(result.figures),
        "detections": plain(result.detections),
    }


def file_columns(robot: RobotModel) -> tuple[str, ...]:
    """Column names of a trajectory in files: a floating base as position and quaternion, then the joints."""
    return BASE_COLUMNS + robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names


def file_positions(robot: RobotModel, q: Float[np.ndarray, "S n"]) -> Float[np.ndarray, "S k"]:
    """Configurations in the columns of ``file_columns``; the quaternion's sign does not flip between samples."""
    if not robot.is_floating:
        return q
    quaternions = Rotation.from_euler("ZYX", q[:, 3:6]).as_quat(scalar_first=True) if len(q) else np.zeros((0, 4))
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    quaternions[1:] *= np.cumprod(np.where(flips, -1.0, 1.0))[:, None]
    return np.hstack([q[:, :3], quaternions, q[:, 6:]])


def base_coordinates(
    position: tuple[float, float, float], quaternion_wxyz: tuple[float, float, float, float]
) -> Float[np.ndarray, "6"]:
    """A base pose in the robot's coordinates: x y z, then intrinsic yaw, pitch, roll."""
    w, x, y, z = quaternion_wxyz
    return np.concatenate([position, Rotation.from_quat([x, y, z, w]).as_euler("ZYX")])


def plain(value: Any) -> Any:
    """``value`` as JSON data: dataclasses as objects, arrays as lists, numbers that JSON lacks as null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist() if value.dtype.kind in "biuSU" or np.isfinite(value).all() else plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, set | frozenset):
        return sorted(plain(entry) for entry in value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    raise TypeError(f"{type(value).__name__} has no place in a result")


def _summary(result: PlanResult) -> dict[str, Any]:
    names = (
        "verdict",
        "explanation",
        "notes",
        "planning_time_s",
        "timings",
        "min_clearance_m",
        "min_clearance_pair",
        "min_balance_margin_m",
    )
    return {name: plain(getattr(result, name)) for name in names}


def _robot(robot: RobotModel) -> dict[str, Any]:
    """Paths are relative to the result's folder, where ``service.output`` writes the files."""
    digest = hashlib.sha256(robot.source.urdf.encode() + b"\0" + robot.source.srdf.encode())
    return {
        "name": robot.name,
        "urdf": "robot/robot.urdf",
        "srdf": "robot/robot.srdf" if robot.source.srdf else None,
        "package_dirs": ["robot"],
        "root": "floating" if robot.is_floating else "fixed",
        "sha256": digest.hexdigest(),
    }


def _body(robot: RobotModel, index: int) -> dict[str, Any]:
    """The body's vertices in the frame of its link, where a reader of the URDF expects them."""
    body = robot.bodies[index]
    placement = robot.model.frames[robot.model.getFrameId(body.link)].placement.inverse()
    return {
        "name": body.name,
        "link": body.link,
        "vertices": (body.vertices @ placement.rotation.T + placement.translation).tolist(),
    }


def _piece(piece: ConvexPiece) -> dict[str, Any]:
    return {"name": piece.name, "kind": piece.kind, "vertices": piece.vertices.tolist()}


def _movable(movable: Movable) -> dict[str, Any]:
    return {
        "name": movable.name,
        "joint": movable.joint,
        "type": "revolute",
        "origin": movable.origin.tolist(),
        "axis": movable.axis.tolist(),
        "bodies": [_piece(body) for body in movable.bodies],
        "angles": movable.angles.tolist(),
    }


def _trajectory(result: PlanResult) -> dict[str, Any]:
    return {
        "joint_names": list(file_columns(result.robot)),
        "positions": file_positions(result.robot, result.q).tolist(),
        "times": result.times.tolist(),
    }


def _curve(result: PlanResult) -> dict[str, Any] | None:
    curve, law = result.curve, result.law
    if curve is None:
        return None
    return {
        "joint_names": list(result.curve_joint_names or result.robot.joint_names),
        "knots": curve.knots.tolist(),
        "positions": curve.positions.tolist(),
        "tangents": curve.tangents.tolist(),
        "law": plain(law),
    }


def _thinned(cloud: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "K 3"]:
    step = -(-len(cloud) // MAX_CLOUD_POINTS) if len(cloud) else 1
    return np.round(cloud[::step], 4)
