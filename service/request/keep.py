"""What a request keeps along a motion: poses and regions of links."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.fields import SECTION, Name, Number, Point, Quaternion, Section
from service.request.region import LinkAxis, RegionRequest, check_look, find_gap

LEAST_SHARE = 0.01  # of the path, in which a pose is kept


@dataclass(config=SECTION)
class KeepRequest(Section):
    """A link keeps its pose, or keeps to a region, relative to another link along the motion (two hands on a beam).

    Attributes:
        link: a link or frame of the robot.
        relative_to: another link or frame; by default the world.
        position, quaternion_wxyz: pose of ``link`` in ``relative_to``; a missing part is taken from the start.
        position_tolerance_m: largest distance of the link's origin from its position; a region with bounds of the
            position replaces it.
        rotation_tolerance_deg: largest angle from the orientation, of the free axis from its direction, or of the
            looking axis from its place; a region with angles about axes replaces it.
        free_axis: axis of ``link`` about which it may rotate.
        region: limits along and about the axes of the pose.
        look_at: place in the reference to which ``look_axis`` points.
        look_axis: axis of the link.
        after, until: shares of the motion's path between which the pose is kept.
    """

    link: Name
    relative_to: Name | None = None
    position: Point | None = None
    quaternion_wxyz: Quaternion | None = None
    position_tolerance_m: Annotated[Number, Field(ge=5e-4, le=1.0)] = 0.005
    rotation_tolerance_deg: Annotated[Number, Field(ge=0.05, le=180.0)] = 1.0
    free_axis: Literal["none", "x", "y", "z"] = "none"
    region: RegionRequest | None = None
    look_at: Point | None = None
    look_axis: LinkAxis = "x"
    after: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.0
    until: Annotated[Number, Field(ge=0.0, le=1.0)] = 1.0

    def __post_init__(self) -> None:
        if self.link == self.relative_to:
            words = "link and relative_to are both {link}; two links are needed"
            raise PydanticCustomError("keep", words, {"link": shown(self.link)})
        check_look(self)
        if self.until - self.after < LEAST_SHARE:
            words = "after {after} and until {until} leave no part of the motion; expected until to be larger"
            raise PydanticCustomError("keep", words, {"after": f"{self.after:g}", "until": f"{self.until:g}"})

    @property
    def is_plain(self) -> bool:
        """Whether it is one pose along the whole motion with a distance and an angle for tolerances."""
        return self.region is None and self.look_at is None and self.after <= 0.0 and self.until >= 1.0


def refuse_contradictions(keep: Sequence[KeepRequest]) -> None:
    """Refuse two regions of one frame of a link that hold at the same time and have no place in common."""
    for (k, one), (m, other) in combinations(enumerate(keep), 2):
        frames = {(own.link, own.relative_to, own.position, own.quaternion_wxyz) for own in (one, other)}
        if len(frames) > 1 or one.region is None or other.region is None:
            continue
        gap = find_gap(one.region, other.region)
        if gap is not None and max(one.after, other.after) < min(one.until, other.until):
            axis, low, high = gap
            raise PydanticCustomError(
                "keep",
                "keep[{k}].region and keep[{m}].region leave no place for {link}: {axis} of at least {low} and at most "
                "{high} m; expected regions that overlap, or after and until that keep them apart",
                {"k": k, "m": m, "link": shown(one.link), "axis": axis, "low": f"{low:g}", "high": f"{high:g}"},
            )
