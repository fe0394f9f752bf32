"""Whether a robot has the masses that balance needs."""

from __future__ import annotations

import pinocchio as pin

from costs.robot import RobotModel
from service.errors import RequestError

LEAST_MASS_KG = 1e-3


def check_masses(robot: RobotModel) -> None:
    """
    Raises:
        RequestError: a robot that has to keep its balance weighs nothing.
    """
    mass = float(pin.computeTotalMass(robot.model))
    if robot.is_floating and not mass >= LEAST_MASS_KG:
        raise RequestError(
            f"robot.urdf: the links of {robot.name} have {mass:g} kg in all, and a floating robot keeps its balance "
            "by their masses; give the links <inertial>, or set robot.root to fixed"
        )
