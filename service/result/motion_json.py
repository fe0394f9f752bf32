"""Writer and reader of the motion in ``result.json``: samples, curve, phases, and movables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from costs.primitive import Primitive
from costs.robot import (
    BASE_NAMES,
    LinkInertia,
    MechanismJoint,
    Release,
    RobotModel,
    read_joint_axis,
    with_mechanism,
)
from costs.robot.carried import MovableObject
from costs.rotation import make_quaternions
from costs.scene import ConvexPiece, Scene
from costs.work_space import borrow_data
from service.result.phase_json import phase_from_json, phase_json, read_rotation, sample_index, write_rotation
from service.result.zmp_json import zmp_json
from service.verify import Approach, Motion, Sway, find_mechanism_joints, find_times, split_motion

BASE_COLUMNS = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")


def motion_json(motion: Motion, robot: RobotModel) -> dict[str, Any]:
    """Return the motion's keys of ``result.json``; ``robot`` is the motion's without the joints that the task moves."""
    s = samples_of(motion)
    q = motion.curve(s)
    phases = [phase_json(phase, s) for phase in motion.phases]
    zmp, zmp_of_phases = zmp_json(motion, s)
    standing = [phase for phase in phases if phase["support"]]
    return {
        "trajectory": {
            "joint_names": list(file_columns(robot)),
            "positions": file_positions(robot, q[:, : robot.n]).tolist(),
            "times": sample_times(motion).tolist(),
        },
        "curve": _write_curve(motion, s),
        "waypoints": [sample_index(s, knot) for knot in motion.curve.knots],
        "phases": phases,
        "waived": sorted(motion.waived or ()),
        "clearance_m": motion.clearance_m,
        "sway_m": motion.sway.distance_m,
        "sway_deg": motion.sway.angle_deg,
        "padding": dict(motion.padding),
        "jerk_scale": motion.jerk_scale,
        "tool_speed_m_s": motion.tool_speed_m_s,
        "pace": motion.pace,
        "approach": asdict(motion.approach),
        "start_rates": dict(motion.start_rates),
        "end_rates": dict(motion.end_rates),
        "movables": [_write_movable(motion, robot, column, q) for column in range(robot.n, motion.robot.n)],
        "releases": [asdict(release) for release in motion.releases],
        "continues": motion.continues,
        "objects": [_write_object(item) for item in motion.objects],
        "support_polygons": [
            {"first": phase["first"], "last": phase["last"], **phase["support"], "zmp": zmp_of_phase}
            for phase, zmp_of_phase in zip(standing, zmp_of_phases, strict=True)
        ],
        "com": _compute_com(motion, s, q),
        "zmp": zmp,
    }


def motion_from_json(data: Mapping[str, Any], robot: RobotModel) -> Motion:
    """Return the motion of a parsed ``result.json``, for the robot read from the files beside it.

    Raises:
        KeyError, TypeError, ValueError: the data do not follow docs/result-format.md.
    """
    robot = with_mechanism(robot, [_read_movable(movable) for movable in data["movables"]])
    curve, law = data["curve"], data["curve"]["law"]
    if tuple(curve["joint_names"]) != robot.joint_names:
        raise ValueError("curve.joint_names are not the joints of the robot and the movables")
    s = np.array(curve["samples"], dtype=float)
    return Motion(
        robot=robot,
        scene=Scene(tuple(ConvexPiece(p["name"], np.array(p["vertices"]), p["kind"]) for p in data["pieces"])),
        curve=Curve(*(np.array(curve[key], dtype=float) for key in ("knots", "positions", "tangents"))),
        law=None if law is None else TimeLaw(*(np.array(law[key], float) for key in ("times", "path", "speed"))),
        phases=tuple(phase_from_json(phase, s) for phase in data["phases"]),
        samples=s,
        mechanism_links=robot.mechanism_links,
        waived=frozenset(str(name) for name in data.get("waived", ())),
        releases=tuple(_read_release(release) for release in data.get("releases", ())),
        continues=data.get("continues"),
        clearance_m=float(data.get("clearance_m", 0.0)),
        sway=Sway(float(data.get("sway_m", 0.0)), float(data.get("sway_deg", 0.0))),
        padding={str(name): float(value) for name, value in data.get("padding", {}).items()},
        jerk_scale=None if data.get("jerk_scale") is None else float(data["jerk_scale"]),
        tool_speed_m_s=None if data.get("tool_speed_m_s") is None else float(data["tool_speed_m_s"]),
        pace=None if data.get("pace") is None else str(data["pace"]),
        approach=_read_approach(data.get("approach")),
        start_rates=_read_rates(data.get("start_rates")),
        end_rates=_read_rates(data.get("end_rates")),
        objects=tuple(_read_object(item) for item in data.get("objects", ())),
    )


def _read_approach(data: Mapping[str, Any] | None) -> Approach:
    """Return what is said of hands that meet a surface."""
    return Approach(**{str(name): float(value) for name, value in (data or {}).items()})


def _read_rates(data: Mapping[str, Any] | None) -> dict[str, float]:
    """Return the rates of joints by name [rad/s, m/s]."""
    return {str(name): float(rate) for name, rate in (data or {}).items()}


def samples_of(motion: Motion) -> Float[np.ndarray, "S"]:
    """Return the path parameters of the exported samples: the motion's own, or its knots."""
    return motion.curve.knots if motion.samples is None else motion.samples


