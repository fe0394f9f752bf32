"""Steps of hands: motions, turns about an axis, paths on faces, touches and presses."""

from __future__ import annotations

import math
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
    Section,
    at_most,
    find_repeated,
    require_exactly_one,
)
from service.request.region import LinkAxis
from service.request.tasks.reach import PoseGoalRequest

MAX_CORNERS = 200
LONGEST_M = 3.0  # of a single step of a hand
HandChoice = Literal["left", "right", "both"]
FreeAxis = Literal["none", "x", "y", "z", "all"]
Along = Literal["free", "line", "arc", "joint_linear", "joint_cubic", "joint_quintic"]
OtherHand = Literal["keep", "lock", "free"]
Axes = Literal["world", "hand"]
Degrees = Annotated[Number, Field(ge=-1080.0, le=1080.0)]
Speed = Annotated[Number, Field(gt=0.0, le=3.0)]
Seconds = Annotated[Number, Field(gt=0.0, le=600.0)]
Shift = Annotated[Number, Field(ge=-LONGEST_M, le=LONGEST_M)]
ToleranceM = Annotated[Number, Field(ge=2e-4, le=0.1)]
ToleranceDeg = Annotated[Number, Field(ge=0.05, le=30.0)]
BlendM = Annotated[Number, Field(ge=0.0, le=0.2)]
Force = Annotated[Number, Field(gt=0.0, le=1000.0)]


def _check_direction(name: str, vector: Point) -> None:
    if math.hypot(*vector) < 1e-6:
        words = "{name} has no length; expected a direction such as [0, 0, 1]"
        raise PydanticCustomError("direction", words, {"name": name})


def _check_pace(speed: float | None, duration: float | None) -> None:
    if speed is not None and duration is not None:
        raise PydanticCustomError("pace", "speed_m_s and duration_s are both given; expected one of them")


def _check_hand(hand: str | None, frame: str | None) -> None:
    if hand is not None and frame is not None:
        raise PydanticCustomError("hand", "hand and frame are both given; expected one of them")


@dataclass(config=SECTION)
class ShiftRequest(Section):
    """A motion relative to where a frame is.

    Attributes:
        translation: [m].
        rotation_deg: about x, then y, then z of the fixed axes [deg].
        axes: of the world, or of the frame as it is at the beginning of the step.
    """

    translation: tuple[Shift, Shift, Shift] = (0.0, 0.0, 0.0)
    rotation_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    axes: Axes = "world"

    def __post_init__(self) -> None:
        if not any((*self.translation, *self.rotation_deg)):
            raise PydanticCustomError("shift", "neither translates nor rotates; expected one of them")


@dataclass(config=SECTION)
class ArcRequest(Section):
    """An arc about an axis in the world.

    Attributes:
        centre: a point of the axis [m].
        axis: its direction.
        angle_deg: positive by the right hand [deg].
        turns: whether the frame turns along; otherwise it keeps its orientation.
    """

    centre: Point
    axis: Point
    angle_deg: Degrees
    turns: bool = True

    def __post_init__(self) -> None:
        _check_direction("axis", self.axis)
        if not self.angle_deg:
            raise PydanticCustomError("arc", "angle_deg is 0; expected the angle of the arc")


