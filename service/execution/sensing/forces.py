"""Measured forces: those of contacts with a sensor, and forces of the hands estimated from the torques of the arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel
from costs.robot.poses import matrix_rpy
from service.errors import ExecutionError
from service.execution.driver import RobotReading
from service.execution.sensing.filters import find_share, low_pass

FOOT_CUTOFF_HZ = 30.0
HAND_CUTOFF_HZ = 5.0
LEAST_JOINTS = 3  # of an arm that shows a force


@dataclass(frozen=True)
class MeasuredForces:
    """Filtered forces of one instant.

    Attributes:
        contacts: force (3,) of the surroundings on each link with a sensor, world axes [N].
        hands: force (3,) of the surroundings on each tool, world axes [N].
    """

    contacts: Mapping[str, Float[np.ndarray, "3"]]
    hands: Mapping[str, Float[np.ndarray, "3"]]

    @property
    def upright(self) -> dict[str, float]:
        """Upright force per link with a sensor [N]."""
        return {link: float(force[2]) for link, force in self.contacts.items()}

    @property
    def sizes(self) -> dict[str, float]:
        """Size of the force per tool [N]."""
        return {tool: float(np.linalg.norm(force)) for tool, force in self.hands.items()}


class ForceMeter:
    """Filters of the forces of feet and hands."""

    def __init__(self, robot: RobotModel, joint_names: Sequence[str], tools: Sequence[str], period_s: float) -> None:
        """Prepare the arms' chains.

        Args:
            robot: the robot, without or with the joints of a task's mechanism.
            joint_names: order of the readings' joints.
            tools: frames whose force is estimated.
            period_s: between two readings [s].

        Raises:
            ExecutionError: fewer than three joints carry a tool alone.
        """
        self.robot = robot
        self._columns = np.array([robot.joint_names.index(name) for name in joint_names], dtype=int)
        self._data = robot.model.createData()
        self._shares = find_share(FOOT_CUTOFF_HZ, period_s), find_share(HAND_CUTOFF_HZ, period_s)
        self._period_s = period_s
        self._arms = {tool: _find_arm(robot, tool, self._columns) for tool in tools}

    def step(
        self, earlier: MeasuredForces | None, reading: RobotReading, accelerations: Float[np.ndarray, "k"]
    ) -> MeasuredForces:
        """Return the forces after one more reading.

        Args:
            earlier: forces of the reading before.
            reading: of the sensors.
            accelerations: commanded, in the order of the readings' joints, per second squared.
        """
        foot, hand = self._shares
        contacts = {
            link: low_pass(None if earlier is None else earlier.contacts.get(link), wrench[:3], foot)
            for link, wrench in reading.foot_wrenches.items()
        }
        raw = self._estimate_hands(reading, accelerations) if self._arms else {}
        hands = {
            tool: low_pass(None if earlier is None else earlier.hands[tool], force, hand) for tool, force in raw.items()
        }
        return MeasuredForces(contacts, hands)

    def _estimate_hands(
        self, reading: RobotReading, accelerations: Float[np.ndarray, "k"]
    ) -> dict[str, Float[np.ndarray, "3"]]:
        """Return the force on each tool that explains the torques of its arm's own joints, in least squares.

        ``tau = h(q, qd, qdd) - J^T f``; joints that both arms or the legs need as well carry other forces too.
        """
        model, data = self.robot.model, self._data
        q, v, a = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
        q[self._columns], v[self._columns], a[self._columns] = reading.q, reading.qd, accelerations
        if self.robot.is_floating:
            q[3 : len(BASE_NAMES)] = matrix_rpy(reading.imu_rotation)[::-1]
        expected = pin.rnea(model, data, q, v, a)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        forces = {}
        for tool, arm in self._arms.items():
            frame = model.getFrameId(tool)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            columns = self._columns[arm]
            lever = jacobian[:3, columns].T
            forces[tool] = np.linalg.lstsq(lever, expected[columns] - reading.torque[arm], rcond=0.05)[0]
        return forces


def _find_arm(robot: RobotModel, tool: str, columns: np.ndarray) -> np.ndarray:
    """Return the indices, in the readings' order, of the joints that carry a tool and no other end of the robot."""
    model = robot.model
    carrier = model.frames[model.getFrameId(tool)].parentJoint
    children = [sum(1 for parent in list(model.parents)[1:] if parent == joint) for joint in range(model.njoints)]
    chain: list[int] = []
    joint = carrier
    while joint > 0 and (children[joint] <= 1 or joint == carrier):
        chain.append(int(model.joints[joint].idx_v))
        joint = int(model.parents[joint])
    arm = np.array([k for k, column in enumerate(columns) if column in chain], dtype=int)
    if len(arm) < LEAST_JOINTS:
        raise ExecutionError(f"{robot.name}: {len(arm)} joints carry {tool} alone; its force needs {LEAST_JOINTS}")
    return arm
