"""Phases of a task as data: what carries the robot, what is led where, how the mechanism moves, what may touch.

Every task is a tuple of phases.  The planner makes problems of the optimiser from them, and what the verifier holds a
recorded motion to is made from the same data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from service.demands.contacts.stances import StanceContact
from service.verify import (
    AxisTarget,
    Carrier,
    HandLoad,
    HandPush,
    JointTarget,
    PoseTarget,
    PressedPart,
    RegionTarget,
    RelativePoseTarget,
    Target,
)

AXIS = np.array([0.0, 0.0, 1.0])  # of a tool frame, outwards along the hand
SAME_VALUE = 1e-9  # of mechanism joints [rad, m]
ANYWHERE = 100.0  # tolerance of a place that does not count [m]
DEPTH_RESERVE = 3e-3  # of an allowance, for the curve between the waypoints [m]
JOINT_TOLERANCE = 1e-3  # of a mechanism's joint at the end of a phase [rad, m]


@dataclass(frozen=True)
class FrameMotion:
    """How a frame of a hand or a foot is led: at a place of a link, or on a straight line that ends or begins there.

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
        grips: whether fingers close around what is held, instead of pushing it while they are closed.
        tolerance_m: largest distance from the place along the whole curve.
        tilt_rad: largest angle between the tool's axis and ``axis`` along the whole curve.
        aim_rad: the same at the waypoints.
        keeps_line: whether a line is promised along the whole curve, within ``tolerance_m`` and ``tilt_rad``.
        point: (3,) of the tool that is led, in the tool's frame; ``place`` is where the tool's origin then is [m].
    """

    tool: str
    link: str | None
    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    offset: Float[np.ndarray, "3"] | None = None
    leaves: bool = False
    slide: Float[np.ndarray, "3"] | None = None
    rotation: Float[np.ndarray, "3 3"] | None = None
    grips: bool = False
    tolerance_m: float = 5e-3
    tilt_rad: float = float(np.deg2rad(3.0))
    aim_rad: float = float(np.deg2rad(1.0))
    axis_link: str | None = None
    shares: Float[np.ndarray, "T"] | None = None
    way: Float[np.ndarray, "3"] | None = None
    way_lean_rad: float = 0.0
    keeps_line: bool = False
    point: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))

    @property
    def turns_with(self) -> str | None:
        """The link that the tool's axis is described in."""
        return self.link if self.axis_link is None else self.axis_link

    @property
    def turns_freely(self) -> bool:
        """Whether the tool may turn as it likes."""
        return self.tilt_rad >= np.pi

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


EndTarget = JointTarget | PoseTarget | AxisTarget | RegionTarget
"""A target at a path parameter ``at``."""


def _no_joints() -> Float[np.ndarray, "k"]:
    return np.zeros(0)


