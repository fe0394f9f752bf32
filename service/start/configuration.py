"""Start configuration of a request, and checks of joint names and limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES, PLANAR_NAMES, WHOLE_TURN, RobotModel, list_circular, read_joint_axis
from service.errors import RequestError, would_do
from service.request.schema import StartRequest
from service.request.tasks.contacts import PostureRequest
from service.start.followers import leave_out_followers
from service.start.standing import sole_corners

SNAP_TOLERANCE = 1e-3  # rounding of joint positions reported by a robot [rad, m]
STANDING_POSTURE = "stand"
LARGEST_PITCH_DEG = 85.0
LEAST_DEGREES = 5.0  # a smaller position beyond the limits is hardly in degrees
MOST_TURNS = 8.0 * math.pi  # position of a joint without limits from which a note says how it is read [rad]


def make_start_configuration(
    robot: RobotModel, start: StartRequest, feet: Sequence[str] = ()
) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    """Return the start configuration, and notes about an assumed base, assumed and snapped joints.

    Args:
        robot: the robot.
        start: the request's start.
        feet: planted links; where neither the start nor its posture places a floating base, the lowest sole is at 0.

    Raises:
        RequestError: an unknown posture or joint, or a joint beyond its limits by more than 1e-3.
    """
    q, notes = _posture(robot, start)
    positions = leave_out_followers(robot, start.positions_by_joint, q, "start.joints")
    problems = find_unknown_joints(robot, positions, "start.joints")
    if problems:
        raise RequestError(problems)
    for name, position in positions.items():
        q[robot.joint_names.index(name)] = position
    if start.base is not None:
        _place_base(robot, q, start)
    q, notes = _snap_to_limits(robot, q, (*notes, *note_turns(robot, positions, "start.joints")))
    if start.base is None and robot.is_floating and not q[: len(BASE_NAMES)].any():
        notes += _stand_on_floor(robot, q, feet)
    return q, notes


def _stand_on_floor(robot: RobotModel, q: Float[np.ndarray, "n"], feet: Sequence[str]) -> tuple[str, ...]:
    """Write the height of the base into a configuration at which the lowest sole is at 0; return a note about it."""
    with_shape = {body.link for body in robot.bodies}
    heights = [float(sole_corners(robot, q, foot)[:, 2].min()) for foot in feet if foot in with_shape]
    if not heights:
        return ()
    q[2] = -min(heights)
    return (f"start: neither base nor posture says where the base is; it is {q[2]:.4f} m high, the lowest sole at 0",)


def _place_base(robot: RobotModel, q: Float[np.ndarray, "n"], start: StartRequest) -> None:
    """Write ``start.base`` into a configuration (RequestError: the base is fixed, or cannot be there)."""
    if start.base is None:
        return
    if not (robot.is_floating or robot.is_planar):
        raise RequestError(
            "start.base: this robot's base is fixed; leave it out, or give robot.root: floating, or planar for a URDF"
        )
    yaw, pitch, roll = _yaw_pitch_roll(start.base.quaternion_wxyz)
    x, y, z = start.base.position
    if robot.is_floating:
        q[:6] = (x, y, z, yaw, pitch, roll)
        return
    given = [name for name in PLANAR_NAMES if name in start.positions_by_joint]
    if given:
        raise RequestError(f"start.base: start.joints gives {given[0]} already; leave one of them out")
    if max(abs(pitch), abs(roll)) > SNAP_TOLERANCE:
        tilt = math.degrees(max(abs(pitch), abs(roll)))
        raise RequestError(f"start.base.quaternion_wxyz: {tilt:.1f} deg of tilt; a planar base turns about z only")
    if abs(z) > SNAP_TOLERANCE:
        raise RequestError(
            f"start.base.position: a height of {z:g} m; a planar base stays at 0; place the scene relative to it"
        )
    q[: len(PLANAR_NAMES)] = (x, y, yaw)


def make_posture(robot: RobotModel, posture: PostureRequest, path: str) -> Float[np.ndarray, "n"]:
    """Return the configuration of a posture with given base and joints; joints beyond their limits are at these.

    Raises:
        RequestError: an unknown posture or joint.
    """
    if posture.posture not in robot.postures:
        known = would_do(posture.posture, robot.postures)
        raise RequestError(f"{path}.posture: unknown posture '{posture.posture}'; {robot.name} has {known}")
    q = np.array(robot.postures[posture.posture])
    q[: len(BASE_NAMES)] = posture.base
    columns = {name: i for i, name in enumerate(robot.joint_names)}
    for name, value in posture.joints.items():
        if name not in columns or name in BASE_NAMES:
            raise RequestError(f"{path}.joints: unknown joint '{name}'; {robot.name} has {would_do(name, columns)}")
        q[columns[name]] = np.clip(value, robot.lower[columns[name]], robot.upper[columns[name]])
    return q


def find_unknown_joints(robot: RobotModel, names: Mapping[str, float] | Sequence[str], field: str) -> list[str]:
    """Return one line per name that is not a joint of the robot."""
    joints = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    return [
        f"unknown joint {name!r} in {field}; {robot.name} has {would_do(name, joints)}"
        for name in names
        if name not in joints
    ]


def find_unknown_links(robot: RobotModel, links: Sequence[str], field: str) -> list[str]:
    """Return one line per name that is neither a link nor a frame of the robot."""
    frames = [frame.name for frame in robot.model.frames if frame.name != "universe"]
    return [
        f"unknown link {link!r} in {field}; {robot.name} has {would_do(link, frames)}"
        for link in links
        if link not in frames
    ]


def find_limit_violations(
    robot: RobotModel, positions: Mapping[str, float], field: str, tolerance: float = 0.0
) -> list[str]:
    """Return one line per joint position beyond its limits by more than ``tolerance``."""
    problems = []
    for name, position in positions.items():
        index = robot.joint_names.index(name)
        lower, upper = float(robot.lower[index]), float(robot.upper[index])
        if not lower - tolerance <= position <= upper + tolerance:
            problems.append(
                f"{field}.{name}: {position:.6g} is outside the joint's limits; expected {lower:.6g} to {upper:.6g}"
                f"{_suggest_radians(robot, name, position)}"
            )
    return problems


def note_turns(robot: RobotModel, positions: Mapping[str, float], field: str) -> tuple[str, ...]:
    """Return one note per joint without limits that is given many turns off, whose turns do not count."""
    circular = {robot.joint_names[k] for k in list_circular(robot)}
    return tuple(
        f"{field}.{name}: {position:.6g} rad are {abs(position) / WHOLE_TURN:.0f} turns, which do not count: "
        f"the joint is at {math.remainder(position, WHOLE_TURN):.6g}{_suggest_radians(robot, name, position)}"
        for name, position in positions.items()
        if name in circular and abs(position) > MOST_TURNS
    )


def note_snapped(robot: RobotModel, positions: Mapping[str, float], where: str) -> tuple[str, ...]:
    """Return one note per position that rounding put beyond a limit, which is read as the limit."""
    limits = {name: (low, high) for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True)}
    known = {name: value for name, value in positions.items() if name in limits}
    inside = {name: float(np.clip(value, *limits[name])) for name, value in known.items()}
    return tuple(
        f"{where}: {name} snapped from {value:.9g} to its limit {inside[name]:.9g}"
        for name, value in known.items()
        if value != inside[name]
    )


def _suggest_radians(robot: RobotModel, name: str, position: float) -> str:
    """Return a question where a position beyond the limits would fit as degrees; empty for a sliding joint."""
    index = robot.joint_names.index(name)
    in_radians = math.radians(position)
    fits = float(robot.lower[index]) <= in_radians <= float(robot.upper[index])
    if not fits or abs(position) < LEAST_DEGREES or is_sliding(robot, name):
        return ""
    return f"; joints are in radians, are these degrees? Use {in_radians:.6g}."


def is_sliding(robot: RobotModel, name: str) -> bool:
    """Return whether a joint slides."""
    if name in BASE_NAMES[:3]:
        return True
    joint = robot.model.getJointId(name)
    return joint < robot.model.njoints and not np.any(read_joint_axis(robot, joint)[3:])


def _posture(robot: RobotModel, start: StartRequest) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    if start.posture is not None:
        if start.posture not in robot.postures:
            known = would_do(start.posture, robot.postures) or "no postures; give start.joints"
            raise RequestError(f"unknown posture {start.posture!r} in start.posture; {robot.name} has {known}")
        return robot.postures[start.posture].copy(), ()
    if STANDING_POSTURE in robot.postures:
        return robot.postures[STANDING_POSTURE].copy(), ()
    q = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    joints = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    n_assumed = len(set(joints).difference(start.positions_by_joint))
    if not n_assumed:
        return q, ()
    return q, (f"{n_assumed} joints without a start position start at 0 or at the nearest limit",)


def _yaw_pitch_roll(quaternion_wxyz: tuple[float, float, float, float]) -> Float[np.ndarray, "3"]:
    """Return the base's intrinsic z-y-x angles, which are not unique at a pitch of 90 degrees."""
    from scipy.spatial.transform import Rotation  # slow to import

    rotation = Rotation.from_quat(quaternion_wxyz, scalar_first=True)
    pitch_deg = math.degrees(math.asin(np.clip(-rotation.as_matrix()[2, 0], -1.0, 1.0)))
    if abs(pitch_deg) > LARGEST_PITCH_DEG:
        raise RequestError(
            f"start.base.quaternion_wxyz: a pitch of {pitch_deg:.0f} deg is too near to 90; "
            f"expected at most {LARGEST_PITCH_DEG:.0f}"
        )
    return np.asarray(rotation.as_euler("ZYX"))


def _snap_to_limits(
    robot: RobotModel, q: Float[np.ndarray, "n"], notes: tuple[str, ...]
) -> tuple[Float[np.ndarray, "n"], tuple[str, ...]]:
    problems = find_limit_violations(
        robot, dict(zip(robot.joint_names, q, strict=True)), "start.joints", SNAP_TOLERANCE
    )
    if problems:
        raise RequestError(problems)
    snapped = note_snapped(robot, dict(zip(robot.joint_names, q.tolist(), strict=True)), "start")
    return np.clip(q, robot.lower, robot.upper), (*notes, *snapped)