def sample_times(motion: Motion) -> Float[np.ndarray, "S"]:
    """Return the times of the samples [s]; the path parameters if the motion is untimed."""
    s = samples_of(motion)
    return s if motion.law is None else find_times(motion.law, s)


def sample_rates(motion: Motion) -> tuple[Float[np.ndarray, "S n"], Float[np.ndarray, "S n"]] | None:
    """Return velocities and accelerations (after each sample) of all coordinates; None if the motion is untimed."""
    return None if motion.law is None else rates_at(motion, sample_times(motion))


def rates_at(
    motion: Motion, times: Float[np.ndarray, "S"]
) -> tuple[Float[np.ndarray, "S n"], Float[np.ndarray, "S n"]]:
    """Return velocities and accelerations of all coordinates at times of a timed motion [rad/s, rad/s^2].

    Raises:
        ValueError: the motion is untimed.
    """
    if motion.law is None:
        raise ValueError("an untimed motion has no velocities")
    s, speed, gain = (part[:, None] for part in motion.law.at(times))
    slope, bend = motion.curve(s[:, 0], 1), motion.curve(s[:, 0], 2)
    return slope * speed, slope * gain + bend * speed**2


def file_columns(robot: RobotModel) -> tuple[str, ...]:
    """Return a trajectory's columns in files: a floating base as position and quaternion, then the joints."""
    return BASE_COLUMNS + robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names


def file_positions(robot: RobotModel, q: Float[np.ndarray, "S n"]) -> Float[np.ndarray, "S k"]:
    """Convert configurations to the columns of ``file_columns``."""
    if not robot.is_floating or not len(q):
        return q if len(q) else np.zeros((0, len(file_columns(robot))))
    return np.hstack([q[:, :3], make_quaternions(q[:, 3:6]), q[:, 6:]])


def _write_curve(motion: Motion, s: Float[np.ndarray, "S"]) -> dict[str, Any]:
    law = motion.law
    return {
        "joint_names": list(motion.robot.joint_names),
        "knots": motion.curve.knots.tolist(),
        "positions": motion.curve.positions.tolist(),
        "tangents": motion.curve.tangents.tolist(),
        "samples": s.tolist(),
        "law": None
        if law is None
        else {"times": law.times.tolist(), "path": law.path.tolist(), "speed": law.speed.tolist()},
    }


def _read_release(data: Mapping[str, Any]) -> Release:
    return Release(data["joint"], data["latch"], float(data["latch_at"]), float(data["free_beyond"]))


def _read_movable(movable: Mapping[str, Any]) -> MechanismJoint:
    return MechanismJoint(
        name=movable["joint"],
        link=movable["name"],
        origin=np.array(movable["origin"], dtype=float),
        axis=np.array(movable["axis"], dtype=float),
        bodies={body["name"]: np.array(body["vertices"]) for body in movable["bodies"]},
        kind=movable["type"],
        parent=movable["parent"],
        lower=float(movable["lower"]),
        upper=float(movable["upper"]),
        start=float(movable["start"]),
        velocity=float(movable["velocity"]),
        acceleration=float(movable["acceleration"]),
    )


