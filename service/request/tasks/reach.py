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
from service.request.region import LinkAxis, RegionRequest, check_look
from service.request.tasks.kind import TaskSection


@dataclass(config=SECTION)
class PoseGoalRequest(Section):
    """A pose of ``link`` (a link or frame of the robot) at the end, or a region of poses.

    Attributes:
        link: a link or frame of the robot.
        position: target in the reference; with a region its origin, by default the reference's.
        quaternion_wxyz: orientation in the reference; without one the orientation is free.
        position_tolerance_m: largest distance from the position; a region with bounds of the position replaces it.
        rotation_tolerance_deg: largest angle from the orientation, of the free axis from its direction, or of the
            looking axis from its place; a region with angles about axes replaces it.
        free_axis: axis of the link about which it may turn.
        relative_to: link or frame that the pose is given in; the world by default.
        region: limits along and about the axes of the pose.
        look_at: place in the reference to which ``look_axis`` points.
        look_axis: axis of the link.
    """

    link: Name
    position: Point | None = None
    quaternion_wxyz: Quaternion | None = None
    position_tolerance_m: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.001
    rotation_tolerance_deg: Annotated[Number, Field(ge=0.0, le=180.0)] = 0.5
    free_axis: Literal["none", "x", "y", "z"] = "none"
    relative_to: Name | None = None
    region: RegionRequest | None = None
    look_at: Point | None = None
    look_axis: LinkAxis = "x"

    def __post_init__(self) -> None:
        if self.free_axis != "none" and self.quaternion_wxyz is None:
            raise PydanticCustomError("pose", "free_axis needs a quaternion_wxyz whose axis it frees")
        if self.position is None and self.region is None and self.look_at is None:
            raise PydanticCustomError("pose", "position is missing; only a region or look_at does without")
        check_look(self)
        if self.region is not None and self.region.limits_rotation and self.quaternion_wxyz is None:
            raise PydanticCustomError("pose", "angles of the region need a quaternion_wxyz that they are measured from")
        if self.link == self.relative_to:
            words = "link and relative_to are both {link}: a region that moves with its link says nothing"
            raise PydanticCustomError("pose", words, {"link": shown(self.link)})

    @property
    def is_plain(self) -> bool:
        """Whether it is a pose in the world with a distance and an angle for tolerances."""
        return self.relative_to is None and self.region is None and self.look_at is None

    @property
    def origin(self) -> Point:
        """The position, or the origin of the reference where none is given."""
        return (0.0, 0.0, 0.0) if self.position is None else self.position


@dataclass(config=SECTION)
class GoalPartRequest(Section):
    """Joint positions, poses of links, or a named posture: one of several goals, or a place on the way."""

    joints: Joints = field(default_factory=dict)
    poses: Annotated[tuple[PoseGoalRequest, ...], at_most(20)] = ()
    posture: Label | None = None

    def __post_init__(self) -> None:
        require_exactly_one(self, ("joints", "poses", "posture"))
        _check_poses(self.poses)


@dataclass(config=SECTION)
class GoalRequest(TaskSection):
    """End of the motion: joint positions, poses of links, a named posture, or any of several of these.

    Attributes:
        joints, poses, posture: the end; ``any_of`` has several instead, of which the motion ends at one.
        via: places on the way, in their order; the robot does not stop there.
        rates: of joints at the end of the motion, by name [rad/s, m/s]; the others rest there.
    """

    joints: Joints = field(default_factory=dict)
    poses: Annotated[tuple[PoseGoalRequest, ...], at_most(20)] = ()
    posture: Label | None = None
    any_of: Annotated[tuple[GoalPartRequest, ...], at_most(100)] = ()
    via: Annotated[tuple[GoalPartRequest, ...], at_most(8)] = ()
    rates: Joints = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_exactly_one(self, ("joints", "poses", "posture", "any_of"))
        _check_poses(self.poses)

    @property
    def alternatives(self) -> tuple[GoalPartRequest, ...]:
        """The goals of which one is reached; a single one without ``any_of``."""
        return self.any_of or (GoalPartRequest(self.joints, self.poses, self.posture),)

    @property
    def takes_trajectories(self) -> bool:
        """Yes: a reach has a single phase."""
        return True

    @property
    def variant(self) -> str:
        """What the goal is given by."""
        first = self.alternatives[0]
        return "joint_goal" if first.joints else "pose_goal" if first.poses else "posture"

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the positions of the poses in the world."""
        for name, part in self.list_parts():
            for k, pose in enumerate(part.poses):
                if pose.relative_to is None:
                    yield f"{name}poses[{k}].position", pose.position
                    yield f"{name}poses[{k}].look_at", pose.look_at

    def list_parts(self) -> Iterator[tuple[str, GoalPartRequest]]:
        """Yield every part of the goal, with its field in the goal (empty for a single one, else up to a dot)."""
        if not self.any_of:
            yield "", self.alternatives[0]
        for field_name, parts in (("any_of", self.any_of), ("via", self.via)):
            yield from ((f"{field_name}[{k}].", part) for k, part in enumerate(parts))


def _check_poses(poses: tuple[PoseGoalRequest, ...]) -> None:
    """Refuse two poses of one link in one reference."""
    twice = find_repeated(pose.link for pose in poses if pose.relative_to is None)
    if twice:
        words = "link {link} has two poses; expected one for each link"
        raise PydanticCustomError("goal", words, {"link": shown(twice[0])})