@dataclass(config=SECTION)
class MoveStep(Section):
    """A motion to joint positions, a posture or poses, or by a shift or an arc from where a hand is.

    Attributes:
        joints: positions at the end [rad, m].
        posture: of the robot at the end.
        poses: of links at the end.
        by: shift of the hand or frame.
        arc: of the hand or frame, with ``along: arc``.
        hand: hand that moves; both move by the same shift.
        frame: frame of the robot that moves, instead of a hand's.
        along: ``free`` around obstacles; ``line`` or ``arc`` of the frame; a straight line of configurations, timed by
            the robot's limits (``joint_linear``) or by the polynomial of degree 3 or 5 that rests at both ends.
        free_axis: axis of the frame about which it may turn on its way; ``all`` for any orientation.
        other_hand: whether the hand that does not move keeps its pose, or the joints of its arm are locked.
        speed_m_s: of the frame on its way, but for ramps at both ends.
        duration_s: of the step.
        tolerance_m, rotation_tolerance_deg: largest error along the whole way.
        blend_m: from the corner with the next step's line, where the frame leaves this one on an arc and does not
            rest; 0 to rest in the corner [m].
    """

    joints: Joints = field(default_factory=dict)
    posture: Label | None = None
    poses: Annotated[tuple[PoseGoalRequest, ...], at_most(20)] = ()
    by: ShiftRequest | None = None
    arc: ArcRequest | None = None
    hand: HandChoice | None = None
    frame: Name | None = None
    along: Along = "free"
    free_axis: FreeAxis = "none"
    other_hand: OtherHand = "keep"
    speed_m_s: Speed | None = None
    duration_s: Seconds | None = None
    tolerance_m: ToleranceM = 1e-3
    rotation_tolerance_deg: ToleranceDeg = 0.5
    blend_m: BlendM = 0.0

    def __post_init__(self) -> None:
        require_exactly_one(self, ("joints", "posture", "poses", "by", "arc"))
        _check_hand(self.hand, self.frame)
        _check_pace(self.speed_m_s, self.duration_s)
        if (self.arc is not None) != (self.along == "arc"):
            raise PydanticCustomError("move", "an arc goes with along: arc, and along: arc needs an arc")
        if (self.by is not None or self.arc is not None) and self.hand is None and self.frame is None:
            raise PydanticCustomError("move", "expected the hand (left, right, both) or the frame that moves")
        if self.along == "line" and self.by is None and not self.poses:
            raise PydanticCustomError("move", "along: line needs poses or a shift (by)")
        if self.along.startswith("joint") and not (self.joints or self.posture):
            raise PydanticCustomError("move", "along: {along} needs joints or a posture", {"along": self.along})
        if self.speed_m_s is not None and self.along not in ("line", "arc"):
            raise PydanticCustomError("move", "speed_m_s goes with along: line or arc; expected a duration_s")
        if self.along != "free" and not all(pose.is_plain for pose in self.poses):
            raise PydanticCustomError("move", "region, relative_to and look_at go with along: free, not {along}")
        if self.blend_m and (self.along != "line" or self.duration_s is not None):
            raise PydanticCustomError("move", "blend_m goes with along: line and without duration_s")
        twice = find_repeated(pose.link for pose in self.poses)
        if twice:
            raise PydanticCustomError("move", "link {link} has two poses; expected one", {"link": shown(twice[0])})


@dataclass(config=SECTION)
class ScrewStep(Section):
    """A turn about an axis and a shift along it, in equal shares: turn, plunge, retract, circle, lever.

    Attributes:
        axis: direction.
        centre: a point of the axis; by default the frame's origin [m].
        axes: whether ``axis`` (not ``centre``) is in the world's axes or the frame's.
        translation_m: along the axis [m].
        rotation_deg: about it [deg].
        rate_deg_s: at which it turns, but for ramps at both ends where the frame's origin moves [deg/s].
        hand, frame, free_axis, other_hand, speed_m_s, duration_s, tolerance_m, rotation_tolerance_deg: as in ``move``.
    """

    axis: Point = (0.0, 0.0, 1.0)
    centre: Point | None = None
    axes: Axes = "world"
    translation_m: Shift = 0.0
    rotation_deg: Degrees = 0.0
    rate_deg_s: Annotated[Number, Field(gt=0.0, le=360.0)] | None = None
    hand: HandChoice | None = None
    frame: Name | None = None
    free_axis: FreeAxis = "none"
    other_hand: OtherHand = "keep"
    speed_m_s: Speed | None = None
    duration_s: Seconds | None = None
    tolerance_m: ToleranceM = 1e-3
    rotation_tolerance_deg: ToleranceDeg = 0.5

    def __post_init__(self) -> None:
        _check_direction("axis", self.axis)
        _check_hand(self.hand, self.frame)
        _check_pace(self.speed_m_s, self.duration_s)
        if self.hand is None and self.frame is None:
            raise PydanticCustomError("screw", "expected the hand (left, right, both) or the frame that moves")
        if not self.translation_m and not self.rotation_deg:
            raise PydanticCustomError("screw", "neither translates nor rotates; expected one of them")
        if self.rate_deg_s is not None and not self.rotation_deg:
            raise PydanticCustomError(
                "pace", "rate_deg_s is given, and rotation_deg is 0; expected speed_m_s or a turn"
            )
        if self.rate_deg_s is not None and (self.speed_m_s is not None or self.duration_s is not None):
            words = "rate_deg_s is given beside speed_m_s or duration_s; expected one of them"
            raise PydanticCustomError("pace", words)


