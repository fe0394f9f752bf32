"""Section of a request that moves a mechanism described by a URDF: a drawer, a cabinet, a box with a lever."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import field
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StrictStr
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Name, Number, Point, Quaternion, Section, at_most
from service.request.tasks.kind import MovedNames, TaskSection

MECHANISM = "mechanism"  # its links are MECHANISM/...
STILL = "fixture"  # its bodies that no joint moves are fixture/...
MAX_TEXT = 500_000
MAX_PATH = 4096
MAX_MESH_POINTS = 2000
Value = Annotated[Number, Field(ge=-100.0, le=100.0)]
Load = Annotated[Number, Field(ge=0.0, le=1000.0)]


def is_urdf_text(urdf: str) -> bool:
    """Return whether a request's ``urdf`` is the text of a URDF, not the path of a file."""
    return urdf.lstrip().startswith("<")


def _check_urdf(urdf: str) -> str:
    if not is_urdf_text(urdf) and (len(urdf) > MAX_PATH or not urdf.isprintable()):
        raise PydanticCustomError("urdf", "expected the path of a URDF file, or its text, which begins with '<'")
    return urdf


@dataclass(config=SECTION)
class MechanismJointRequest(Section):
    """Start and loads of a joint; loads are torques [N m] of a revolute joint, forces [N] of a prismatic one.

    Attributes:
        start: value at the start [rad, m].
        friction: dry friction, which also holds the joint where nothing else does; None for that of the URDF.
        preload: with which a spring pulls the joint back to its start, once it has left it.
        stiffness: increase of that per travel from the start [N m/rad, N/m].
    """

    start: Value | None = None
    friction: Load | None = None
    preload: Load = 0.0
    stiffness: Annotated[Number, Field(ge=0.0, le=1e5)] = 0.0


@dataclass(config=SECTION)
class MechanismHandleRequest(Section):
    """How a hand holds the mechanism, described in the frame of one of its links.

    Attributes:
        link: link of the URDF.
        place: of the tool's origin while the hand holds [m].
        axis: direction in which the hand points, outwards from the wrist.
        tool: ``peg`` is the middle of the hand's free rod, ``tip`` its end, ``stub`` where it leaves the hand.
        approach: from the place to where the line begins on which the hand comes and leaves [m]; by default 0.1 m
            against ``axis``.
        slide: the tool may be anywhere on ``place`` +- ``slide`` [m].
        tilt_deg: largest lean of the hand from ``axis``.
    """

    link: Name
    place: Point
    axis: Point
    tool: Literal["peg", "tip", "stub"] = "peg"
    approach: Point | None = None
    slide: Point | None = None
    tilt_deg: Annotated[Number, Field(ge=4.0, le=60.0)] = 20.0

    def __post_init__(self) -> None:
        for name, vector in (("axis", self.axis), ("approach", self.approach), ("slide", self.slide)):
            if vector is not None and math.hypot(*vector) < 1e-6:
                raise PydanticCustomError("handle", "{name} has no length; expected a vector", {"name": name})


@dataclass(config=SECTION)
class MoveRequest(Section):
    """A joint and the value that the hand moves it to [rad, m]."""

    joint: Name
    to: Value


@dataclass(config=SECTION)
class ReleaseRequest(Section):
    """Latch: ``joint`` stays at 0 until ``latch`` is at ``at`` or beyond it, or ``joint`` past ``free_beyond``."""

    joint: Name
    latch: Name
    at: Value
    free_beyond: Annotated[Number, Field(gt=0.0, le=10.0)] = 0.05


@dataclass(config=SECTION)
class MeshHullRequest(Section):
    """Corners of the convex hull of a mesh that the URDF names, in units of its file."""

    points: Annotated[tuple[Point, ...], Field(min_length=4), at_most(MAX_MESH_POINTS)]


@dataclass(config=SECTION)
class MechanismRequest(TaskSection):
    """Task of moving a mechanism by one hold of a hand.

    Attributes:
        urdf: path of a URDF file, or its text; planning replaces a path by the text.
        position, quaternion_wxyz: pose of its root link in the world.
        joints: starts and loads by name; other joints start at 0 and carry no load.
        handle: where and how the hand holds it.
        moves: joints to move, one after the other.
        releases: latches.
        hand: hand to use; ``auto`` tries both.
        stays: whether the hand stays at the handle at the end.
        meshes: corners of the hulls of the URDF's meshes, by the name that it gives them; read from the files beside it
            by default.
    """

    urdf: Annotated[StrictStr, Field(min_length=1, max_length=MAX_TEXT), AfterValidator(_check_urdf)]
    handle: MechanismHandleRequest
    moves: Annotated[tuple[MoveRequest, ...], Field(min_length=1), at_most(16)]
    position: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    joints: Annotated[dict[Name, MechanismJointRequest], at_most(16)] = field(default_factory=dict)
    releases: Annotated[tuple[ReleaseRequest, ...], at_most(16)] = ()
    hand: Literal["left", "right", "auto"] = "auto"
    stays: bool = False
    meshes: Annotated[dict[Name, MeshHullRequest], at_most(64)] = field(default_factory=dict)

    @property
    def moved_names(self) -> MovedNames:
        """What the URDF describes; its joints may have any names."""
        return MovedNames(MECHANISM)

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the position of the URDF's root."""
        yield "position", self.position

    def list_paths(self) -> Iterator[tuple[str, str]]:
        """Yield the URDF, unless the request has its text."""
        if not is_urdf_text(self.urdf):
            yield "urdf", self.urdf
