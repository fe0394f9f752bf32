"""Section of a request that says which joint torques are checked."""

from __future__ import annotations

from typing import Annotated

from pydantic.dataclasses import dataclass

from service.request.fields import MAX_JOINTS, SECTION, Name, Section, at_most


@dataclass(config=SECTION)
class RobotTorqueRequest(Section):
    """Torque limits that count.

    Attributes:
        check: whether torques are compared with the limits of the joints at all.
        unchecked: joints whose torque is not compared, because a spring or a passive balance carries part of it.
    """

    check: bool = True
    unchecked: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()
