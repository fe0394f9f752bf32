"""Joints that turn without limits: their angles are places on a circle, equal after a whole turn."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from costs.robot.mechanism import read_joint_axis
from costs.robot.model import BASE_NAMES, RobotModel

WHOLE_TURN = 2.0 * math.pi  # [rad]


def list_circular(robot: RobotModel) -> Int[np.ndarray, "c"]:
    """Return the coordinates of turning joints without limits; those of a floating base are none of them."""
    first = len(BASE_NAMES) if robot.is_floating else 0
    free = np.flatnonzero(np.isinf(robot.lower) & np.isinf(robot.upper))
    return np.array([k for k in free if k >= first and _turns(robot, robot.joint_names[k])], dtype=int)


def turn_near(
    robot: RobotModel, q: Float[np.ndarray, "*T n"], near: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "*T n"]:
    """Return configurations whose circular coordinates are within half a turn of those of ``near``."""
    out = np.array(q, dtype=float)
    for k in list_circular(robot):
        out[..., k] -= WHOLE_TURN * np.round((out[..., k] - near[k]) / WHOLE_TURN)
    return out


def _turns(robot: RobotModel, name: str) -> bool:
    joint = robot.model.getJointId(name)
    return joint < robot.model.njoints and bool(np.any(read_joint_axis(robot, joint)[3:]))
