"""Section of a request that plans the rest of a task again from one of its phases on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import field
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StrictInt, StrictStr
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.errors import shown
from service.request.fields import MAX_JOINTS, SECTION, Joints, Name, Number, Section, at_most

MAX_PHASES, MAX_POSITIONS = 1000, 100_000


def _check_hash(text: str) -> str:
    if re.fullmatch("sha256:[0-9a-f]{64}", text) is None:
        raise PydanticCustomError("hash", "a hash is needed: sha256: and 64 hexadecimal digits")
    return text


Hash = Annotated[StrictStr, Field(max_length=200), AfterValidator(_check_hash)]
Angle = Annotated[Number, Field(ge=-10.0, le=10.0)]


@dataclass(config=SECTION)
class StrokeChoice(Section):
    """How the earlier plan turns a wheel.

    Attributes:
        hand: the hand.
        gap_rad: angle of the spoke that the hook presses, or of the gap that the hand is in, in the wheel.
        strokes: number of holds of the turn itself.
        is_flipped: of a gripper, whether its first finger is inside the rim.
    """

    hand: Literal["left", "right"]
    gap_rad: Angle
    strokes: Annotated[StrictInt, Field(ge=1, le=100)] = 1
    is_flipped: bool = False


@dataclass(config=SECTION)
class HandleChoice(Section):
    """How the earlier plan holds the handle of a door.

    Attributes:
        hand: the hand.
        grip_m: place of the hand along the bar, from the spindle or the bar's middle.
        until_rad: opening angle of the leaf at which the hand lets go.
        is_towards_hinge: of a pull handle, whether the peg points to the hinge.
        ajar_rad, turned_rad: opening angle of the leaf, and angle of a lever, where the earlier plan began.
    """

    hand: Literal["left", "right"]
    grip_m: Number
    until_rad: Angle
    is_towards_hinge: bool = True
    ajar_rad: Angle = 0.0
    turned_rad: Angle = 0.0


@dataclass(config=SECTION)
class LeafChoice(Section):
    """How the earlier plan pushes the leaf of a door.

    Attributes:
        hand: the hand.
        along_m, up_m: place on the leaf from the hinge axis and from its lower edge.
        until_rad: opening angle of the leaf at the end.
        slant_rad: of a rod behind the free edge: angle by which it points up; None of a tip on the leaf's face.
    """

    hand: Literal["left", "right"]
    along_m: Number
    up_m: Number
    until_rad: Angle
    slant_rad: Angle | None = None


@dataclass(config=SECTION)
class HoldChoice(Section):
    """How the earlier plan holds a mechanism that the request gives.

    Attributes:
        hand: the hand.
    """

    hand: Literal["left", "right"]


@dataclass(config=SECTION)
class NominalPhase(Section):
    """Waypoints of a phase of the earlier plan.

    Attributes:
        positions: of all joints at the first waypoint, then at the second, and so on [rad, m].
        knots: path parameter of each waypoint on the curve of the whole plan.
        tangents: derivatives by the path parameter, in the order of ``positions``.
    """

    positions: Annotated[tuple[Number, ...], at_most(MAX_POSITIONS)]
    knots: Annotated[tuple[Number, ...], at_most(MAX_POSITIONS)] = ()
    tangents: Annotated[tuple[Number, ...], at_most(MAX_POSITIONS)] = ()


@dataclass(config=SECTION)
class NominalRequest(Section):
    """Motion of the earlier plan, from which the new one is searched first.

    Attributes:
        joint_names: joints of the robot and of the mechanism, the base's coordinates among them.
        phases: waypoints by name of the phase.
        law_path, law_speed: path parameters of the plan's time law, and ds/dt there, with constant acceleration
            between them; empty for an untimed plan.
    """

    joint_names: Annotated[tuple[Name, ...], Field(min_length=1), at_most(MAX_JOINTS)]
    phases: Annotated[dict[Name, NominalPhase], at_most(MAX_PHASES)] = field(default_factory=dict)
    law_path: Annotated[tuple[Number, ...], at_most(MAX_POSITIONS)] = ()
    law_speed: Annotated[tuple[Number, ...], at_most(MAX_POSITIONS)] = ()

    @property
    def has_curve(self) -> bool:
        """Whether the motion is known exactly, between its waypoints too."""
        return bool(self.phases) and all(phase.knots for phase in self.phases.values())

    def __post_init__(self) -> None:
        n = len(self.joint_names)
        if len(set(self.joint_names)) < n:
            raise PydanticCustomError("nominal", "joint_names has a name twice")
        for name, phase in self.phases.items():
            if not phase.positions or len(phase.positions) % n:
                words = "{phase} has {count} positions; expected the same number for each of the {n} joints"
                raise PydanticCustomError(
                    "nominal", words, {"phase": shown(name), "count": len(phase.positions), "n": n}
                )
            given = len(phase.knots), len(phase.tangents)
            rises = all(first < second for first, second in pairwise(phase.knots))
            if given not in ((0, 0), (len(phase.positions) // n, len(phase.positions))) or not rises:
                words = "{phase}: expected increasing knots, one per waypoint, and as many tangents as positions"
                raise PydanticCustomError("nominal", words, {"phase": shown(name)})
        if not _is_law(self.law_path, self.law_speed):
            words = "expected an increasing law_path, and as many speeds in law_speed, never two of 0 in a row"
            raise PydanticCustomError("nominal", words)


def _is_law(path: Sequence[float], speed: Sequence[float]) -> bool:
    """Return whether every step of a time law leads forwards and takes a finite time; an empty one is none."""
    steps = zip(pairwise(path), pairwise(speed), strict=True) if len(path) == len(speed) else None
    if steps is None or len(path) == 1:
        return False
    return min(speed, default=0.0) >= 0.0 and all(a < b and v + w > 0.0 for (a, b), (v, w) in steps)


@dataclass(config=SECTION)
class ResumeRequest(Section):
    """The rest of a task, planned again from one of its phases on; the request's start is the robot's state.

    Attributes:
        phase: name of the phase.
        plan: hash of the earlier plan's certificate.
        mechanism: value of each joint of the task's mechanism at the start [rad, m].
        is_rescanned: whether the request's scan shows the mechanism as it is at the start, not as the earlier plan
            found it.
        stroke: how the earlier plan turns a wheel.
        handle, leaf: how the earlier plan opens a door.
        hold: how the earlier plan holds a mechanism that the request gives.
        nominal: the earlier motion. It makes the search shorter; nothing else depends on it but ``is_compliant``.
        is_compliant: whether the earlier motion is kept if it can be: only the arm that holds the mechanism yields.
    """

    phase: Name
    plan: Hash
    mechanism: Joints = field(default_factory=dict)
    is_rescanned: bool = False
    stroke: StrokeChoice | None = None
    handle: HandleChoice | None = None
    leaf: LeafChoice | None = None
    hold: HoldChoice | None = None
    nominal: NominalRequest | None = None
    is_compliant: bool = False

    def __post_init__(self) -> None:
        if self.is_compliant and (self.nominal is None or not self.nominal.has_curve):
            raise PydanticCustomError("nominal", "is_compliant needs the earlier motion with its knots and tangents")
