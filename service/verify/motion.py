"""Input of the verifier: a motion with what its phases promise, and the settings of the proofs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.curve import Curve, TimeLaw
from costs.robot.carried import MovableObject
from costs.robot.mechanism import Release
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.request.robot_parts import RobotServoRequest
from service.verify.carrying.carriers import Carrier
from service.verify.regions.region import RegionTarget

FEET_FRICTION = 0.6
FEET_CAP_N = 5000.0  # at each corner of a sole [N]
# From the place of a load to where the hand really presses: the tolerance of its place, its lean and its thickness [m].
HAND_DRIFT_M = 0.02
WORLD = "universe"  # link of a load that the hand puts on the world
HAND_CAP_N = 2000.0  # of a contact of a hand, along its normal [N]


class VerifyError(ValueError):
    """Error for a malformed motion; the message names the field and the value."""


@dataclass(frozen=True)
class VerifySettings:
    """Settings of a verification; none of them can make a false claim pass.

    Attributes:
        max_halvings: halvings of an interval between two knots before it counts as unproven.
        max_sharpenings: halvings of a proven interval to bound the smallest margin more closely.
        max_intervals: largest number of intervals that the search for the smallest clearance examines.
        clearance_horizon_m: clearances are reported up to this distance.
        resolution_m: the smallest clearance is reported to within this.
        contact_tolerance_m: a sampled pose refutes the motion when it penetrates deeper than allowed by this.
        rounding: error of a coordinate as written to the result file [rad, m].
        time_step_s: forces and ZMP are sampled at least this often.
        limit_tolerance: relative excess over a speed or acceleration limit that still counts as within it.
        rest_speed: speed of a joint that still counts as standing still [rad/s, m/s].
    """

    max_halvings: int = 12
    max_sharpenings: int = 4
    max_intervals: int = 60_000
    clearance_horizon_m: float = 0.1
    resolution_m: float = 1e-3
    contact_tolerance_m: float = 1e-6
    rounding: float = 1e-8
    time_step_s: float = 0.01
    limit_tolerance: float = 1e-6
    rest_speed: float = 1e-6


@dataclass(frozen=True)
class PlantedContact:
    """Link that does not move during a phase.

    Attributes:
        link: frame of the robot's model.
        pose_world_link: (4, 4) its pose.
        sole: (C, 3) corners in the link frame [m].
        tolerance_m: greatest drift of a corner anywhere in the phase.
        knot_tolerance_m: greatest drift of a corner at the curve's knots.
        friction: coefficient of its sole on the ground.
        force_cap_n: largest normal force at each corner [N].
        normal: (3,) unit, in the world: direction in which the surroundings push; None for a sole on level ground,
            which pushes along the upward normal of the sole's plane.
        tilt_rad: largest angle between ``normal`` and that of the surface at any of the points.
    """

    link: str
    pose_world_link: Float[np.ndarray, "4 4"]
    sole: Float[np.ndarray, "C 3"]
    tolerance_m: float = 1e-3
    knot_tolerance_m: float = 1e-4
    friction: float = FEET_FRICTION
    force_cap_n: float = FEET_CAP_N
    normal: Float[np.ndarray, "3"] | None = None
    tilt_rad: float = 0.0

    @property
    def points(self) -> Float[np.ndarray, "C 3"]:
        """(C, 3) corners in the world [m]."""
        pose = self.pose_world_link
        return np.asarray(self.sole @ pose[:3, :3].T + pose[:3, 3])


@dataclass(frozen=True)
class SupportPolygon:
    """Region of the centre of mass and the ZMP: the hull of the planted feet, and a margin inside of it.

    Attributes:
        polygon: (E, 2) corners, counter-clockwise, world x and y [m].
        margin_m: the centre of mass stays this far inside; the ZMP must only stay inside.
        height: z of the plane on which the ZMP is taken [m].
    """

    polygon: Float[np.ndarray, "E 2"]
    margin_m: float = 0.0
    height: float = 0.0


@dataclass(frozen=True)
class PoseTarget:
    """A frame reaches a pose: at path parameter ``at``, or during the whole phase when ``at`` is None.

    Attributes:
        frame: frame of the robot's model.
        position: (3,) in the world [m].
        rotation: (3, 3) rotation_world_frame wanted, or None for any.
        position_tolerance_m: (3,) three equal ones are the largest distance from the position; otherwise each is the
            largest offset along its axis of the wanted frame (of the world when ``rotation`` is None), inf if free [m].
        rotation_tolerance: (3,) three times the largest angle of the rotation from the wanted frame to the frame, up to
            pi; inf for any orientation.  A free axis is an :class:`AxisTarget` [rad].
        at: path parameter, or None.
    """

    frame: str
    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"] | None
    position_tolerance_m: Float[np.ndarray, "3"]
    rotation_tolerance: Float[np.ndarray, "3"]
    at: float | None = None


@dataclass(frozen=True)
class CircleTarget:
    """A frame's origin stays on a circle, and its axis parallel to the circle's, during the whole phase.

    Attributes:
        frame: frame of the robot's model.
        centre: (3,) in the world [m].
        axis: (3,) unit normal of the circle's plane, in the world.
        radius: [m].
        tolerance_m: greatest distance of the origin from the circle.
        frame_axis: (3,) unit axis in the frame that is to be parallel to ``axis``, or None.
        axis_tolerance_rad: greatest angle between the two.
    """

    frame: str
    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    tolerance_m: float
    frame_axis: Float[np.ndarray, "3"] | None = None
    axis_tolerance_rad: float = np.inf


@dataclass(frozen=True)
class AxisTarget:
    """A frame's axis is parallel to a direction of the world: during the whole phase, or at path parameter ``at``.

    Attributes:
        frame: frame of the robot's model.
        frame_axis: (3,) unit axis in the frame.
        axis: (3,) unit direction in the world.
        tolerance_rad: greatest angle between the two.
        at: path parameter, or None.
    """

    frame: str
    frame_axis: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    tolerance_rad: float
    at: float | None = None


@dataclass(frozen=True)
class RelativePoseTarget:
    """A frame keeps its pose relative to another frame of the robot, or to the world, during the whole phase.

    Attributes:
        frame: frame of the robot's model.
        reference: the other frame; None for the world.
        position: (3,) of the frame's origin in the reference [m].
        rotation: (3, 3) rotation_reference_frame.
        position_tolerance_m: greatest distance of the origin from its place.
        rotation_tolerance_rad: greatest angle off the rotation, or of the free axis off its direction.
        free_axis: (3,) unit axis in the frame about which it may turn, or None.
        slide: (3,) in the reference: the place is anywhere on ``position`` +- ``slide``, or None [m].
    """

    frame: str
    reference: str | None
    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    position_tolerance_m: float
    rotation_tolerance_rad: float
    free_axis: Float[np.ndarray, "3"] | None = None
    slide: Float[np.ndarray, "3"] | None = None


@dataclass(frozen=True)
class HoleTarget:
    """An object goes into a hole without jamming, during the whole phase.

    Attributes:
        frame: the object.
        position: (3,) a point of the hole's axis, in the world [m].
        axis: (3,) unit, into the hole, in the world.
        frame_axis: (3,) unit axis of the object that goes along it.
        depth_m: by which the object goes in, at most.
        radius_m: half the hole's width.
        length_m: of the object along its axis: the hand is no farther than that from its end.
        play_m: width of the hole less that of the object.
        friction: largest coefficient between them.
        force_n: largest force along the hole [N].
        stiffness_n_m, turn_stiffness_n_m_rad: of the hand, across the hole and against a turn.
    """

    frame: str
    position: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    frame_axis: Float[np.ndarray, "3"]
    depth_m: float
    radius_m: float
    length_m: float
    play_m: float
    friction: float
    force_n: float
    stiffness_n_m: float
    turn_stiffness_n_m_rad: float


@dataclass(frozen=True)
class WayTarget:
    """A frame moves along a way from its beginning to its end, during the whole phase.

    The way is a line (``angle`` 0), an arc or a screw about an axis, on which the frame turns in equal shares
    (``costs.guide.Guide``).

    Attributes:
        frame: frame of the robot's model.
        position: (3,) of its origin at the beginning, in the world [m].
        rotation: (3, 3) rotation_world_frame at the beginning.
        centre, axis: (3,) point and unit direction of the axis about which the origin is carried [m].
        angle: by which it is carried about the axis [rad].
        shift: (3,) by which it moves besides, along the axis where ``angle`` is not 0 [m].
        turn: (3,) rotation vector in the world by which the frame turns on the whole way [rad].
        tolerance_m: greatest distance of the origin from the place that belongs to its share of the way.
        rotation_tolerance_rad: greatest angle off the orientation that belongs to it; infinite for any orientation.
        free_axis: (3,) unit axis in the frame about which it may turn, or None.
        speed_m_s: of the origin between the ramps at both ends; None for any.
        speed_share: by which it may be off, relative to it.
        ramp_m: length of the way at each end on which the speed rises and falls.
    """

    frame: str
    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    angle: float
    shift: Float[np.ndarray, "3"]
    turn: Float[np.ndarray, "3"]
    tolerance_m: float
    rotation_tolerance_rad: float
    free_axis: Float[np.ndarray, "3"] | None = None
    speed_m_s: float | None = None
    speed_share: float = 0.05
    ramp_m: float = 0.0


Profile = Literal["any", "cubic", "quintic"]


@dataclass(frozen=True)
class JointWayTarget:
    """Joints move on a straight line of configurations during the whole phase; equal ends keep them where they are.

    Attributes:
        joints: their names.
        first, last: (k,) their values at both ends [rad, m].
        tolerance: greatest distance of a joint from the line [rad, m].
        profile: of the share that is done over time, at rest at both ends: the polynomial of degree 3 or 5, or ``any``.
        duration_s: of the phase; None for any.
    """

    joints: tuple[str, ...]
    first: Float[np.ndarray, "k"]
    last: Float[np.ndarray, "k"]
    tolerance: float
    profile: Profile = "any"
    duration_s: float | None = None


@dataclass(frozen=True)
class JointTarget:
    """A joint reaches a value at path parameter ``at`` [rad, m]."""

    joint: str
    value: float
    tolerance: float
    at: float


@dataclass(frozen=True)
class HandLoad:
    """A force that a hand exerts on a link of a mechanism, of any size between zero and the largest.

    Attributes:
        tool: frame of the robot that bears the force, at its origin or rigidly before it.
        link: the mechanism's link, which may turn.
        place: (3,) where it acts, in the link [m].
        force: (3,) the largest force on the link, in the link's axes [N].
        slide: (3,) in the link: it acts anywhere on ``place`` +- ``slide``, or None [m].
        drift_m: farthest that it acts from there [m].
        across_n: largest force across ``force`` besides, in any direction, of a load on the world [N].
        twist_nm: largest moment about ``force`` besides, in either sense, of a load on the world [N m].
    """

    tool: str
    link: str
    place: Float[np.ndarray, "3"]
    force: Float[np.ndarray, "3"]
    slide: Float[np.ndarray, "3"] | None = None
    drift_m: float = HAND_DRIFT_M
    across_n: float = 0.0
    twist_nm: float = 0.0


@dataclass(frozen=True)
class HandContact:
    """A surface of a hand that presses on a body of a mechanism.

    The surface is every point within ``radius`` of the hull of ``core``: a segment is a round rod, a point its tip.

    Attributes:
        frame: frame of the robot that carries the surface.
        surface: what it is, in words (``the rod``, ``the hand's front``).
        core: (K, 3) in the frame [m].
        radius: [m].
        link, body: the mechanism's link and the name of the body that is pressed.
        cap_n: largest force along the normal [N].
    """

    frame: str
    surface: str
    core: Float[np.ndarray, "K 3"]
    radius: float
    link: str
    body: str
    cap_n: float = HAND_CAP_N


@dataclass(frozen=True)
class HeldJoint:
    """What a joint bears by itself while the hand pushes another one: friction, a stop, a latch.

    Attributes:
        joint: the mechanism's joint, which stays where it is.
        low, high: least and greatest force of the hand along the joint that does not move it; infinite where a stop
            or a latch holds it [N m, N].
    """

    joint: str
    low: float
    high: float


@dataclass(frozen=True)
class HandPush:
    """A joint of a mechanism that hands push by contacts, in one sense, on a whole phase.

    Attributes:
        joint: the mechanism's joint.
        sense: 1 where the force is towards greater values of the joint, else -1.
        force_n: largest force at the contacts along the way that the joint moves them [N].
        contacts: the surfaces that may carry it together.
        friction: least and largest coefficient at them.
        held: joints that carry what is pressed and stay still.
    """

    joint: str
    sense: float
    force_n: float
    contacts: tuple[HandContact, ...]
    friction: tuple[float, float]
    held: tuple[HeldJoint, ...] = ()


@dataclass(frozen=True)
class PressedPart:
    """A part of a mechanism that a hand presses, and what shows that it is there.

    Attributes:
        name: of the part, such as ``spoke/0``.
        source: a ``scan``; or the part is ``given`` by the request, or ``assumed``.
        n_points: number of points of the scan on the part, near the hold.
        n_through: number of rays of the scan that pass through it there.
        near_m: distance along the part from the hold within which they are counted [m].
        within_m: distance from the part's surface within which a point lies on it [m].
        remedy: what would show or give the part; empty where nothing is to be said.
    """

    name: str
    source: Literal["scan", "given", "assumed"]
    n_points: int = 0
    n_through: int = 0
    near_m: float = 0.0
    within_m: float = 0.0
    remedy: str = ""


@dataclass(frozen=True)
class LoadedRegion:
    """Places of the centre of mass on a stretch of a phase at which the feet hold the robot under the hand's loads.

    Attributes:
        first, last: path parameters of its ends.
        vertices: (V, 2) of a convex polygon, counter-clockwise, world x and y [m].
        wrenches: (W, 6) force and moment about the world's origin that the mechanism puts on the robot [N, Nm].
        witnesses: (V, W, C, 3) forces of the ground at the corners of all soles, in the order of the phase's contacts,
            that hold the robot at each vertex under each wrench [N].
    """

    first: float
    last: float
    vertices: Float[np.ndarray, "V 2"]
    wrenches: Float[np.ndarray, "W 6"]
    witnesses: Float[np.ndarray, "V W C 3"]


Target = (
    PoseTarget
    | CircleTarget
    | AxisTarget
    | RelativePoseTarget
    | RegionTarget
    | HoleTarget
    | WayTarget
    | JointWayTarget
    | JointTarget
)


@dataclass(frozen=True)
class Phase:
    """Named part of the curve with its promises.

    Attributes:
        name: name shown to the user.
        first, last: path parameters of its ends.
        contacts: links planted throughout.
        allowances: pairs that may touch; all others must keep clear.
        targets: poses, axes and joint values that the motion reaches or keeps.
        support: region of the centre of mass and the ZMP, or None: for a fixed base, or with a region margin.
        loads: forces that hands exert on the mechanism.
        pushes: the contacts by which hands exert them.
        regions: where the contacts hold the robot under the loads, stretch by stretch; required with loads and a
            support, and with a region margin.
        region_margin_m: how far inside its regions the centre of mass stays, in a phase whose contacts are not soles on
            level ground; None elsewhere.
        pressed: parts of the mechanism that hands press; None where a record of an earlier release does not say it.
        carriers: what carries each of the motion's objects.
    """

    name: str
    first: float
    last: float
    contacts: tuple[PlantedContact, ...] = ()
    allowances: tuple[Allowance, ...] = ()
    targets: tuple[Target, ...] = ()
    support: SupportPolygon | None = None
    loads: tuple[HandLoad, ...] = ()
    pushes: tuple[HandPush, ...] = ()
    regions: tuple[LoadedRegion, ...] = ()
    region_margin_m: float | None = None
    pressed: tuple[PressedPart, ...] | None = ()
    carriers: tuple[Carrier, ...] = ()


@dataclass(frozen=True)
class Sway:
    """Movement of a fixed base that something else balances.

    Attributes:
        distance_m: of the base frame's origin from its place, at most [m].
        angle_deg: by which the base is turned about any axis through it, at most [deg].
    """

    distance_m: float = 0.0
    angle_deg: float = 0.0

    def __bool__(self) -> bool:
        return self.distance_m > 0.0 or self.angle_deg > 0.0


NO_SWAY = Sway()


@dataclass(frozen=True)
class Approach:
    """What happens to a hand that meets a surface too early: its force grows until it is seen and the arm rests.

    Attributes:
        stiffness_n_m: of the hand on its arm against a rigid surface [N/m].
        reaction_s: from the touch until the hand stops [s].
        noise_n: of the measured force [N].
    """

    stiffness_n_m: float = 1e4
    reaction_s: float = 0.25
    noise_n: float = 10.0

    @staticmethod
    def of(servo: RobotServoRequest) -> Approach:
        """Return what a request says of hands that meet a surface."""
        return Approach(servo.hand_stiffness_n_m, servo.reaction_s, servo.force_noise_n)


DEFAULT_APPROACH = Approach()


@dataclass(frozen=True)
class Motion:
    """A motion as it is executed and exported.

    Attributes:
        robot: model, limits and bodies (a task's mechanism may be its last joints).
        scene: the pieces, which do not move.
        curve: configurations by path parameter.
        law: time law of the curve; None if untimed (then no speed, acceleration or force is checked).
        phases: together they cover the curve; none overlaps another.
        samples: (M,) path parameters of the exported samples, all knots among them; None if only the curve counts.
        mechanism_links: links that move with the task (a valve's wheel): checked against the robot, the pieces and
            each other.
        waived: checks that the request waives: ``timing``, ``balance``; all others are required. None where the
            request is unknown: checks that were not made are then listed in the coverage and nothing more.
        releases: rules of the mechanism's latches.
        continues: hash of the certificate of the plan whose task this motion continues, or None.
        clearance_m: demanded distance of the robot from every piece that it may not touch [m].
        sway: of the base, within which clearance and reach hold.
        padding: what links and pieces add to the demanded distance of a link from a piece, by name [m]: the pair
            demands the sum, at least ``clearance_m``.
        jerk_scale: share of the joints' jerk limits that the timed motion keeps within; None for no limit.
        tool_speed_m_s: largest speed of the robot's tools; None for no limit.
        pace: name of ``service.request.paces``, whose margins the timed motion keeps; None for none.
        approach: of hands that begin to press, which limits their speed with a pace.
        start_rates, end_rates: of joints at both ends, by name [rad/s, m/s]; the others rest there.
        objects: what hands carry; ``robot`` is without them (``carrying.placing.split_motion``).
    """

    robot: RobotModel
    scene: Scene
    curve: Curve
    law: TimeLaw | None = None
    phases: tuple[Phase, ...] = ()
    samples: Float[np.ndarray, "M"] | None = None
    mechanism_links: frozenset[str] = field(default_factory=frozenset)
    waived: frozenset[str] | None = None
    releases: tuple[Release, ...] = ()
    continues: str | None = None
    clearance_m: float = 0.0
    sway: Sway = NO_SWAY
    padding: Mapping[str, float] = field(default_factory=dict)
    jerk_scale: float | None = None
    tool_speed_m_s: float | None = None
    pace: str | None = None
    approach: Approach = DEFAULT_APPROACH
    start_rates: Mapping[str, float] = field(default_factory=dict)
    end_rates: Mapping[str, float] = field(default_factory=dict)
    objects: tuple[MovableObject, ...] = ()
