"""Points of a trajectory in the robot's coordinates: names, the base, joints that are left out, derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES, PLANAR_NAMES, RobotModel, turn_near
from service.errors import RequestError, shown, would_do
from service.replay.exchange.base_motion import compute_angles
from service.replay.exchange.followers import take_followers
from service.replay.exchange.interpolation import NEEDS
from service.replay.exchange.joint_trajectory import KINDS, JointTrajectory
from service.result.motion_json import BASE_COLUMNS

LARGEST_TURN_RAD = 0.5  # of a base between two points, whose quaternions are read as angles
PLANE_TOLERANCE = 1e-3  # of a planar base from its plane [m, rad]
STILL = 1e-3  # of a base that a robot without one stays on [m, and in quaternions]


@dataclass(frozen=True)
class Points:
    """A trajectory in the robot's coordinates, (K, n) each; times are None for a path."""

    times: Float[np.ndarray, "K"] | None
    positions: Float[np.ndarray, "K n"]
    velocities: Float[np.ndarray, "K n"] | None
    accelerations: Float[np.ndarray, "K n"] | None


def place_points(
    trajectory: JointTrajectory, robot: RobotModel, start: Float[np.ndarray, "n"], kind: str
) -> tuple[Points, tuple[str, ...]]:
    """Return the points in the robot's order of coordinates, and notes about joints that the trajectory leaves out.

    Args:
        trajectory: of another planner.
        robot: the request's robot.
        start: the request's start.
        kind: interpolation, which decides whether derivatives are used.

    Raises:
        RequestError: unknown joints, followers that do not follow, an incomplete base, a base that the robot does not
            have, or derivatives of some joints only.
    """
    trajectory = take_followers(trajectory, robot, start)
    source, names, values = trajectory.source, trajectory.joint_names, trajectory.positions
    notes = list(trajectory.notes)
    if set(names) & set(BASE_COLUMNS[3:]):
        names, values, more = _read_base(trajectory, robot, start)
        notes = [*more, *notes]
    unknown = [name for name in names if name not in robot.joint_names]
    if unknown:
        own = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
        listed = would_do(unknown[0], own)
        raise RequestError(f"{source}: unknown joint {shown(unknown[0])}; {robot.name} has {listed}")
    columns = [robot.joint_names.index(name) for name in names]
    positions = np.tile(start, (len(values), 1))
    positions[:, columns] = values
    positions = _take_turns(positions, robot, start)
    used = NEEDS.get(kind, ())
    rates = [_place_rates(trajectory, rate, robot, names) if rate in used else None for rate in KINDS]
    return Points(trajectory.times, positions, rates[0], rates[1]), (*_note_left_out(names, robot), *notes)


def _take_turns(
    positions: Float[np.ndarray, "K n"], robot: RobotModel, start: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "K n"]:
    """Return the points with joints without limits moved by whole turns, so that the first is near the start."""
    shift = turn_near(robot, positions[0], start) - positions[0]
    return np.asarray(positions + shift)


def _note_left_out(names: tuple[str, ...], robot: RobotModel) -> list[str]:
    still = [name for name in robot.joint_names if name not in names and name not in BASE_NAMES]
    notes = []
    if still:
        listed = ", ".join(still[:5]) + (f" and {len(still) - 5} more" if len(still) > 5 else "")
        notes.append(f"the trajectory leaves out {listed}: taken to stay at the request's start")
    if robot.is_floating and not set(names) & set(BASE_NAMES):
        notes.append("the trajectory leaves out the base: taken to stay at the request's start")
    return notes


