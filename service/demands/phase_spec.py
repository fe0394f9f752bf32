"""Phases of a task as data: what a hand does, how the mechanism moves, what may touch and which loads are carried.

The planner compiles specifications to problems of the optimiser, and the verifier's promises are made from the same
data, so that a recorded motion can be held to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.robot import Mechanism
from service.verify import HandLoad, HandPush, JointTarget, PressedPart, RelativePoseTarget, Target

AXIS = np.array([0.0, 0.0, 1.0])  # of a tool frame, outwards along the hand
REACH_WAYPOINTS, LINE_WAYPOINTS = 14, 5  # of a free phase, and of a line
SAME_VALUE = 1e-9  # of mechanism joints [rad, m]
ANYWHERE = 100.0  # tolerance of a place that does not count [m]
DEPTH_RESERVE = 3e-3  # of an allowance, for the curve between the waypoints [m]
JOINT_TOLERANCE = 1e-3  # of a mechanism's joint at the end of a phase [rad, m]


@dataclass(frozen=True)
class HandMotion:
    """How a tool moves during a phase: at a place of a link, or on a straight line that ends or begins there.

    Attributes:
        tool: frame of the robot; its z axis points outwards along the hand.
        link: the mechanism's link it moves with; None for the world.
        place: (3,) of the tool's origin, in the link [m].
        axis: (3,) unit, in the link ``axis_link``: direction of the tool's z axis.
        axis_link: by default ``link``.
        offset: (3,) from ``place``, in the link: the phase begins there (None: it stays at ``place``) [m].
        leaves: whether a line leads from ``place`` to the offset instead of back.
        shares: (T,) of a line's way to the offset at its waypoints; None where they are equally spaced.
        way: (3,) unit, in the link ``axis_link``: direction across which a rod's side pushes; None for no such.
        way_lean_rad: largest lean of the tool's axis towards ``way`` or against it, at the waypoints.
        slide: (3,) in the link: the tool may be anywhere on ``place`` +- ``slide``; None where it may not slide [m].
        rotation: (3, 3) rotation_link_tool of a hand that cannot turn about its own axis; None where it can.
        is_rigid: whether the hand keeps the turn about its axis that it has at the first pose (a grasp).
        tolerance_m: largest distance from the place along the whole curve.
        tilt_rad: largest angle between the tool's axis and ``axis`` along the whole curve.
        aim_rad: the same at the waypoints.
    """

    tool: str
    link: str | None
    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    offset: Float[np.ndarray, "3"] | None = None
    leaves: bool = False
    slide: Float[np.ndarray, "3"] | None = None
    rotation: Float[np.ndarray, "3 3"] | None = None
    is_rigid: bool = False
    tolerance_m: float = 5e-3
    tilt_rad: float = float(np.deg2rad(3.0))
    aim_rad: float = float(np.deg2rad(1.0))
    axis_link: str | None = None
    shares: Float[np.ndarray, "T"] | None = None
    way: Float[np.ndarray, "3"] | None = None
    way_lean_rad: float = 0.0

    @property
    def turns_with(self) -> str | None:
        """The link that the tool's axis is described in."""
        return self.link if self.axis_link is None else self.axis_link

    @property
    def is_line(self) -> bool:
        """Whether the tool moves on a line."""
        return self.offset is not None

    def places(self, n_waypoints: int) -> Float[np.ndarray, "T 3"]:
        """Return the tool's places at the waypoints, in the link [m]."""
        if self.offset is None:
            return np.tile(self.place, (n_waypoints, 1))
        share = np.linspace(0.0, 1.0, n_waypoints)
        out = self.shares if self.shares is not None else share if self.leaves else 1.0 - share
        return np.asarray(self.place + out[:, None] * self.offset)


