"""Robots, kinematics, scenes, curves, and the terms measured on them; ``dir(costs)`` lists what terms of your own need.

A name is imported when it is first used: the verifier uses scenes and curves without the optimiser's terms.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from costs.collision import Contacts
    from costs.curve import Curve, TimeLaw
    from costs.kinematics import Kinematics, KinematicsEngine, locate_frame
    from costs.robot import RobotModel, load_robot
    from costs.scene import ConvexPiece, Scene
    from costs.state import MotionState
    from costs.terms import FramePose, JointDifference

__all__ = [
    "Contacts",
    "ConvexPiece",
    "Curve",
    "FramePose",
    "JointDifference",
    "Kinematics",
    "KinematicsEngine",
    "MotionState",
    "RobotModel",
    "Scene",
    "TimeLaw",
    "load_robot",
    "locate_frame",
]

_MODULES = {
    "collision": ("Contacts",),
    "curve": ("Curve", "TimeLaw"),
    "kinematics": ("Kinematics", "KinematicsEngine", "locate_frame"),
    "robot": ("RobotModel", "load_robot"),
    "scene": ("ConvexPiece", "Scene"),
    "state": ("MotionState",),
    "terms": ("FramePose", "JointDifference"),
}


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"costs.{module}"), name)
    raise AttributeError(f"module 'costs' has no attribute {name!r}")