def _place_rates(
    trajectory: JointTrajectory, kind: str, robot: RobotModel, names: tuple[str, ...]
) -> Float[np.ndarray, "K n"] | None:
    values = getattr(trajectory, kind)
    if values is None:
        return None
    # A planar or fixed base has less rates than the pose that it came as.
    columns = [name for name in trajectory.columns_of_rates if name in names or name not in BASE_NAMES]
    unequal = sorted(set(columns) ^ set(names))
    if unequal:
        raise RequestError(
            f"{trajectory.source}: {kind} and positions are not of the same coordinates: {shown(unequal[0])} is in "
            "only one of them"
        )
    rates = np.zeros((len(values), robot.n))
    taken = [trajectory.columns_of_rates.index(name) for name in columns]
    rates[:, [robot.joint_names.index(name) for name in columns]] = values[:, taken]
    return rates


def _read_base(
    trajectory: JointTrajectory, robot: RobotModel, start: Float[np.ndarray, "n"]
) -> tuple[tuple[str, ...], Float[np.ndarray, "K j"], list[str]]:
    """Return names and positions with the base's quaternions replaced by the robot's coordinates, and notes."""
    source, names = trajectory.source, trajectory.joint_names
    missing = [name for name in BASE_COLUMNS if name not in names]
    if missing:
        raise RequestError(f"{source}: the base lacks {missing[0]}; expected {', '.join(BASE_COLUMNS)}")
    columns = [names.index(name) for name in BASE_COLUMNS]
    others = [k for k in range(len(names)) if k not in columns]
    poses, rest = trajectory.positions[:, columns], trajectory.positions[:, others]
    lengths = np.linalg.norm(poses[:, 3:], axis=1)
    if np.any(np.abs(lengths - 1.0) > 1e-3):
        row = int(np.argmax(np.abs(lengths - 1.0)))
        raise RequestError(f"{source}: the base's quaternion at point {row} has the length {lengths[row]:.4g}, not 1")
    other_names = tuple(names[k] for k in others)
    if not (robot.is_floating or robot.is_planar):
        return other_names, rest, _pass_over_base(poses, robot, source)
    own, first = (BASE_NAMES, start[3:6]) if robot.is_floating else (PLANAR_NAMES, np.array([start[2], 0.0, 0.0]))
    angles = np.unwrap(compute_angles(poses[:, 3:]), axis=0)
    angles += 2.0 * np.pi * np.round((first - angles[0]) / (2.0 * np.pi))  # the same turn as the start's
    turn = np.abs(np.diff(angles, axis=0)).max(initial=0.0)
    if turn > LARGEST_TURN_RAD:
        raise RequestError(
            f"{source}: the base turns by {np.rad2deg(turn):.0f} deg between two points; "
            f"expected at most {np.rad2deg(LARGEST_TURN_RAD):.0f}, or base_yaw, base_pitch and base_roll"
        )
    if robot.is_floating:
        return (*own, *other_names), np.hstack([poses[:, :3], angles, rest]), []
    off = np.abs(np.column_stack([poses[:, 2], angles[:, 1:]]))
    if np.any(off > PLANE_TOLERANCE):
        row, axis = divmod(int(off.argmax()), 3)
        what = ("base_z", "base_pitch", "base_roll")[axis]
        raise RequestError(
            f"{source}: the base leaves its plane at point {row}: {what} is {off[row, axis]:.4g}, expected 0"
        )
    return (*own, *other_names), np.hstack([poses[:, :2], angles[:, :1], rest]), []


def _pass_over_base(poses: Float[np.ndarray, "K 7"], robot: RobotModel, source: str) -> list[str]:
    """Return a note for a base that stays, of a robot without one.

    Raises:
        RequestError: it moves.
    """
    moved = np.linalg.norm(poses[:, :3] - poses[0, :3], axis=1)
    row = int(moved.argmax())
    if moved[row] > STILL or np.any(np.abs(poses[:, 3:] - poses[0, 3:]) > STILL):
        raise RequestError(
            f"{source}: moves the base (by {moved[row]:.4g} m at point {row}), and the base of {robot.name} is fixed; "
            "robot.root: floating or planar lets it move"
        )
    place = np.round(poses[0, :3], 4).tolist()
    return [f"the trajectory gives a base that stays at {place} m, and that of {robot.name} is fixed: not compared"]