@dataclass(frozen=True)
class PhaseSpec:
    """One phase of a task.

    Attributes:
        name: as the user sees it.
        first, last: (k,) values of the mechanism's joints at its ends; they move in equal steps [rad, m].
        hand: motion of the hand; None where it is free.
        touches: pairs that may touch besides feet and floor.
        loads: forces that the hand exerts on the mechanism, each between zero and its largest.
        pushes: the contacts by which it exerts them.
        bears: by joint of the mechanism that stays still, the forces of a hand that it bears by itself [N m, N].
        also: further targets of the whole phase.
        is_anchor: whether it is solved first; the phases before it are solved backwards from its start.
        step: of its pose, in messages.
        n_waypoints: number of waypoints.
        fixed: values of the robot's joints at the first pose of the anchor.
        aims_at_end: whether the first guess of an anchor leads straight to a pose at its end.
        guess_rates: rate of a joint in the first guess, per unit of the mechanism's only moving joint.
        joints: joints of the robot that move in equal steps, from one value to another [rad, m].
        guess_touches: pairs that may overlap in the first guess of its poses, which is solved beforehand.
        torque_share: of the torque limits that the joints before the hand may use under the loads while the phase is
            planned; None for any.
        depth_reserve_m: of the depths of ``touches``, for the curve between the waypoints [m].
        pressed: parts of the mechanism that the hand presses.
    """

    name: str
    first: Float[np.ndarray, "k"]
    last: Float[np.ndarray, "k"]
    hand: HandMotion | None = None
    touches: tuple[Allowance, ...] = ()
    loads: tuple[HandLoad, ...] = ()
    pushes: tuple[HandPush, ...] = ()
    bears: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    also: tuple[Target, ...] = ()
    is_anchor: bool = False
    step: str = ""
    n_waypoints: int = REACH_WAYPOINTS
    fixed: Mapping[str, float] = field(default_factory=dict)
    aims_at_end: bool = False
    guess_rates: Mapping[str, float] = field(default_factory=dict)
    joints: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    guess_touches: tuple[Allowance, ...] = ()
    torque_share: float | None = None
    depth_reserve_m: float = DEPTH_RESERVE
    pressed: tuple[PressedPart, ...] = ()

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices of the mechanism's joints that move."""
        return tuple(np.flatnonzero(np.abs(self.last - self.first) > SAME_VALUE).tolist())

    def values(self, n_waypoints: int) -> Float[np.ndarray, "T k"]:
        """Return the mechanism's joints at equally spaced waypoints [rad, m]."""
        return np.linspace(self.first, self.last, n_waypoints)

    def with_rotation(self, rotation: Float[np.ndarray, "3 3"] | None) -> PhaseSpec:
        """Return the phase with the rotation_link_tool of its rigid hand."""
        if self.hand is None or not self.hand.is_rigid:
            return self
        return replace(self, hand=replace(self.hand, rotation=rotation))

    def targets(self, mechanism: Mechanism, at: float) -> tuple[Target, ...]:
        """Return the verifier's targets; ``at`` is the path parameter of the phase's end."""
        hand = self.hand
        held: tuple[Target, ...] = ()
        if hand is not None and not hand.is_line:
            held = make_hand_targets(hand)
        return (
            *self.also,
            *held,
            *(JointTarget(mechanism.joints[k].name, float(self.last[k]), JOINT_TOLERANCE, at) for k in self.moving),
            *(JointTarget(name, ends[1], JOINT_TOLERANCE, at) for name, ends in self.joints.items()),
        )


def make_hand_targets(hand: HandMotion) -> tuple[RelativePoseTarget, ...]:
    """Return the promises that a tool stays at its place of a link, and its axis within its lean."""
    free = AXIS if hand.rotation is None else None
    rotation = find_rotation_onto(AXIS, hand.axis) if hand.rotation is None else hand.rotation
    if hand.turns_with == hand.link:
        place, lean = hand.tolerance_m, hand.tilt_rad
        return (RelativePoseTarget(hand.tool, hand.link, hand.place, rotation, place, lean, free, hand.slide),)
    return (
        RelativePoseTarget(hand.tool, hand.link, hand.place, rotation, hand.tolerance_m, np.pi, free, hand.slide),
        RelativePoseTarget(hand.tool, hand.turns_with, np.zeros(3), rotation, ANYWHERE, hand.tilt_rad, free),
    )


def find_rotation_onto(axis: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation that takes the unit vector ``axis`` to the unit vector ``direction``."""
    if axis @ direction < 0.0:  # half a turn first: the formula fails for opposite vectors
        side = np.eye(3)[int(np.abs(axis).argmin())]
        normal = np.cross(axis, side) / np.linalg.norm(np.cross(axis, side))
        flip = 2.0 * np.outer(normal, normal) - np.eye(3)
        return np.asarray(find_rotation_onto(flip @ axis, direction) @ flip)
    w = np.cross(axis, direction)
    skew = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + axis @ direction))


def check_moves(phases: Sequence[PhaseSpec]) -> None:
    """Refuse phases between which the mechanism jumps.

    Raises:
        ValueError: a phase does not begin where the one before ends.
    """
    for phase, after in pairwise(phases):
        if np.abs(phase.last - after.first).max(initial=0.0) > SAME_VALUE:
            raise ValueError(f"the mechanism jumps between the phases '{phase.name}' and '{after.name}'")
