"""Section of a request that takes an object of the scene and puts it elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import SECTION, Name, Number, Point, Quaternion, Section
from service.request.tasks.kind import TaskSection


@dataclass(config=SECTION)
class ObjectPlaceRequest(Section):
    """Pose of an object in the world; without a quaternion it is turned as at the start."""

    position: Point
    quaternion_wxyz: Quaternion | None = None


@dataclass(config=SECTION)
class PickRequest(TaskSection):
    """Task of taking an object, carrying it, and putting it down where it rests.

    Attributes:
        object: name of one of ``scene.objects``.
        to: where it is put.
        hand: hand to use; ``auto`` tries both, ``both`` holds the object with two hands.
        grip_n: force with which each finger presses it.
        lift_m: height by which it is lifted before it is carried, and from which it is put down.
        opening_m: free space between each finger and the object as the hand comes and goes.
    """

    object: Name
    to: ObjectPlaceRequest
    hand: Literal["left", "right", "auto", "both"] = "auto"
    grip_n: Annotated[Number, Field(gt=0.0, le=2000.0)] = 60.0
    lift_m: Annotated[Number, Field(ge=0.01, le=1.0)] = 0.08
    opening_m: Annotated[Number, Field(ge=0.002, le=0.1)] = 0.01

    effort_s = 120.0

    @property
    def can_resume(self) -> bool:
        """Not yet: the state of a robot does not say what it holds."""
        return False

    @property
    def carried(self) -> tuple[str, ...]:
        """The object."""
        return (self.object,)

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield where the object is put."""
        yield "to.position", self.to.position
