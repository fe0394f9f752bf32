"""Section of a request that changes contacts: surfaces of the world, and stances on them one after another."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.fields import (
    SECTION,
    Coordinate,
    Joints,
    Label,
    Name,
    Number,
    Point,
    Section,
    at_most,
    find_repeated,
)
from service.request.tasks.kind import TaskSection

Slack = Annotated[Number, Field(ge=0.0, le=0.5)]
BasePose = tuple[Coordinate, Coordinate, Coordinate, Number, Number, Number]
MAX_SURFACES, MAX_STANCES, MAX_CORNERS = 64, 64, 32


@dataclass(config=SECTION)
class SurfaceRequest(Section):
    """Flat patch of the world: the side of ``piece`` that faces along ``normal``, or a polygon of ``corners``.

    Attributes:
        piece: an obstacle or a piece of the scan.
        normal: outward direction, of any length; upwards by default.
        corners: of a convex polygon, in any sense.
        pieces: what is behind ``corners``, and may be touched there.
        friction: coefficient; the lower one of surface and patch counts.
    """

    piece: Name | None = None
    normal: Point = (0.0, 0.0, 1.0)
    corners: Annotated[tuple[Point, ...], Field(min_length=3), at_most(MAX_CORNERS)] | None = None
    pieces: Annotated[tuple[Name, ...], at_most(MAX_SURFACES)] = ()
    friction: Annotated[Number, Field(gt=0.0, le=2.0)] = 0.6

    def __post_init__(self) -> None:
        if (self.piece is None) == (self.corners is None):
            raise PydanticCustomError("surface", "give either piece or corners")
        if self.piece is not None and self.pieces:
            raise PydanticCustomError("surface", "pieces belong to corners; a surface of a piece is that piece's own")
        if math.hypot(*self.normal) < 1e-6:
            raise PydanticCustomError("surface", "normal has no length; expected a direction such as [0, 0, 1]")


@dataclass(config=SECTION)
class PlaceRequest(Section):
    """Place of a contact patch on a surface.

    Attributes:
        surface: its name; ``floor`` is always there.
        at: the middle of the patch, moved along the normal onto the surface [m].
        yaw_deg: turn of the patch's link about the surface's normal; 0 points its x axis along the world's x axis (on a
            surface across it, along the z axis).
        slack_m: by which the place may be moved along the longest edge of its surface, either way, where poses on the
            way do not hold with it. Only a place that a later phase stands on is moved.
    """

    surface: Name
    at: Point
    yaw_deg: Annotated[Number, Field(ge=-360.0, le=360.0)] = 0.0
    slack_m: Slack = 0.0


@dataclass(config=SECTION)
class PostureRequest(Section):
    """A nominal pose: joints over a named posture of the robot.

    Attributes:
        base: x, y, z, yaw, pitch, roll of the base [m, rad].
        joints: positions by name [rad].
        posture: of all other joints.
    """

    base: BasePose
    joints: Joints = field(default_factory=dict)
    posture: Label = "stand"


@dataclass(config=SECTION)
class StanceRequest(Section):
    """Change of contacts: what is made at a new place, and what is released; all others stay where they are.

    Without either, the robot moves to ``posture`` on the contacts that it has.

    Attributes:
        name: as messages and phases have it.
        make: place by name of the robot's contact patch.
        release: patches that let go.
        posture: to move to where no contact changes, as far as the contacts allow.
    """

    name: Label
    make: Annotated[dict[Name, PlaceRequest], at_most(MAX_SURFACES)] = field(default_factory=dict)
    release: Annotated[tuple[Name, ...], at_most(MAX_SURFACES)] = ()
    posture: PostureRequest | None = None

    def __post_init__(self) -> None:
        changes = bool(self.make or self.release)
        if not changes and self.posture is None:
            words = "neither makes nor releases a contact; expected one of them, or a posture to move to"
            raise PydanticCustomError("stance", words)
        if changes and self.posture is not None:
            words = "changes contacts and has a posture to move to; expected a stance for each"
            raise PydanticCustomError("stance", words)
        both = sorted(set(self.make) & set(self.release))
        if both:
            words = "{patch} is both made and released; a patch that is made anew leaves its old place by itself"
            raise PydanticCustomError("stance", words, {"patch": shown(both[0])})


@dataclass(config=SECTION)
class ContactsRequest(TaskSection):
    """Task of moving from stance to stance: steps, handrails, chairs, and whatever else carries the robot.

    Attributes:
        surfaces: by name, besides ``floor``.
        start: surface of each patch that carries the robot at the start; by default the feet on the floor.
        stances: in their order.
        finish: posture to end in, as far as the last stance allows.
    """

    surfaces: Annotated[dict[Name, SurfaceRequest], at_most(MAX_SURFACES)] = field(default_factory=dict)
    start: Annotated[dict[Name, Name], at_most(MAX_SURFACES)] = field(default_factory=dict)
    stances: Annotated[tuple[StanceRequest, ...], Field(min_length=1), at_most(MAX_STANCES)] = ()
    finish: Label | None = None

    def __post_init__(self) -> None:
        twice = find_repeated(stance.name for stance in self.stances)
        if twice:
            raise PydanticCustomError("contacts", "two stances are named {name}", {"name": shown(twice[0])})
