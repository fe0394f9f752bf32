"""Section of a request that names the frames of a robot's hand."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import SECTION, Name, Number, Section


@dataclass(config=SECTION)
class RobotHandRequest(Section):
    """Hand with a straight rod on its axis, which serves as a hook and as a peg; frames are links of the robot.

    Attributes:
        link: the hand itself.
        hook: link of the rod, which may touch what is held.
        tool: frame at the rod's end, z along the hand's axis outwards.
        peg, stub: frames in the middle of the free rod and where it leaves the hand, parallel to ``tool``; doors and
            mechanisms need them.
        peg_radius_m: half the rod's thickness.
    """

    link: Name
    hook: Name
    tool: Name
    peg: Name | None = None
    stub: Name | None = None
    peg_radius_m: Annotated[Number, Field(gt=0.0, le=0.1)] = 0.009
