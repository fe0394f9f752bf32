"""Atlas that stands still beside a door whose leaf and lever move."""

from __future__ import annotations

from functools import cache

import numpy as np
from tiny_robots import atlas

from costs.curve import Curve
from costs.robot import MechanismJoint, RobotModel, with_mechanism
from costs.scene import Scene
from service.verify import Motion

UP, OUT = np.array([0.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0])
HINGE, SPINDLE = np.array([0.8, -0.45, 0.0]), np.array([0.74, 0.35, 1.0])
BOX = np.array([[x, y, z] for x in (0.0, 0.02) for y in (0.0, 0.1) for z in (0.0, 0.02)])


@cache
def with_door() -> RobotModel:
    """Atlas and a leaf that carries a lever, their angles the last two coordinates."""
    leaf = MechanismJoint("opening", "leaf", HINGE, -UP, {"leaf/slab": HINGE + BOX}, lower=-0.1, upper=2.0)
    lever = MechanismJoint("turning", "lever", SPINDLE, OUT, {"lever/bar": SPINDLE + BOX}, parent="leaf", lower=-1.0)
    return with_mechanism(atlas(), [leaf, lever])


def motion_of(values: np.ndarray) -> Motion:
    """The robot stands still while the mechanism passes values at equal steps."""
    robot = with_door()
    q = np.tile(np.append(atlas().postures["stand"], [0.0, 0.0]), (len(values), 1))
    q[:, -2:] = values
    knots = np.arange(float(len(values)))
    return Motion(robot, Scene(), Curve(knots, q, np.gradient(q, axis=0)), None, ())
