"""Section of a request that gives a robot a contact patch: points of a link that may carry force."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Name, Number, Point, Section, at_most

MAX_POINTS = 32


@dataclass(config=SECTION)
class ContactPatchRequest(Section):
    """Points of a link that may press on the surroundings.

    What is left out comes from the robot's own patch of that name, else from the kind.

    Attributes:
        link: a link of the robot with a body, on whose surface the points lie.
        points: in the link's frame [m].
        normal: direction in the link's frame, of any length, in which the surroundings push on the link.
        kind: gives the defaults of friction and cap; ``arm`` unless the robot has a patch of that name.
        friction: coefficient.
        force_cap_n: largest normal force of each point [N].
    """

    link: Name | None = None
    points: Annotated[tuple[Point, ...], Field(min_length=1), at_most(MAX_POINTS)] | None = None
    normal: Point | None = None
    kind: Literal["foot", "trunk", "arm"] | None = None
    friction: Annotated[Number, Field(ge=0.0, le=2.0)] | None = None
    force_cap_n: Annotated[Number, Field(gt=0.0, le=1e5)] | None = None

    def __post_init__(self) -> None:
        if self.normal is not None and math.hypot(*self.normal) < 1e-6:
            raise PydanticCustomError("contact", "normal has no length; expected a direction such as [0, 0, 1]")
