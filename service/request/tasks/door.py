"""Section of a request that opens a door: leaf and handle where they are given, and the loads to plan for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Number, Point, Section
from service.request.tasks.kind import MovedNames, TaskSection, check_moved

DOOR = "door"  # its links are DOOR/...
LEAF_JOINT, HANDLE_JOINT = "door_opening", "door_handle"
MOST_RISE_M = 0.05  # of a leaf's free edge over its hinge
Metres = Annotated[Number, Field(gt=0.0, le=5.0)]


@dataclass(config=SECTION)
class LeafRequest(Section):
    """The leaf of a door, described shut.

    Attributes:
        hinge: the hinge axis at the leaf's lower edge [m]; the axis is vertical.
        edge: the free edge of the shut leaf, on the same level [m].
        height_m, thickness_m: of the leaf.
        face_m: distance of the face towards the robot from the hinge axis; by default the axis is on the face towards
            which the leaf opens.
        ajar_deg: opening angle at the start.
    """

    hinge: Point
    edge: Point
    height_m: Metres = 2.0
    thickness_m: Annotated[Number, Field(ge=0.005, le=0.3)] = 0.045
    face_m: Annotated[Number, Field(ge=-0.3, le=0.3)] | None = None
    ajar_deg: Annotated[Number, Field(ge=0.0, le=120.0)] = 0.0

    def __post_init__(self) -> None:
        if math.hypot(self.edge[0] - self.hinge[0], self.edge[1] - self.hinge[1]) < 0.2:
            raise PydanticCustomError("leaf", "edge is less than 0.2 m from hinge; expected the width of a door")
        rise = self.edge[2] - self.hinge[2]
        if abs(rise) > MOST_RISE_M:
            raise PydanticCustomError(
                "leaf",
                "edge: is {distance} m {side} hinge; expected the same level, both at the leaf's lower edge",
                {"distance": f"{abs(rise):.2f}", "side": "above" if rise > 0.0 else "below"},
            )


@dataclass(config=SECTION)
class HandleRequest(Section):
    """The handle of a door, on the face towards the robot, with the leaf shut and a lever at rest.

    Attributes:
        kind: ``lever`` turns about a spindle, ``pull`` is a fixed bar, ``push_bar`` is pressed towards the leaf.
        centre: of a lever's bar at its spindle, else of the bar's middle [m].
        direction: along the bar, of a lever from the spindle to its free end; by default towards the hinge, for a pull
            handle upwards.
        length_m: of a lever from the spindle to its free end, else of the bar; 0.12, 0.3 and 0.7 by default.
        radius_m: half the bar's thickness.
        turned_deg: angle by which a lever is turned down at the start.
    """

    kind: Literal["lever", "pull", "push_bar", "knob"]
    centre: Point
    direction: Point | None = None
    length_m: Metres | None = None
    radius_m: Annotated[Number, Field(ge=0.003, le=0.05)] = 0.01
    turned_deg: Annotated[Number, Field(ge=0.0, le=60.0)] = 0.0

    def __post_init__(self) -> None:
        if self.direction is not None and math.hypot(*self.direction) < 1e-6:
            raise PydanticCustomError("handle", "direction has no length; expected a vector such as [0, -1, 0]")


@dataclass(config=SECTION)
class DoorRequest(TaskSection):
    """Task of opening a door detected in the scan (near ``hint``) or given by ``leaf`` and ``handle``.

    Attributes:
        hand: hand to use; ``auto`` tries both.
        open_deg: angle of the leaf at the end.
        opens: ``push`` away from the robot, ``pull`` towards it; ``auto`` as the scan shows it.
        hinge: side of the hinges as seen by the robot; ``auto`` as the scan shows it.
        hint: a point near the leaf or its handle [m].
        leaf, handle: the door itself; detected where they are left out.
        release_deg: angle of the lever from which on the leaf is free.
        press_m: travel of a push bar at which the leaf is free.
        lever_nm: torque that turns the lever.
        hinge_nm: torque that opens the leaf against its closer or the wind.
        push_bar_n: force that presses a push bar.
        stays: whether the hand stays on the leaf at the end (against a door closer).
        moved_m: displacement of the detected door in world axes, by which a person corrected it [m].
    """

    hand: Literal["left", "right", "auto"] = "auto"
    open_deg: Annotated[Number, Field(gt=0.0, le=150.0)] = 60.0
    opens: Literal["push", "pull", "auto"] = "auto"
    hint: Point | None = None
    leaf: LeafRequest | None = None
    handle: HandleRequest | None = None
    release_deg: Annotated[Number, Field(ge=5.0, le=55.0)] = 25.0
    press_m: Annotated[Number, Field(ge=0.005, le=0.05)] = 0.02
    lever_nm: Annotated[Number, Field(ge=0.0, le=20.0)] = 2.0
    hinge_nm: Annotated[Number, Field(ge=0.0, le=200.0)] = 30.0
    push_bar_n: Annotated[Number, Field(ge=0.0, le=300.0)] = 67.0
    stays: bool = False
    hinge: Literal["left", "right", "auto"] = "auto"
    moved_m: Point | None = None

    def __post_init__(self) -> None:
        check_moved(self.moved_m, "" if self.leaf is None else "leaf")
        if self.handle is not None and self.leaf is None:
            raise PydanticCustomError("door", "handle is given without leaf; a handle belongs to a leaf that is given")
        if self.leaf is not None and self.hinge != "auto":
            raise PydanticCustomError(
                "door", "hinge is for a door that a scan shows; leaf.hinge is that of a given leaf"
            )
        if self.leaf is not None and self.opens == "auto":
            raise PydanticCustomError("door", "opens is needed with a leaf that is given; expected push or pull")

    @property
    def moved_names(self) -> MovedNames:
        """Leaf and handle."""
        return MovedNames(DOOR, (LEAF_JOINT, HANDLE_JOINT))

    @property
    def detected(self) -> tuple[str, ...]:
        """Doors, or those with the hinge on the stated side."""
        return (DOOR if self.hinge == "auto" else f"door_{self.hinge}",)

    @property
    def moved_by(self) -> Point | None:
        """Displacement by which a person corrected where the scan shows it [m]."""
        return self.moved_m

    @property
    def near(self) -> Point | None:
        """A point near the door."""
        return self.hint

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the positions of leaf and handle."""
        yield "hint", self.hint
        if self.leaf is not None:
            yield from (("leaf.hinge", self.leaf.hinge), ("leaf.edge", self.leaf.edge))
        if self.handle is not None:
            yield "handle.centre", self.handle.centre