@dataclass(config=SECTION)
class FaceRequest(Section):
    """A plane face.

    Attributes:
        point: of the face [m].
        normal: outward direction, of any length.
        pieces: of the scene behind the face, which the link that carries the tool may touch.
    """

    point: Point
    normal: Point
    pieces: Annotated[tuple[Name, ...], at_most(64)] = ()

    def __post_init__(self) -> None:
        _check_direction("normal", self.normal)


@dataclass(config=SECTION)
class CircleRequest(Section):
    """A circle on a face, or part of it.

    Attributes:
        centre: moved along the normal onto the face [m].
        radius_m: [m].
        angle_deg: of the part that is followed [deg].
        begin_deg: where it begins, from straight above the centre (of a level face: from the world's x axis), clockwise
            as seen by somebody who faces it [deg].
        sense: as seen by somebody who faces it.
    """

    centre: Point
    radius_m: Annotated[Number, Field(ge=0.005, le=2.0)]
    angle_deg: Annotated[Number, Field(gt=0.0, le=1080.0)] = 360.0
    begin_deg: Degrees = 0.0
    sense: Literal["clockwise", "counter_clockwise"] = "clockwise"


@dataclass(config=SECTION)
class FollowStep(Section):
    """A path on a plane face: the tool comes on a line, follows the path, and leaves on a line.

    Attributes:
        face: the face.
        tool_axis: axis of the tool that points into the face.
        circle: the path, or
        polyline: its corners, moved along the normal onto the face; the tool rests at each that is not rounded [m].
        hand, frame: the tool.
        depth_m: of the tool's origin behind the face; negative in front of it [m].
        tilt_deg: by which the tool's axis leans off the inward normal, towards ``tilt_towards``.
        tilt_towards: direction in the world.
        turn: ``free`` about the tool's axis, or ``keep`` the turn with which it begins.
        approach_m: length of the lines that lead to the face and off it [m].
        speed_m_s: feed on the path.
        thrust_n: largest force with which the tool may be pushed back along its axis [N].
        across_n: largest force on it across its axis besides, in any direction, as of a drill against its feed [N].
        twist_nm: largest moment on it about its axis besides, in either sense [N m].
        touch_depth_m: by which the link of the tool may be inside the face's pieces, beyond ``depth_m``.
        other_hand, tolerance_m, rotation_tolerance_deg: as in ``move``.
        blend_m: from a corner, where the tool leaves the path on an arc, to go on without a rest; 0 to rest there [m].
    """

    face: FaceRequest
    circle: CircleRequest | None = None
    polyline: Annotated[tuple[Point, ...], at_most(MAX_CORNERS)] = ()
    hand: Literal["left", "right"] | None = None
    frame: Name | None = None
    depth_m: Annotated[Number, Field(ge=-0.5, le=0.5)] = 0.0
    tilt_deg: Annotated[Number, Field(ge=0.0, le=60.0)] = 0.0
    tilt_towards: Point = (0.0, 0.0, 1.0)
    turn: Literal["free", "keep"] = "free"
    approach_m: Annotated[Number, Field(ge=0.005, le=0.5)] = 0.05
    speed_m_s: Speed = 0.04
    thrust_n: Annotated[Number, Field(ge=0.0, le=1000.0)] = 0.0
    touch_depth_m: Annotated[Number, Field(ge=0.0, le=0.05)] = 0.005
    other_hand: OtherHand = "keep"
    tolerance_m: ToleranceM = 1e-3
    rotation_tolerance_deg: ToleranceDeg = 2.0
    blend_m: BlendM = 0.0
    tool_axis: LinkAxis = "z"
    across_n: Annotated[Number, Field(ge=0.0, le=1000.0)] = 0.0
    twist_nm: Annotated[Number, Field(ge=0.0, le=200.0)] = 0.0

    def __post_init__(self) -> None:
        require_exactly_one(self, ("circle", "polyline"))
        if (self.across_n or self.twist_nm) and not self.thrust_n:
            raise PydanticCustomError("follow", "across_n and twist_nm come with a thrust_n, which is 0")
        _check_hand(self.hand, self.frame)
        _check_direction("tilt_towards", self.tilt_towards)
        if self.hand is None and self.frame is None:
            raise PydanticCustomError("follow", "expected the hand (left or right) or the frame of the tool")
        if len(self.polyline) == 1:
            raise PydanticCustomError("follow", "polyline has one corner; expected at least two")
        if self.blend_m and self.circle is not None:
            raise PydanticCustomError("follow", "blend_m rounds the corners of a polyline; a circle has none")