@dataclass(frozen=True)
class TaskPhase:
    """One phase of a task.

    Attributes:
        name: as the user sees it.
        first, last: (k,) values of the mechanism's joints at its ends; they move in equal steps [rad, m].
        frames: frames of hands and feet that are led; none where all limbs that carry nothing are free.
        touches: pairs that may touch besides the planted feet and what they stand on.
        contacts: what carries the robot; None for its feet as they stand at the start.
        goal: targets at the end; their ``at`` is set from the motion.
        targets: further targets of the whole phase.
        passes: targets at places on the way, with their path parameters; the planner's are in ``at_waypoints``.
        joints: joints of the robot that move in equal steps, from one value to another [rad, m].
        loads: forces that hands exert on the mechanism, each between zero and its largest.
        pushes: the contacts by which they exert them.
        bears: by joint of the mechanism that stays still, the forces of a hand that it bears by itself [N m, N].
        pressed: parts of the mechanism that hands press.
        carriers: what carries each of the task's objects.
        stands: (n,) configuration of the robot at whose feet it stands where ``contacts`` is None; None for its start.
        flows: whether the motion goes on into the next phase without a rest, on the same contacts with the same load.
    """

    name: str
    first: Float[np.ndarray, "k"] = field(default_factory=_no_joints)
    last: Float[np.ndarray, "k"] = field(default_factory=_no_joints)
    frames: tuple[FrameMotion, ...] = ()
    touches: tuple[Allowance, ...] = ()
    contacts: tuple[StanceContact, ...] | None = None
    goal: tuple[EndTarget, ...] = ()
    targets: tuple[Target, ...] = ()
    passes: tuple[EndTarget, ...] = ()
    joints: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    loads: tuple[HandLoad, ...] = ()
    pushes: tuple[HandPush, ...] = ()
    bears: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pressed: tuple[PressedPart, ...] = ()
    carriers: tuple[Carrier, ...] = ()
    stands: Float[np.ndarray, "n"] | None = None
    flows: bool = False

    @property
    def hand(self) -> FrameMotion | None:
        """The hand that handles the mechanism; None where it is free."""
        return self.frames[0] if self.frames else None

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices of the mechanism's joints that move."""
        return tuple(np.flatnonzero(np.abs(self.last - self.first) > SAME_VALUE).tolist())

    def values(self, n_waypoints: int) -> Float[np.ndarray, "T k"]:
        """Return the mechanism's joints at equally spaced waypoints [rad, m]."""
        return np.linspace(self.first, self.last, n_waypoints)

    def with_hand(self, hand: FrameMotion) -> TaskPhase:
        """Return the phase with another motion of its hand."""
        return replace(self, frames=(hand, *self.frames[1:]))

    def list_targets(self, joint_names: Sequence[str], at: float) -> tuple[Target, ...]:
        """Return the verifier's targets.

        Args:
            joint_names: of the robot; the mechanism's are the last ones.
            at: path parameter of the phase's end.
        """
        own = joint_names[len(joint_names) - len(self.first) :]
        return (
            *self.targets,
            *(target for frame in self.frames for target in make_frame_targets(frame)),
            *(JointTarget(own[k], float(self.last[k]), JOINT_TOLERANCE, at) for k in self.moving),
            *(JointTarget(name, ends[1], JOINT_TOLERANCE, at) for name, ends in self.joints.items()),
            *(replace(target, at=at) for target in self.goal),
            *self.passes,
        )


def make_frame_targets(frame: FrameMotion) -> tuple[RelativePoseTarget, ...]:
    """Return the promises that a frame stays at its place of a link, or on its line, and its axis within its lean."""
    if frame.offset is not None:
        if not frame.keeps_line:
            return ()
        half = 0.5 * frame.offset
        frame = replace(frame, place=frame.place + half, slide=half)
    free = AXIS if frame.rotation is None else None
    rotation = find_rotation_onto(AXIS, frame.axis) if frame.rotation is None else frame.rotation
    if frame.turns_with == frame.link:
        place, lean = frame.tolerance_m, frame.tilt_rad
        return (RelativePoseTarget(frame.tool, frame.link, frame.place, rotation, place, lean, free, frame.slide),)
    return (
        RelativePoseTarget(frame.tool, frame.link, frame.place, rotation, frame.tolerance_m, np.pi, free, frame.slide),
        RelativePoseTarget(frame.tool, frame.turns_with, np.zeros(3), rotation, ANYWHERE, frame.tilt_rad, free),
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


def list_work(phases: Sequence[TaskPhase]) -> tuple[int, ...]:
    """Return the indices of the phases of one contact that do its work.

    They move a joint of the mechanism that ends elsewhere than it began; a handle that is pressed and let go again does
    not count where another joint does.
    """
    ends = np.abs(phases[-1].last - phases[0].first) > SAME_VALUE
    work = tuple(k for k, phase in enumerate(phases) if any(ends[joint] for joint in phase.moving))
    return work or tuple(k for k, phase in enumerate(phases) if phase.moving)


def check_moves(phases: Sequence[TaskPhase]) -> None:
    """Refuse phases between which the mechanism jumps.

    Raises:
        ValueError: a phase does not begin where the one before ends.
    """
    for phase, after in pairwise(phases):
        if np.abs(phase.last - after.first).max(initial=0.0) > SAME_VALUE:
            raise ValueError(f"the mechanism jumps between the phases '{phase.name}' and '{after.name}'")
