"""Joint-space terms: finite differences along the trajectory, and joint targets."""

from __future__ import annotations

from math import comb

import numpy as np
from jaxtyping import Float, Int

from costs.state import MotionState
from scopt import AffineRows, Residual


class JointDifference(Residual[MotionState]):
    """Joint displacement, one row per difference and joint [rad / dt^order].

    Row ``(t, i)`` is ``weight_i * sum_k (-1)^(order-k) C(order, k) q_{t+k,i} / dt^order``: order 1 is the displacement
    between waypoints (velocity), 2 the acceleration, 3 the jerk.
    """

    def __init__(
        self,
        n_waypoints: int,
        joint_weights: Float[np.ndarray, "n"],
        order: int = 1,
        dt: float = 1.0,
        waypoints: Int[np.ndarray, "S"] | None = None,
    ) -> None:
        """
        Args:
            joint_weights: (n,) factor of each joint's rows; rows of weight 0 are left out.
            dt: time between waypoints [s]; 1 measures per waypoint.
            waypoints: first waypoints of the differences that count; all if not given.
        """
        if order not in (1, 2, 3):
            raise ValueError(f"order must be 1 (velocity), 2 (acceleration) or 3 (jerk), got {order}")
        if not dt > 0.0:
            raise ValueError(f"dt must be positive, got {dt}")
        n = len(joint_weights)
        starts = np.arange(n_waypoints - order) if waypoints is None else np.asarray(waypoints)
        joints = np.flatnonzero(joint_weights)
        stencil = np.array([(-1) ** (order - k) * comb(order, k) for k in range(order + 1)]) / dt**order
        blocks = np.zeros((len(joints), order + 1, n))
        blocks[np.arange(len(joints)), :, joints] = stencil * joint_weights[joints][:, None]
        first, blocks = np.repeat(starts, len(joints)), np.tile(blocks, (len(starts), 1, 1))
        self._matrix = AffineRows.from_blocks(np.zeros(len(first)), first, blocks, n_waypoints).jacobian

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        return np.asarray(self._matrix @ state.kinematics.q.ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        return AffineRows(self.value(state), self._matrix)


class JointTarget(Residual[MotionState]):
    """``gain * (q - target)`` of chosen joints at chosen waypoints, one row each [rad, m].

    As a cost or an equality it draws the joints to the target; as an inequality with ``gain`` +1 or -1 it keeps them
    below or above it (pushing a wrist to its limit: Franklin, 2016, sec. 4.3).
    """

    def __init__(
        self,
        n_waypoints: int,
        n: int,
        waypoints: Int[np.ndarray, "S"],
        joints: Int[np.ndarray, "K"],
        target: Float[np.ndarray, "#S K"],
        gain: Float[np.ndarray, "K"] | float = 1.0,
    ) -> None:
        waypoints, joints = np.asarray(waypoints), np.asarray(joints)
        shape = (len(waypoints), len(joints))
        self._target = np.broadcast_to(target, shape).ravel()
        self._gain = np.broadcast_to(gain, shape).ravel()
        self._columns = (waypoints[:, None] * n + joints).ravel()
        m = len(self._columns)
        blocks = np.zeros((m, 1, n))
        blocks[np.arange(m), 0, np.tile(joints, len(waypoints))] = self._gain
        self._matrix = AffineRows.from_blocks(
            np.zeros(m), np.repeat(waypoints, len(joints)), blocks, n_waypoints
        ).jacobian

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        return np.asarray(self._gain * (state.kinematics.q.ravel()[self._columns] - self._target))

    def linearize(self, state: MotionState) -> AffineRows:
        return AffineRows(self.value(state), self._matrix)
