"""Joints that follow others (URDF's ``mimic``) in trajectories of other planners: consistent, or refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, read_followers
from service.errors import RequestError, shown
from service.replay.exchange.joint_trajectory import KINDS, JointTrajectory

TOLERANCE = 1e-3  # of a follower from what its leader says; other planners round to single precision [rad, m; per s]


def take_followers(trajectory: JointTrajectory, robot: RobotModel, start: Float[np.ndarray, "n"]) -> JointTrajectory:
    """Return a trajectory without the joints that follow others, after a comparison with their leaders.

    A leader that the trajectory leaves out stays at the request's start.

    Raises:
        RequestError: a follower is elsewhere than its leader says; the message says where, and by how much.
    """
    followers = {name: rule for name, rule in read_followers(robot).items() if name in trajectory.joint_names}
    followers = {name: rule for name, rule in followers.items() if name not in robot.joint_names}
    if not followers:
        return trajectory
    notes = [
        note
        for name, (leader, multiplier, offset) in followers.items()
        for note in _compare(trajectory, name, leader, multiplier, offset, _start_of(leader, robot, start))
    ]
    names = trajectory.joint_names
    rates = trajectory.columns_of_rates
    velocities, accelerations = trajectory.velocities, trajectory.accelerations
    kept = [k for k, name in enumerate(names) if name not in followers]
    kept_rates = [k for k, name in enumerate(rates) if name not in followers]
    return replace(
        trajectory,
        joint_names=tuple(names[k] for k in kept),
        positions=trajectory.positions[:, kept],
        rate_names=tuple(rates[k] for k in kept_rates) if trajectory.rate_names else (),
        notes=(*trajectory.notes, *notes),
        velocities=None if velocities is None else velocities[:, kept_rates],
        accelerations=None if accelerations is None else accelerations[:, kept_rates],
    )


def expect_follower(rule: tuple[str, float, float], values: Mapping[str, float]) -> float | None:
    """Return where a follower is by the values of other joints; None if its leader is not among them."""
    leader, multiplier, offset = rule
    return multiplier * values[leader] + offset if leader in values else None


def _start_of(leader: str, robot: RobotModel, start: Float[np.ndarray, "n"]) -> float:
    return float(start[robot.joint_names.index(leader)])


def _compare(
    trajectory: JointTrajectory, name: str, leader: str, multiplier: float, offset: float, at_start: float
) -> list[str]:
    """Return notes on a follower whose positions, and derivatives if there are any, are those of its leader."""
    names, notes = trajectory.joint_names, []
    led = (
        trajectory.positions[:, names.index(leader)]
        if leader in names
        else np.full(len(trajectory.positions), at_start)
    )
    own = trajectory.positions[:, names.index(name)]
    _require(own, multiplier * led + offset, "positions", name, leader, trajectory.source)
    rates = trajectory.columns_of_rates
    for kind in KINDS:
        values = getattr(trajectory, kind)
        if values is None or name not in rates:
            continue
        own = values[:, rates.index(name)]
        expected = multiplier * values[:, rates.index(leader)] if leader in rates else np.zeros(len(values))
        if not np.any(own) and np.any(expected):
            notes.append(f"{kind} of {shown(name)} are all 0: those of {shown(leader)}, which it follows, are used")
            continue
        _require(own, expected, kind, name, leader, trajectory.source)
    return notes


def _require(
    own: Float[np.ndarray, "K"], expected: Float[np.ndarray, "K"], kind: str, name: str, leader: str, source: str
) -> None:
    off = np.abs(own - expected) - TOLERANCE * (np.abs(expected) if kind != "positions" else 0.0)
    row = int(off.argmax())
    if off[row] > TOLERANCE:
        raise RequestError(
            f"{source}: {kind} of {shown(name)} differ from those of {shown(leader)}, which it follows: at point {row} "
            f"{own[row]:.6g}, expected {expected[row]:.6g}"
        )
