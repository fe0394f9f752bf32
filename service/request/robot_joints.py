"""Sections of a request that describe a robot's joints: their servos, and which of their torques are checked."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import MAX_JOINTS, SECTION, Name, Number, Section, at_most

Stiffness = Annotated[Number, Field(gt=0.0, le=1e7)]


@dataclass(config=SECTION)
class RobotServoRequest(Section):
    """Position servos of the joints.

    Attributes:
        stiffness: by joint, by group of the SRDF, or by a word of joint names such as ``leg`` [N m/rad, N/m]; joints
            that are not named have the robot's default.
    """

    stiffness: Annotated[dict[Name, Stiffness], at_most(200)] = field(default_factory=dict)


@dataclass(config=SECTION)
class RobotTorqueRequest(Section):
    """Torque limits that count.

    Attributes:
        check: whether torques are compared with the limits of the joints at all.
        unchecked: joints whose torque is not compared, because a spring or a passive balance carries part of it.
    """

    check: bool = True
    unchecked: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()
