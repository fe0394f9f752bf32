"""The ``attached`` section of a request: bodies that links of the robot carry."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, StrictBool
from pydantic.dataclasses import dataclass

from service.request.fields import SECTION, Name, Number, Point, Section, at_most
from service.request.scene import BoxRequest, CarriedMesh, ConvexRequest, CylinderRequest, SphereRequest


@dataclass(config=SECTION, kw_only=True)
class _Carried(Section):
    """A body fixed to ``link``, with its pose in that link's frame.

    Attributes:
        link: the link that carries it.
        touches: other links that hold it; each is kept relative to ``link``.
        mass_kg: its mass, uniformly distributed.
    """

    link: Name
    touches: Annotated[tuple[Name, ...], at_most(20)] = ()
    mass_kg: Annotated[Number, Field(ge=0.0, le=1000.0)] = 0.0


@dataclass(config=SECTION, kw_only=True)
class AttachedBox(_Carried, BoxRequest):
    """Carried box."""


@dataclass(config=SECTION, kw_only=True)
class AttachedSphere(_Carried, SphereRequest):
    """Carried sphere."""


@dataclass(config=SECTION, kw_only=True)
class AttachedCylinder(_Carried, CylinderRequest):
    """Carried cylinder."""


@dataclass(config=SECTION, kw_only=True)
class AttachedConvex(_Carried, ConvexRequest):
    """Carried convex hull of points."""


@dataclass(config=SECTION)
class ConvexPart(Section):
    """Corners of a convex part of a mesh, in the frame of the body [m]."""

    points: Annotated[tuple[Point, ...], Field(min_length=4), at_most(1000)]


@dataclass(config=SECTION, kw_only=True)
class AttachedMesh(_Carried, CarriedMesh):
    """Carried mesh, split into convex ``parts``, which planning reads from the file.

    Without ``decompose`` the mesh's hull is the only part.
    """

    decompose: StrictBool = True
    parts: Annotated[tuple[ConvexPart, ...], at_most(1000)] = ()


AttachedRequest = Annotated[
    AttachedBox | AttachedSphere | AttachedCylinder | AttachedConvex | AttachedMesh, Field(discriminator="type")
]
