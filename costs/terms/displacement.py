"""Displacement of a frame from waypoint to waypoint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.kinematics import Kinematics, locate_frame
from costs.robot.model import RobotModel
from costs.state import MotionState
from scopt import AffineRows, Residual


class FrameDisplacement(Residual[MotionState]):
    """Translation of a frame's origin over an interval, in the world, three rows (x, y, z) per interval [m]."""

    def __init__(self, robot: RobotModel, frame: str, intervals: Int[np.ndarray, "I"] | Sequence[int]) -> None:
        """
        Args:
            frame: link or frame name.
            intervals: (I,) first waypoints of the intervals that count; each ends at the next waypoint.
        """
        self._joint, pose_joint_frame = locate_frame(robot, frame)
        self._local = pose_joint_frame[:3, 3]
        self._intervals = np.asarray(intervals)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        kinematics, first = state.kinematics, self._intervals
        return np.asarray((self._locate_origin(kinematics, first + 1) - self._locate_origin(kinematics, first)).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics, first = state.kinematics, self._intervals
        joint = np.full(len(first), self._joint)
        before = kinematics.point_jacobian(first, joint, self._locate_origin(kinematics, first))
        after = kinematics.point_jacobian(first + 1, joint, self._locate_origin(kinematics, first + 1))
        blocks = np.stack([-before, after], axis=2)  # (I, 3, 2, n)
        return AffineRows.from_blocks(
            self.value(state), np.repeat(first, 3), blocks.reshape(-1, 2, blocks.shape[3]), kinematics.n_waypoints
        )

    def _locate_origin(self, kinematics: Kinematics, waypoints: Int[np.ndarray, "I"]) -> Float[np.ndarray, "I 3"]:
        rotation = kinematics.rotation[waypoints, self._joint]
        return np.asarray(rotation @ self._local + kinematics.position[waypoints, self._joint])
