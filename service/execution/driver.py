"""What a plan's executor and a robot say to each other, the same for a simulation and for a real robot's driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class JointCommand:
    """What the joint servos follow until the next command, in the order of `RobotDriver.joint_names`.

    Attributes:
        q: desired positions (n,), radians or metres.
        qd: desired speeds (n,), per second.
        tau: torques or forces fed forward (n,), N m or N.
    """

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class RobotReading:
    """What the robot's sensors say at one instant.

    Attributes:
        time_s: seconds since the driver started.
        q, qd: measured joint positions and speeds (n,).
        imu_rotation: rotation (3, 3) that takes axes of the IMU's link to world axes.
        imu_angular_velocity, imu_acceleration: (3,) in the IMU link's axes, rad/s and m/s^2 (gravity included).
        foot_wrenches: per foot link, the ground's force and moment (6,) at the link's origin, world axes, N and N m.
        torque: measured joint torques (n,).
        base_offset: (4, 4) pose of the base of a robot that something else balances, against the place that plans have
            it in, as that controller measures it; None where nothing does.
    """

    time_s: float
    q: np.ndarray
    qd: np.ndarray
    imu_rotation: np.ndarray
    imu_angular_velocity: np.ndarray
    imu_acceleration: np.ndarray
    foot_wrenches: Mapping[str, np.ndarray]
    torque: np.ndarray
    base_offset: np.ndarray | None = None


class RobotDriver(Protocol):
    """A robot, real or simulated, that follows joint commands at a fixed period."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Actuated joints, in the order of every array."""

    @property
    def period_s(self) -> float:
        """Seconds between two commands."""

    def read(self) -> RobotReading:
        """Return what the sensors say now."""

    def command(self, command: JointCommand) -> None:
        """Hand a command to the servos; returns when the next one is due."""
