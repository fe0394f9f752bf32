"""Section of a request that gives the lever or the crank of a valve."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Number, Point, Section

QUARTER_DEG = 90.0  # by which a lever turns between its stops
MOST_SLANT = 0.98  # cosine between axis and lever


@dataclass(config=SECTION)
class LeverRequest(Section):
    """The bar that turns a valve, and the grip of a crank at its end.

    Attributes:
        direction: from the spindle along the bar; made perpendicular to the valve's axis.
        length_m: from the spindle to the bar's end, of a crank to the grip's axis.
        radius_m: half the bar's thickness.
        grip_m: length of a crank's grip along the axis, from the bar to its end; 0 for a lever.
    """

    direction: Point
    length_m: Annotated[Number, Field(ge=0.05, le=1.0)]
    radius_m: Annotated[Number, Field(ge=0.003, le=0.05)] = 0.013
    grip_m: Annotated[Number, Field(ge=0.0, le=0.3)] = 0.0

    def __post_init__(self) -> None:
        if math.hypot(*self.direction) < 1e-6:
            raise PydanticCustomError("lever", "direction has no length; expected a direction such as [0, 0, 1]")
        if self.length_m < 2.0 * self.radius_m:
            raise PydanticCustomError(
                "lever",
                "length_m: {length} m, less than the bar's thickness of {thick} m (2 radius_m); expected a bar",
                {"length": f"{self.length_m:g}", "thick": f"{2.0 * self.radius_m:g}"},
            )
        if 0.0 < self.grip_m < 0.04:
            raise PydanticCustomError("lever", "grip_m is less than 0.04 m; expected 0 for a lever, or a crank's grip")


def check_lever(
    lever: LeverRequest | None,
    stops_deg: tuple[float, float] | None,
    turn_deg: float,
    radius: float | None,
    axis: tuple[float, float, float] | None,
) -> None:
    """Refuse a lever that contradicts the other fields of its valve.

    Raises:
        PydanticCustomError: one line that names the field.
    """
    if stops_deg is not None:
        low, high = stops_deg
        if not low <= 0.0 <= high or not low <= turn_deg <= high:
            raise PydanticCustomError(
                "valve", f"stops_deg: [{low:g}, {high:g}]; expected angles that contain 0 and turn_deg ({turn_deg:g})"
            )
    if lever is None:
        return
    if radius is not None:
        raise PydanticCustomError(
            "valve", "radius and lever exclude each other; expected the rim of a wheel or a lever"
        )
    if axis is not None and math.hypot(*axis) > 1e-6:
        slant = abs(sum(a * b for a, b in zip(axis, lever.direction, strict=True)))
        if slant > MOST_SLANT * math.hypot(*axis) * math.hypot(*lever.direction):
            raise PydanticCustomError("valve", "lever.direction is along axis; expected it across")
    if lever.grip_m == 0.0 and stops_deg is None and abs(turn_deg) > QUARTER_DEG:
        raise PydanticCustomError(
            "valve",
            f"turn_deg: {turn_deg:g}; a lever stops after a quarter turn: expected -90 to 90, stops_deg, or a "
            "lever.grip_m",
        )
