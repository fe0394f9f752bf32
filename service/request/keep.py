"""The ``keep`` section of a request: relative poses that hold along the whole motion."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.fields import SECTION, Name, Number, Point, Quaternion, Section


@dataclass(config=SECTION)
class KeepRequest(Section):
    """A link keeps its pose relative to another link along the whole motion (two hands on a beam).

    Attributes:
        link: a link or frame of the robot.
        relative_to: another one; the world when absent.
        position, quaternion_wxyz: the pose of ``link`` in ``relative_to``; what is absent is as at the start.
        position_tolerance_m: greatest distance of the link's origin from its place.
        rotation_tolerance_deg: greatest angle off the orientation, or of the free axis off its direction.
        free_axis: axis of ``link`` about which it may turn.
    """

    link: Name
    relative_to: Name | None = None
    position: Point | None = None
    quaternion_wxyz: Quaternion | None = None
    position_tolerance_m: Annotated[Number, Field(ge=5e-4, le=1.0)] = 0.005
    rotation_tolerance_deg: Annotated[Number, Field(ge=0.05, le=180.0)] = 1.0
    free_axis: Literal["none", "x", "y", "z"] = "none"

    def __post_init__(self) -> None:
        if self.link == self.relative_to:
            raise PydanticCustomError(
                "keep", "link and relative_to are both {link}; two links are needed", {"link": shown(self.link)}
            )
