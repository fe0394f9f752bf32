"""Configurations as the numbers of a pose, and the same configurations read back bit by bit."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import BASE_NAMES, RobotModel
from service.errors import RequestError
from service.posing.numbers import PoseNumbers
from service.request.schema import PoseRequest, StartRequest
from service.start.configuration import make_start_configuration


def list_joint_names(robot: RobotModel) -> tuple[str, ...]:
    """Return the joints whose positions a pose has."""
    return robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names


def write_pose(robot: RobotModel, q: Float[np.ndarray, "n"]) -> PoseNumbers:
    """Return the numbers of a configuration.

    A quaternion has other roundings than the angles of a base: the pose is the one that is read from the numbers.
    """
    if not robot.is_floating:
        return PoseNumbers((), tuple(q.tolist()))
    x, y, z = q[:3].tolist()
    qw, qx, qy, qz = Rotation.from_euler("ZYX", q[3:6]).as_quat(scalar_first=True, canonical=True).tolist()
    base = PoseRequest((x, y, z), (qw, qx, qy, qz))
    return PoseNumbers((*base.position, *base.quaternion_wxyz), tuple(q[len(BASE_NAMES) :].tolist()))


def read_pose(robot: RobotModel, numbers: PoseNumbers) -> Float[np.ndarray, "n"]:
    """Return the configuration of a pose's numbers, as the start of a request is read.

    Raises:
        RequestError: there are not as many as the robot has joints, or one is beyond its limits.
    """
    names = list_joint_names(robot)
    if len(numbers.positions) != len(names) or len(numbers.base) != (7 if robot.is_floating else 0):
        raise RequestError(
            f"pose: {len(numbers.base)} numbers of a base and {len(numbers.positions)} positions; {robot.name} has "
            f"{7 if robot.is_floating else 0} and {len(names)}"
        )
    base = None
    if numbers.base:
        x, y, z, qw, qx, qy, qz = numbers.base
        base = PoseRequest((x, y, z), (qw, qx, qy, qz))
    start = StartRequest(joint_names=names, positions=numbers.positions, base=base)
    return make_start_configuration(robot, start)[0]
