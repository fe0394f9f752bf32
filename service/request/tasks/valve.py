"""Section of a request that turns a valve."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Number, Point, at_most
from service.request.tasks.kind import MovedNames, TaskSection, check_moved
from service.request.tasks.lever import LeverRequest, check_lever

VALVE_JOINT, VALVE_LINK = "valve_turn", "valve"
LEAST_STUCK_TURN_DEG = 10.0


@dataclass(config=SECTION)
class ValveRequest(TaskSection):
    """Task of turning a valve detected in the scan (near ``hint``) or given by ``centre``, ``axis`` and ``radius``.

    A valve with a lever, or with a crank, is given by ``centre``, ``axis`` and ``lever``.

    Attributes:
        mode: ``hook`` rests a hook between the spokes, ``grasp`` turns the hand with the wheel.
        hand: hand to use; ``auto`` tries both.
        turn_deg: angle, positive counter-clockwise as seen by the robot; beyond a turn with a new hold.
        sense: whether the wheel turns in the sense of ``turn_deg``; if ``unknown`` it is only tried, a little each way.
        stuck: whether it may be stuck: it is first rocked a little, for which the robot is held with twice the torque.
        centre, axis, radius: the rim's centre-line circle, axis towards the robot [m].
        spokes_deg, spoke_width_m: angles of the spokes of a given valve, counter-clockwise as seen by the robot, from
            the rim's rightmost point; and their width.
        torque_nm: torque that turns the wheel; the robot is held with it and without it.
        lever: bar of a lever valve or of a crank, whose spindle is at ``centre`` along ``axis``.
        stops_deg: least and largest angle of a lever from where it is, counted like ``turn_deg``; by default a lever
            stops after a quarter turn, and a crank turns freely.
        moved_m: displacement of the detected valve in world axes, by which a person corrected it [m].
    """

    mode: Literal["hook", "grasp"] = "hook"
    hand: Literal["left", "right", "auto"] = "auto"
    turn_deg: Annotated[Number, Field(ge=-1440.0, le=1440.0)] = 360.0
    hint: Point | None = None
    centre: Point | None = None
    axis: Point | None = None
    radius: Annotated[Number, Field(gt=0.0, le=2.0)] | None = None
    torque_nm: Annotated[Number, Field(ge=0.0, le=200.0)] = 10.0
    spokes_deg: Annotated[tuple[Number, ...], at_most(8)] = ()
    spoke_width_m: Annotated[Number, Field(gt=0.0, le=0.1)] = 0.02
    sense: Literal["given", "unknown"] = "given"
    stuck: bool = False
    lever: LeverRequest | None = None
    stops_deg: tuple[Number, Number] | None = None
    moved_m: Point | None = None

    def __post_init__(self) -> None:
        check_moved(self.moved_m, "" if self.centre is None else "centre")
        check_lever(self.lever, self.stops_deg, self.turn_deg, self.radius, self.axis)
        if self.turn_deg == 0.0:
            raise PydanticCustomError("valve", "turn_deg is 0: nothing to do; expected -1440 to 1440 except 0")
        if self.stuck and abs(self.turn_deg) < LEAST_STUCK_TURN_DEG:
            raise PydanticCustomError("valve", "a stuck wheel is turned by 10 deg or more; turn_deg is smaller")
        if self.spokes_deg and self.centre is None:
            raise PydanticCustomError("valve", "spokes_deg belong to a valve given by centre, axis and radius")
        if self.axis is not None and math.hypot(*self.axis) < 1e-6:
            raise PydanticCustomError("valve", "axis has no length; expected a direction such as [-1, 0, 0]")

    @property
    def moved_names(self) -> MovedNames:
        """The wheel, or the lever."""
        return MovedNames(VALVE_LINK, (VALVE_JOINT,))

    @property
    def detected(self) -> tuple[str, ...]:
        """Wheels and levers."""
        return ("turnable",)

    @property
    def moved_by(self) -> Point | None:
        """Displacement by which a person corrected where the scan shows it [m]."""
        return self.moved_m

    @property
    def near(self) -> Point | None:
        """A point near the valve."""
        return self.hint

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the valve's positions."""
        yield from (("hint", self.hint), ("centre", self.centre))
