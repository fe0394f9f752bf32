"""The ``attached`` section of a request: bodies that links of the robot carry."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import SECTION, Name, Number, Section, at_most
from service.request.scene import BoxRequest, CylinderRequest, SphereRequest


@dataclass(config=SECTION, kw_only=True)
class _Carried(Section):
    """A body fixed to ``link``, in whose frame it is placed.

    Attributes:
        link: the link that carries it.
        touches: further links that hold it; each is kept relative to ``link``.
        mass_kg: spread evenly.
    """

    link: Name
    touches: Annotated[tuple[Name, ...], at_most(20)] = ()
    mass_kg: Annotated[Number, Field(ge=0.0, le=1000.0)] = 0.0


@dataclass(config=SECTION, kw_only=True)
class AttachedBox(_Carried, BoxRequest):
    """A box that is carried."""


@dataclass(config=SECTION, kw_only=True)
class AttachedSphere(_Carried, SphereRequest):
    """A sphere that is carried."""


@dataclass(config=SECTION, kw_only=True)
class AttachedCylinder(_Carried, CylinderRequest):
    """A cylinder that is carried."""


AttachedRequest = Annotated[AttachedBox | AttachedSphere | AttachedCylinder, Field(discriminator="type")]
