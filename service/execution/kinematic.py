"""A robot without dynamics that is where it is commanded to be: for plans that are only looked at, and for tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from service.execution.driver import JointCommand, RobotReading


class KinematicRobot:
    """Driver whose joints follow every command exactly; it has no force sensors unless ``foot_wrenches`` is set.

    Attributes:
        joint_names: actuated joints.
        period_s: between two commands [s].
        foot_wrenches: what the foot sensors say, by link.
        commands: number of commands so far.
    """

    def __init__(self, joint_names: Sequence[str], start: Float[np.ndarray, "k"], period_s: float = 1e-3) -> None:
        """Put the joints at a start, at rest."""
        self.joint_names = tuple(joint_names)
        self.period_s = period_s
        self.foot_wrenches: Mapping[str, np.ndarray] = {}
        self.commands = 0
        self._last = JointCommand(np.array(start, dtype=float), np.zeros(len(start)), np.zeros(len(start)))

    def read(self) -> RobotReading:
        """Return the last command as measured."""
        last = self._last
        return RobotReading(
            time_s=self.commands * self.period_s,
            q=last.q,
            qd=last.qd,
            imu_rotation=np.eye(3),
            imu_angular_velocity=np.zeros(3),
            imu_acceleration=np.array([0.0, 0.0, 9.81]),
            foot_wrenches=self.foot_wrenches,
            torque=last.tau,
        )

    def command(self, command: JointCommand) -> None:
        """Follow a command."""
        self._last = command
        self.commands += 1
