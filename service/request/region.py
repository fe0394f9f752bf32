"""Region of a link's pose: bounds along axes, a radius about one, angles about axes; an axis that looks at a place."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Protocol

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, Coordinate, Number, Section

LEAST_WIDTH_M = 2e-4  # between two bounds along an axis
Radius = Annotated[Number, Field(ge=1e-4, le=100.0)]
Turn = Annotated[Number, Field(ge=0.01, le=180.0)]
LinkAxis = Literal["x", "y", "z", "-x", "-y", "-z"]


@dataclass(config=SECTION)
class RegionRequest(Section):
    """Limits of a link's origin and orientation, each by itself; what is left out is free.

    The region's origin and axes are the ``position`` and ``quaternion_wxyz`` of the pose it belongs to.

    Attributes:
        x_min_m, x_max_m, y_min_m, y_max_m, z_min_m, z_max_m: bounds of the link's origin along the region's axes: two
            of them are a slab, one is a half-space.
        radius_m: largest distance of the link's origin from the region's z axis (a cylinder).
        about_x_deg, about_y_deg, about_z_deg: largest component of the rotation from the wanted orientation, as a
            rotation vector in the region's axes.
    """

    x_min_m: Coordinate | None = None
    x_max_m: Coordinate | None = None
    y_min_m: Coordinate | None = None
    y_max_m: Coordinate | None = None
    z_min_m: Coordinate | None = None
    z_max_m: Coordinate | None = None
    radius_m: Radius | None = None
    about_x_deg: Turn | None = None
    about_y_deg: Turn | None = None
    about_z_deg: Turn | None = None

    def __post_init__(self) -> None:
        if not any(self.limits_position) and not self.limits_rotation:
            raise PydanticCustomError(
                "region", "the region limits nothing; expected bounds such as z_min_m, radius_m or about_x_deg"
            )
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if low is not None and high is not None and high - low < LEAST_WIDTH_M:
                raise PydanticCustomError(
                    "region",
                    "{axis}_min_m {low} to {axis}_max_m {high} is empty or thinner than 0.2 mm; expected a larger "
                    "{axis}_max_m",
                    {"axis": axis, "low": f"{low:g}", "high": f"{high:g}"},
                )

    @property
    def lower(self) -> tuple[float | None, float | None, float | None]:
        """Least offset along each axis [m]."""
        return self.x_min_m, self.y_min_m, self.z_min_m

    @property
    def upper(self) -> tuple[float | None, float | None, float | None]:
        """Largest offset along each axis [m]."""
        return self.x_max_m, self.y_max_m, self.z_max_m

    @property
    def turns_deg(self) -> tuple[float | None, float | None, float | None]:
        """Largest component of the rotation vector along each axis [deg]."""
        return self.about_x_deg, self.about_y_deg, self.about_z_deg

    @property
    def limits_position(self) -> tuple[bool, ...]:
        """Whether each limit of the position is given."""
        return tuple(limit is not None for limit in (*self.lower, *self.upper, self.radius_m))

    @property
    def limits_rotation(self) -> bool:
        """Whether it limits the orientation."""
        return any(turn is not None for turn in self.turns_deg)


def find_gap(one: RegionRequest, other: RegionRequest) -> tuple[str, float, float] | None:
    """Return an axis along which two regions of one frame have no place in common, with its bounds; None without one.

    Returns:
        The axis, the larger of the least places, and the smaller of the largest ones [m].
    """
    for axis, lows, highs in zip(
        "xyz", zip(one.lower, other.lower, strict=True), zip(one.upper, other.upper, strict=True), strict=True
    ):
        low = max((value for value in lows if value is not None), default=-math.inf)
        high = min((value for value in highs if value is not None), default=math.inf)
        if low > high:
            return axis, low, high
    return None


class _Looking(Protocol):
    """A request of a pose that may look at a place."""

    @property
    def quaternion_wxyz(self) -> object: ...
    @property
    def free_axis(self) -> str: ...
    @property
    def region(self) -> RegionRequest | None: ...
    @property
    def look_at(self) -> object: ...
    @property
    def look_axis(self) -> str: ...


def check_look(pose: _Looking) -> None:
    """Refuse a pose that looks at a place and has an orientation as well."""
    if pose.look_at is None:
        return
    if pose.free_axis != "none" or (pose.region is not None and pose.region.limits_rotation):
        words = "look_at turns the link by itself; leave out free_axis and the region's angles"
        raise PydanticCustomError("pose", words)
