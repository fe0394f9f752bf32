"""Section of a request for a reach: joint positions, poses of links or a posture at the end of the motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.fields import (
    SECTION,
    Joints,
    Label,
    Name,
    Number,
    Point,
    Quaternion,
    Section,
    at_most,
    find_repeated,
    require_exactly_one,
)
from service.request.tasks.kind import TaskSection


@dataclass(config=SECTION)
class PoseGoalRequest(Section):
    """A pose of ``link`` (a link or frame of the robot) at the end; without a quaternion the orientation is free."""

    link: Name
    position: Point
    quaternion_wxyz: Quaternion | None = None
    position_tolerance_m: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.001
    rotation_tolerance_deg: Annotated[Number, Field(ge=0.0, le=180.0)] = 0.5
    free_axis: Literal["none", "x", "y", "z"] = "none"

    def __post_init__(self) -> None:
        if self.free_axis != "none" and self.quaternion_wxyz is None:
            raise PydanticCustomError("pose", "free_axis needs a quaternion_wxyz whose axis it frees")


@dataclass(config=SECTION)
class GoalRequest(TaskSection):
    """End of the motion: joint positions, poses of links, or a named posture."""

    joints: Joints = field(default_factory=dict)
    poses: Annotated[tuple[PoseGoalRequest, ...], at_most(20)] = ()
    posture: Label | None = None

    def __post_init__(self) -> None:
        require_exactly_one(self, ("joints", "poses", "posture"))
        twice = find_repeated(pose.link for pose in self.poses)
        if twice:
            words = "link {link} has two poses; expected one for each link"
            raise PydanticCustomError("goal", words, {"link": shown(twice[0])})

    @property
    def takes_trajectories(self) -> bool:
        """Yes: a reach has a single phase."""
        return True

    @property
    def variant(self) -> str:
        """What the goal is given by."""
        return "joint_goal" if self.joints else "pose_goal" if self.poses else "posture"

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the positions of the poses."""
        for k, pose in enumerate(self.poses):
            yield f"poses[{k}].position", pose.position
