"""Objects that a user gives by parameters: simple shapes, wheels and levers, alone or together."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, StrictInt
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Number, Point, Quaternion, Section, Size, Sizes, at_most

OBJECT_SUFFIXES = (".yaml", ".yml", ".json")
"""Suffixes of object files."""

MOST_PARTS = 100
"""Greatest number of an object's parts."""

_NotNegative = Annotated[Number, Field(ge=0.0, le=100.0)]


@dataclass(config=SECTION, kw_only=True)
class _Part(Section):
    """Part of an object, and its pose in the object's frame."""

    position: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(config=SECTION, kw_only=True)
class BoxPart(_Part):
    """A box with edge lengths ``size``, its centre at ``position``."""

    type: Literal["box"]
    size: Sizes


@dataclass(config=SECTION, kw_only=True)
class CylinderPart(_Part):
    """A cylinder of length ``height`` along its own z axis, its centre at ``position``."""

    type: Literal["cylinder"]
    radius: Size
    height: Size


@dataclass(config=SECTION, kw_only=True)
class CapsulePart(_Part):
    """A cylinder of length ``height`` along its own z axis with a half sphere on either end."""

    type: Literal["capsule"]
    radius: Size
    height: Size


@dataclass(config=SECTION, kw_only=True)
class WheelPart(_Part):
    """A wheel about its own z axis: ``radius`` of the rim's centre line, ``rim_radius`` of the rim's section.

    Without ``spokes`` it is a ring without hub.
    """

    type: Literal["wheel"]
    radius: Size
    rim_radius: Size
    spokes: Annotated[StrictInt, Field(ge=0, le=64)] = 0
    spoke_radius: Size | None = None
    hub_radius: Size | None = None


@dataclass(config=SECTION, kw_only=True)
class LeverPart(_Part):
    """A round lever along its own x axis from its pivot at ``position``; with a grip along z at its end, a crank."""

    type: Literal["lever"]
    length: Size
    radius: Size
    grip_length: _NotNegative = 0.0
    grip_radius: Size | None = None


PartRequest = Annotated[BoxPart | CylinderPart | CapsulePart | WheelPart | LeverPart, Discriminator("type")]


@dataclass(config=SECTION)
class ObjectRequest(Section):
    """An object of one part or several, which may overlap."""

    parts: Annotated[tuple[PartRequest, ...], at_most(MOST_PARTS)]

    def __post_init__(self) -> None:
        if not self.parts:
            raise PydanticCustomError("parts", "an object needs at least one part")