def _write_object(item: MovableObject) -> dict[str, Any]:
    """Write a movable object: its hull in its own frame, its mass, and its pose at the start."""
    exact, own = item.exact, item.inertia
    shape = None
    if exact is not None:
        shape = {"kind": exact.kind, "radius": exact.radius, "length": exact.length, **_write_pose(exact.pose)}
    return {
        "name": item.name,
        "vertices": item.vertices.tolist(),
        "exact": shape,
        "mass_kg": own.mass,
        "centre": own.centre.tolist(),
        "moments": own.moments.tolist(),
        "start": _write_pose(item.start),
    }


def _read_object(data: Mapping[str, Any]) -> MovableObject:
    exact = data["exact"]
    shape = None
    if exact is not None:
        shape = Primitive(exact["kind"], float(exact["radius"]), float(exact["length"]), _read_pose(exact))
    own = LinkInertia(
        float(data["mass_kg"]), np.array(data["centre"], dtype=float), np.array(data["moments"], dtype=float)
    )
    return MovableObject(
        str(data["name"]), np.array(data["vertices"], dtype=float), own, _read_pose(data["start"]), shape
    )


def _write_pose(pose: Float[np.ndarray, "4 4"]) -> dict[str, list[float]]:
    return {"position": pose[:3, 3].tolist(), "quaternion_wxyz": write_rotation(pose[:3, :3])}


def _read_pose(data: Mapping[str, Any]) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = read_rotation(data["quaternion_wxyz"]), data["position"]
    return pose


def _write_movable(motion: Motion, robot: RobotModel, column: int, q: Float[np.ndarray, "S n"]) -> dict[str, Any]:
    """Return a mechanism's joint with its link: described in the world with all joints at 0, and its values."""
    augmented, model = motion.robot, motion.robot.model
    joint = model.getJointId(augmented.joint_names[column])
    above = int(model.parents[joint])
    origin = np.zeros(3)
    upwards = joint
    while upwards > 0:  # all frames have the world's axes at 0
        origin = origin + np.array(model.jointPlacements[upwards].translation)
        upwards = int(model.parents[upwards])
    bodies = [body for body in augmented.bodies if body.joint == joint]
    axis = read_joint_axis(augmented, joint)
    return {
        "name": bodies[0].link,
        "joint": augmented.joint_names[column],
        "parent": next((body.link for body in augmented.bodies if body.joint == above > 0), None),
        "type": "revolute" if np.any(axis[3:]) else "prismatic",
        "origin": origin.tolist(),
        "axis": (axis[3:] if np.any(axis[3:]) else axis[:3]).tolist(),
        "lower": float(augmented.lower[column]),
        "upper": float(augmented.upper[column]),
        "start": float(q[0, column]),
        "velocity": float(augmented.velocity[column]),
        "acceleration": float(augmented.acceleration[column]),
        "bodies": [
            {"name": body.name, "kind": "movable", "vertices": (body.vertices + origin).tolist()} for body in bodies
        ],
        "angles": q[:, column].tolist(),
    }


def _compute_com(motion: Motion, s: Float[np.ndarray, "S"], q: Float[np.ndarray, "S n"]) -> list[list[float] | None]:
    """Return the centre of mass in the world at every sample, with what hands carry; None if the robot has no masses.

    A mechanism does not count.
    """
    apart, parts = find_mechanism_joints(motion), split_motion(motion)
    lasts = np.array([phase.last for phase in motion.phases[:-1]])
    rows: list[list[float] | None] = []
    for at, row in zip(np.searchsorted(lasts, s), q, strict=True):
        model = parts[int(at)].robot.model
        data = borrow_data(model)
        pin.forwardKinematics(model, data, row)
        own = [joint for joint in range(1, model.njoints) if joint not in apart]
        masses = np.array([float(model.inertias[joint].mass) for joint in own])
        centres = np.array([data.oMi[joint].act(model.inertias[joint].lever) for joint in own])
        rows.append((masses @ centres / masses.sum()).tolist() if masses.sum() > 0.0 else None)
    return rows
