"""Steps that take objects of the scene, let go of them, and bring them into holes and out of them."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Name, Number, Point, Section, at_most

WayM = Annotated[Number, Field(ge=0.005, le=0.5)]
OpeningM = Annotated[Number, Field(ge=0.002, le=0.1)]


@dataclass(config=SECTION)
class GraspStep(Section):
    """A hand comes to an object on a line, closes its fingers, and carries it from then on.

    Attributes:
        object: name of one of ``scene.objects``.
        hand: that takes it; ``auto`` tries both, ``both`` holds it with two hands.
        grasp: number of one of the object's ``grasps``; by default any of them.
        force_n: with which each finger presses it [N].
        opening_m: free space between each finger and the object as the hand comes [m].
        approach_m: length of the line on which it comes [m].
    """

    object: Name
    hand: Literal["left", "right", "auto", "both"] = "auto"
    grasp: Annotated[int, Field(ge=0, le=1000)] | None = None
    force_n: Annotated[Number, Field(gt=0.0, le=2000.0)] = 60.0
    opening_m: OpeningM = 0.01
    approach_m: WayM = 0.1


@dataclass(config=SECTION)
class HoldStep(Section):
    """An object that a hand holds as the list begins, where the scene has it; nothing moves.

    Attributes:
        object: name of one of ``scene.objects``.
        hand: that holds it.
        force_n: with which each finger presses it [N].
    """

    object: Name
    hand: Literal["left", "right", "both"]
    force_n: Annotated[Number, Field(gt=0.0, le=2000.0)] = 60.0


@dataclass(config=SECTION)
class ReleaseStep(Section):
    """The fingers open, and the hands leave an object where it rests, or where another hand holds it.

    Attributes:
        object: that is held.
        hand: that lets it go; ``both`` for every hand that holds it.
        opening_m: free space between each finger and the object as the hand goes [m].
        retreat_m: length of the line on which it goes [m].
    """

    object: Name
    hand: Literal["left", "right", "both"] = "both"
    opening_m: OpeningM = 0.01
    retreat_m: WayM = 0.1


@dataclass(config=SECTION)
class FitStep(Section):
    """An object that is held goes straight into a hole or out of it.

    Attributes:
        object: that is held.
        axis: direction in which it moves, along the hole.
        depth_m: by which it moves [m].
        at: a point of the hole's axis; by default where the object's origin is [m].
        pieces: of the scene about the hole, which the object may touch.
        clearance_m: width of the hole less that of the object [m].
        chamfer_m: of the hole's edge, or of the object's [m].
        friction: largest coefficient between them.
        force_n: largest force along the hole: the feet hold the robot under it, and an object that goes in does not jam
            within it [N].
        speed_m_s: of the object between its ramps.
    """

    object: Name
    axis: Point
    depth_m: Annotated[Number, Field(gt=0.0, le=1.0)]
    clearance_m: Annotated[Number, Field(gt=0.0, le=0.1)]
    at: Point | None = None
    pieces: Annotated[tuple[Name, ...], at_most(64)] = ()
    chamfer_m: Annotated[Number, Field(ge=0.0, le=0.1)] = 0.0
    friction: Annotated[Number, Field(gt=0.0, le=2.0)] = 0.6
    force_n: Annotated[Number, Field(ge=0.0, le=1000.0)] = 20.0
    speed_m_s: Annotated[Number, Field(gt=0.0, le=1.0)] = 0.05

    def __post_init__(self) -> None:
        if math.hypot(*self.axis) < 1e-6:
            raise PydanticCustomError("direction", "axis has no length; expected a direction such as [0, 0, 1]")
