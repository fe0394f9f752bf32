"""Sections of a request on parts of a robot: frames of a hand, servos of joints, torques that are checked."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import MAX_JOINTS, SECTION, Name, Number, Section, at_most

Stiffness = Annotated[Number, Field(gt=0.0, le=1e7)]


@dataclass(config=SECTION)
class RobotHandRequest(Section):
    """Hand with a straight rod on its axis, which serves as a hook and as a peg, or with two fingers.

    Frames are links of the robot.

    Attributes:
        link: the hand itself.
        hook: link of the rod, which may touch what is held; of a hand with fingers the hand itself.
        tool: frame at the rod's end, or between the fingers; z along the hand's axis outwards.
        peg, stub: frames in the middle of the free rod and where it leaves the hand, parallel to ``tool``; doors and
            mechanisms need them.
        peg_radius_m: half the rod's thickness.
        fingers: links of two fingers that slide towards each other along a straight line.
    """

    link: Name
    hook: Name
    tool: Name
    peg: Name | None = None
    stub: Name | None = None
    peg_radius_m: Annotated[Number, Field(gt=0.0, le=0.1)] = 0.009
    fingers: tuple[Name, Name] | None = None


@dataclass(config=SECTION)
class RobotServoRequest(Section):
    """Position servos of the joints.

    Attributes:
        stiffness: by joint, by group of the SRDF, or by a word of joint names such as ``leg`` [N m/rad, N/m]; joints
            that are not named have the robot's default.
        hand_stiffness_n_m: of a hand on its arm against a rigid surface.
        hand_turn_stiffness_n_m_rad: of a hand on its arm against a turn about any axis.
        reaction_s: from the touch of a hand until it stops: its force is seen, and the arm comes to rest.
        force_noise_n: of the measured force of a hand.
    """

    stiffness: Annotated[dict[Name, Stiffness], at_most(200)] = field(default_factory=dict)
    hand_stiffness_n_m: Annotated[Number, Field(ge=10.0, le=1e7)] = 1e4
    hand_turn_stiffness_n_m_rad: Annotated[Number, Field(ge=1.0, le=1e6)] = 1500.0
    reaction_s: Annotated[Number, Field(ge=1e-3, le=5.0)] = 0.25
    force_noise_n: Annotated[Number, Field(ge=0.0, le=1000.0)] = 10.0


@dataclass(config=SECTION)
class RobotTorqueRequest(Section):
    """Torque limits that count.

    Attributes:
        check: whether torques are compared with the limits of the joints at all.
        unchecked: joints whose torque is not compared, because a spring or a passive balance carries part of it.
    """

    check: bool = True
    unchecked: Annotated[tuple[Name, ...], at_most(MAX_JOINTS)] = ()
