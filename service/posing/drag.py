"""Where an operator holds a pose, and what stops the pose from being there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from service.posing.numbers import PoseNumbers
from service.request.fields import find_repeated

MOST_TARGETS = 8
FARTHEST_M = 100.0  # of a target from the world's origin


@dataclass(frozen=True)
class DragTarget:
    """Where a link is led to.

    Attributes:
        link: a link or frame of the robot.
        position: of its origin in the world [m].
        quaternion_wxyz: its orientation in the world, of length 1; None where it may turn freely.
    """

    link: str
    position: tuple[float, float, float]
    quaternion_wxyz: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class Drag:
    """All that is held now.

    Attributes:
        targets: of links, each named once.
        joints: position by joint [rad, m].
    """

    targets: tuple[DragTarget, ...] = ()
    joints: Mapping[str, float] = field(default_factory=dict)

    @property
    def links(self) -> tuple[str, ...]:
        """Links that are led."""
        return tuple(target.link for target in self.targets)

    def find_problem(self) -> str | None:
        """Return what is wrong with it whatever the robot, as a sentence; None where nothing is."""
        if not self.targets and not self.joints:
            return "drag: leads nothing; expected targets or joints"
        if len(self.targets) > MOST_TARGETS:
            return f"drag.targets: {len(self.targets)} links are led; expected at most {MOST_TARGETS}"
        twice = find_repeated(self.links)
        if twice:
            return f"drag.targets: link '{twice[0]}' is led to two places; expected one"
        for target in self.targets:
            if not all(abs(value) <= FARTHEST_M for value in target.position):  # also refuses NaN
                x, y, z = target.position
                where = f"({x:g}, {y:g}, {z:g})"
                return f"drag.targets: '{target.link}' is led to {where}; expected metres, at most {FARTHEST_M:g} each"
        return None


@dataclass(frozen=True)
class Move:
    """How far the targets of a drag moved between two events.

    Attributes:
        metres: largest distance of a link's target from where it was [m].
        radians: largest angle of a link's target, or of a joint's, from where it was [rad, m].
    """

    metres: float = 0.0
    radians: float = 0.0

    @staticmethod
    def between(before: Drag, after: Drag) -> Move:
        """Return the move from one drag to the next; what is led anew has not moved."""
        metres = radians = 0.0
        known = {target.link: target for target in before.targets}
        for target in after.targets:
            earlier = known.get(target.link)
            if earlier is None:
                continue
            metres = max(metres, math.dist(target.position, earlier.position))
            if target.quaternion_wxyz is not None and earlier.quaternion_wxyz is not None:
                half = abs(sum(a * b for a, b in zip(target.quaternion_wxyz, earlier.quaternion_wxyz, strict=True)))
                radians = max(radians, 2.0 * math.acos(min(half, 1.0)))
        turned = (abs(value - before.joints.get(name, value)) for name, value in after.joints.items())
        return Move(metres, max(radians, *turned, 0.0))


class StopKind(Enum):
    """What keeps a pose from where it is led to."""

    PAIR = "pair"
    JOINT_LIMIT = "joint limit"
    BALANCE = "balance"
    TORQUE = "torque"
    REACH = "reach"
    REFUSED = "refused"


@dataclass(frozen=True)
class Stop:
    """What keeps a pose from where it is led to.

    Attributes:
        kind: what it is.
        names: two links, or link and piece, of a pair; the joint; or the link that does not reach its target.
        value: what is left of a distance or limit [m, rad], a share of torque, or the distance from the target [m].
        text: the same as a sentence.
    """

    kind: StopKind
    names: tuple[str, ...]
    value: float
    text: str


@dataclass(frozen=True)
class LedPose:
    """A pose of the whole robot.

    Attributes:
        numbers: its numbers.
        is_checked: whether the verifier has found nothing against it; a preview is not checked.
        miss_m, miss_rad: distance and angle from each target of the drag, in their order; 0 where it may turn freely.
        stops: what stops it; empty where it is where it was led to.
        clearance_m: smallest distance of links that may not touch; None beyond 0.1 m [m].
        balance_margin_m: distance of the centre of mass inside the edge of the support; None for a fixed base [m].
        torque_share: largest share of a joint's torque limit; None where no joint has one.
    """

    numbers: PoseNumbers
    is_checked: bool
    miss_m: tuple[float, ...] = ()
    miss_rad: tuple[float, ...] = ()
    stops: tuple[Stop, ...] = ()
    clearance_m: float | None = None
    balance_margin_m: float | None = None
    torque_share: float | None = None
