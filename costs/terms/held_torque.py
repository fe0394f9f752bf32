"""Joint torques of an arm that exerts a given force, without the forces at the feet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.contact import Contact
from costs.contact_points import ContactPoints, measure_weight
from costs.kinematics import Topology, locate_frame
from costs.robot.model import RobotModel
from costs.state import LoadedState, MotionState
from costs.terms.joint_torque import StaticTorque, find_limited_joints
from costs.terms.pose import make_waypoint_rows
from scopt import AffineRows, Residual

_UP = np.array([[0.0, 0.0, 1.0]])


class HeldTorque(Residual[MotionState]):
    """Torque at rest beyond a share of its limit, of the joints between base and hand [share of limit].

    Rows per waypoint: ``tau / limit - share``, then ``-tau / limit - share``, of each joint that moves the frame on
    which the force acts.  No contact but this one may be on the far side of these joints; then their torque follows
    from the configuration and the force alone (``StaticTorque``).
    """

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        forces: Float[np.ndarray, "S 3"],
        share: float = 1.0,
    ) -> None:
        """
        Args:
            frame: frame of the robot at whose origin the force acts.
            waypoints: (S,) where the rows are measured.
            forces: (S, 3) of the surroundings on the robot, in world axes [N].
            share: of the limits that may be used.
        """
        touch = Contact(frame, np.zeros((1, 3)), _UP, 1.0, 1.0)  # only its place counts
        self._torque = StaticTorque(robot, ContactPoints.of(robot, (touch,)))
        self._waypoints = np.asarray(waypoints)
        joint, _ = locate_frame(robot, frame)
        moved = np.flatnonzero(Topology.of(robot.model).supports[joint])
        self.limited = np.intersect1d(find_limited_joints(robot), moved)
        weight = measure_weight(robot)
        self._forces = np.asarray(forces, dtype=float) / weight
        self._gain = weight / robot.effort[self.limited]
        self._share = float(share)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        used = self._torque.measure(self._load(state), self._waypoints)[:, self.limited] * self._gain
        return np.concatenate([used - self._share, -used - self._share], axis=1).ravel()

    def linearize(self, state: MotionState) -> AffineRows:
        by_q, _ = self._torque.differentiate(self._load(state), self._waypoints)
        rows = by_q[:, self.limited] * self._gain[:, None]
        both = np.concatenate([rows, -rows], axis=1)
        return make_waypoint_rows(self.value(state), both, self._waypoints, state.kinematics)

    def _load(self, state: MotionState) -> LoadedState:
        """Return the state with the force at its waypoints."""
        forces = np.zeros((state.kinematics.jacobian.shape[0], 1, 3))
        forces[self._waypoints, 0] = self._forces
        return LoadedState(state, forces)
