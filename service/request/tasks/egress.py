"""Section of a request that gets out of a vehicle: surfaces, and phases with their contacts as data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field, StrictInt
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.fields import (
    SECTION,
    Coordinate,
    FilePath,
    Label,
    Name,
    Number,
    Point,
    Section,
    at_most,
    find_repeated,
)
from service.request.tasks.contacts import PostureRequest, Slack, SurfaceRequest
from service.request.tasks.kind import TaskSection

Weight = Annotated[Number, Field(ge=0.0, le=1e6)]
Angle = Annotated[Number, Field(ge=-180.0, le=180.0)]
RegionLength = Annotated[Number, Field(gt=0.0, le=2.0)]


@dataclass(config=SECTION)
class ContactRequest(Section):
    """Where a patch of the robot touches in a phase.

    Without a place it stays where the phase before has it, on the same surface; if that phase does not have it, the
    place is free on the surface.

    Attributes:
        surface: name of the surface.
        at: place of the patch's middle; moved to the nearest point of the surface, at most 0.1 m in its plane [m].
        toe: the same of the middle of the patch's points that are farthest along its link's x axis.
        yaw_deg: turn of the link's x axis about the surface's normal.
        region: lengths in x and y of the region about the place in which places are drawn [m].
        slack_m: by which the place may be moved along the longest edge of its surface where poses do not hold with it.
    """

    surface: Label
    at: Point | None = None
    toe: Point | None = None
    yaw_deg: Angle | None = None
    region: tuple[RegionLength, RegionLength] | None = None
    slack_m: Slack = 0.0

    def __post_init__(self) -> None:
        if self.at is not None and self.toe is not None:
            raise PydanticCustomError("contact", "at and toe exclude each other; give one")
        if self.region is not None and self.at is None and self.toe is None:
            raise PydanticCustomError("contact", "region needs a place in its middle; give at or toe")
        if self.slack_m and self.at is None and self.toe is None:
            raise PydanticCustomError("contact", "slack_m needs a place that may be moved; give at or toe")


@dataclass(config=SECTION)
class WeightsRequest(Section):
    """Weights of the shape costs (Liu et al., Humanoids 2015, sec. III).

    Attributes:
        posture: joints from the nominal pose [cost/rad^2].
        torso, pelvis: their orientation from that of the nominal pose [cost/rad^2].
        feet: orientation of feet whose place is free [cost/rad^2].
        hand_forces: forces on patches of the arms [cost/weight^2].
        facing: angle between a surface's normal and that of a patch of one or two points [cost/rad^2].
    """

    posture: Weight = 0.05
    torso: Weight = 1.0
    pelvis: Weight = 1.0
    feet: Weight = 1.0
    hand_forces: Weight = 0.02
    facing: Weight = 1.0


@dataclass(config=SECTION)
class SideRequest(Section):
    """A point of the robot that should stay on one side of a plane: a quadratic cost beyond it (eq. 2 of the paper).

    Attributes:
        link: that carries the point.
        normal, limit: the point costs where ``normal . p > limit`` [m].
        point: in the link's frame [m].
        weight: [cost/m^2].
    """

    link: Name
    normal: Point
    limit: Coordinate
    point: Point = (0.0, 0.0, 0.0)
    weight: Weight = 20.0

    def __post_init__(self) -> None:
        if math.hypot(*self.normal) < 1e-6:
            raise PydanticCustomError("side", "normal has no length; expected a direction such as [1, 0, 0]")


@dataclass(config=SECTION)
class PhaseRequest(Section):
    """A phase: its contacts by patch, the poses it starts from, and what they cost.

    Attributes:
        name: unique among the phases.
        contacts: by name of a contact patch of the robot.
        postures: nominal poses; each is tried.
        weights: of the shape costs.
        sides: planes that knees, elbows and chest should not cross.
        sampled: whether a pose is solved for every drawn place; else for the chosen sequence only.
    """

    name: Label
    contacts: Annotated[dict[Name, ContactRequest], at_most(12)]
    postures: Annotated[tuple[PostureRequest, ...], at_most(8)] = ()
    weights: WeightsRequest = field(default_factory=WeightsRequest)
    sides: Annotated[tuple[SideRequest, ...], at_most(20)] = ()
    sampled: bool = False

    def __post_init__(self) -> None:
        if not self.contacts:
            raise PydanticCustomError("phase", "contacts: at least one is needed")


@dataclass(config=SECTION)
class PhasesFile(Section):
    """Content of a phases file."""

    phases: Annotated[tuple[PhaseRequest, ...], at_most(40)]

    def __post_init__(self) -> None:
        check_phases(self.phases)


@dataclass(config=SECTION)
class EgressRequest(TaskSection):
    """Task of getting out of a vehicle by many contacts.

    Attributes:
        side: of the vehicle on which the robot leaves.
        hint: a point near the vehicle [m].
        surfaces: by name.
        phases: in their order; or ``phases_file``. By default those that ship with the package, mirrored for ``left``.
        until: name of the phase to end with; the last one by default.
        samples: number of places drawn for each contact with a region.
        torque_share: of each joint's limit that a pose may need.
        margin_n: error that the force at every contact point may have without slipping, lifting or pressing too
            hard [N].
    """

    effort_s = 300.0

    side: Literal["left", "right"] = "left"
    hint: Point | None = None
    surfaces: Annotated[dict[Label, SurfaceRequest], at_most(100)] = field(default_factory=dict)
    phases: Annotated[tuple[PhaseRequest, ...], at_most(40)] = ()
    phases_file: FilePath | None = None
    until: Label | None = None
    samples: Annotated[StrictInt, Field(ge=1, le=1000)] = 25
    torque_share: Annotated[Number, Field(gt=0.0, le=1.0)] = 1.0
    margin_n: Annotated[Number, Field(ge=0.0, le=1000.0)] = 0.0

    def __post_init__(self) -> None:
        if self.phases and self.phases_file is not None:
            raise PydanticCustomError("egress", "phases and phases_file exclude each other; give one")
        check_phases(self.phases)

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the hint."""
        yield "hint", self.hint

    def list_paths(self) -> Iterator[tuple[str, str]]:
        """Yield the file of the phases."""
        if self.phases_file is not None:
            yield "phases_file", self.phases_file


def check_phases(phases: tuple[PhaseRequest, ...]) -> None:
    """Refuse phases of equal names."""
    twice = find_repeated(phase.name for phase in phases)
    if twice:
        raise PydanticCustomError("phases", "phase name {name} is given twice", {"name": shown(twice[0])})