@dataclass(config=SECTION)
class TouchStep(Section):
    """A guarded move: on a line until a force is felt, wherever within a window of the way.

    Attributes:
        direction: of the motion.
        axes: of the world or of the frame.
        window_m: least and largest way at which the force comes [m].
        force_n: at which the motion stops [N].
        face: what is touched; it may be touched anywhere within the window.
        hand, frame, free_axis, other_hand, speed_m_s, tolerance_m, rotation_tolerance_deg: as in ``move``.
    """

    direction: Point
    window_m: tuple[Annotated[Number, Field(ge=0.0, le=1.0)], Annotated[Number, Field(gt=0.0, le=1.0)]]
    force_n: Force
    axes: Axes = "world"
    pieces: Annotated[tuple[Name, ...], at_most(64)] = ()
    hand: Literal["left", "right"] | None = None
    frame: Name | None = None
    free_axis: FreeAxis = "none"
    other_hand: OtherHand = "keep"
    speed_m_s: Speed = 0.02
    tolerance_m: ToleranceM = 1e-3
    rotation_tolerance_deg: ToleranceDeg = 0.5

    def __post_init__(self) -> None:
        _check_direction("direction", self.direction)
        _check_hand(self.hand, self.frame)
        if self.hand is None and self.frame is None:
            raise PydanticCustomError("touch", "expected the hand (left or right) or the frame that touches")
        if self.window_m[0] >= self.window_m[1]:
            raise PydanticCustomError("touch", "window_m ends before it begins; expected [least, largest]")


@dataclass(config=SECTION)
class PressStep(Section):
    """A push by a hand's tip on a part that gives way: a button, a switch.

    Attributes:
        at: middle of its front [m].
        normal: of its front, outwards.
        force_n: that moves it [N].
        travel_m: by which it is pushed in [m].
        size_m: edge of its square front [m].
        height_m: of its front before what is around it; by default 5 mm more than the travel [m].
        hand: that presses; ``auto`` tries both.
    """

    at: Point
    normal: Point
    force_n: Force
    travel_m: Annotated[Number, Field(ge=5e-4, le=0.2)] = 0.005
    size_m: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.03
    height_m: Annotated[Number, Field(ge=1e-3, le=0.3)] | None = None
    hand: Literal["left", "right", "auto"] = "auto"

    def __post_init__(self) -> None:
        _check_direction("normal", self.normal)
        if self.height_m is not None and self.height_m <= self.travel_m:
            raise PydanticCustomError("press", "height_m is not above travel_m; the part would be pushed into its wall")
