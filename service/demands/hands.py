"""Hands that hold mechanisms: a rod on the hand's axis, used as a hook and as a peg."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

from costs.robot import RobotModel

PEG_RADIUS = 0.009  # [m]


@dataclass(frozen=True)
class Hand:
    """Hand with its rod.

    Attributes:
        side: ``left`` or ``right``.
        link: the hand itself, whose front ends at ``stub``.
        hook: link of the rod, which may touch what is held.
        tool: frame at the rod's end, z along the hand axis outwards.
        peg, stub: frames in the middle of the free rod and where it leaves the hand, parallel to ``tool``.
        peg_radius: half the rod's thickness [m].
    """

    side: Literal["left", "right"]
    link: str
    hook: str
    tool: str
    peg: str
    stub: str
    peg_radius: float = PEG_RADIUS


HANDS = {
    "left": Hand("left", "l_hand", "l_hook", "l_tool", "l_peg", "l_stub"),
    "right": Hand("right", "r_hand", "r_hook", "r_tool", "r_peg", "r_stub"),
}


def list_robot_hands(robot: RobotModel) -> tuple[Hand, ...]:
    """Return the hands that a robot declares; those of ``HANDS`` where it declares none, whether it has them or not."""
    declared = tuple(
        Hand(
            cast(Literal["left", "right"], side), hand.link, hand.hook, hand.tool, hand.peg, hand.stub, hand.peg_radius
        )
        for side, hand in robot.hands.items()
    )
    return declared or tuple(HANDS.values())
