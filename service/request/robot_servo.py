"""Section of a request that describes the servos of a robot's joints."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import SECTION, Name, Number, Section, at_most

Stiffness = Annotated[Number, Field(gt=0.0, le=1e7)]


@dataclass(config=SECTION)
class RobotServoRequest(Section):
    """Position servos of the joints.

    Attributes:
        stiffness: by joint, by group of the SRDF, or by a word of joint names such as ``leg`` [N m/rad, N/m]; joints
            that are not named have the robot's default.
    """

    stiffness: Annotated[dict[Name, Stiffness], at_most(200)] = field(default_factory=dict)
