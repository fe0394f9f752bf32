"""Hands that hold mechanisms: a rod on the hand's axis, used as a hook and as a peg; or two fingers that close."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from costs.robot import RobotHand, RobotModel

PEG_RADIUS = 0.009  # [m]
PEG_FROM_END = 0.03  # of the frame in the middle of the free rod, from the rod's end [m]
FREE_BEFORE = 0.035  # of the free rod before that frame [m]


@dataclass(frozen=True)
class Hand:
    """Hand with its rod, or with its fingers; a robot has the frames of one or the other.

    Attributes:
        side: ``left`` or ``right``.
        link: the hand itself, whose front ends at ``stub``.
        hook: link of the rod, which may touch what is held.
        tool: frame at the rod's end, z along the hand axis outwards.
        peg, stub: frames in the middle of the free rod and where it leaves the hand, parallel to ``tool``.
        palm: link of a gripper that carries the fingers; ``tool`` is then between their pads.
        fingers: links of the two fingers, which slide along the palm's x axis and against it.
        grips: joints of the fingers, 0 where the pads meet in the middle.
        peg_radius: half the rod's thickness [m].
        closed: joints of a gripper that pushes by its closed fingers, and their values there; none of a rod [m].
        tip_m, palm_m: of their ends, and of the hand's front between them, before ``tool`` [m].
        flank: (3,) direction in ``tool`` of the side by which they push.
    """

    side: Literal["left", "right"]
    link: str
    hook: str
    tool: str
    peg: str
    stub: str
    palm: str
    fingers: tuple[str, str]
    grips: tuple[str, str]
    peg_radius: float = PEG_RADIUS
    closed: tuple[tuple[str, float], ...] = ()
    tip_m: float = 0.0
    palm_m: float = 0.0
    flank: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def pushing_links(self) -> tuple[str, ...]:
        """The links by which the hand pushes."""
        return (*self.fingers, self.palm) if self.closed else (self.hook, self.link)


def _make_hand(side: Literal["left", "right"]) -> Hand:
    """Return the hand of a side, whose names begin with the side's first letter."""
    s = side[0]
    fingers, grips = (f"{s}_finger_1", f"{s}_finger_2"), (f"{s}_grip_1", f"{s}_grip_2")
    return Hand(side, f"{s}_hand", f"{s}_hook", f"{s}_tool", f"{s}_peg", f"{s}_stub", f"{s}_palm", fingers, grips)


HANDS: Mapping[str, Hand] = {"left": _make_hand("left"), "right": _make_hand("right")}


def list_robot_hands(robot: RobotModel) -> tuple[Hand, ...]:
    """Return the hands that a robot declares; those of ``HANDS`` where it declares none, whether it has them or not."""
    declared = tuple(_read_hand(hand, HANDS[side]) for side, hand in robot.hands.items())
    return declared or tuple(HANDS.values())


def _read_hand(hand: RobotHand, known: Hand) -> Hand:
    """Return a hand that a robot declares; with fingers the hand is their palm."""
    made = replace(
        known,
        link=hand.link,
        hook=hand.hook,
        tool=hand.tool,
        peg=hand.peg,
        stub=hand.stub,
        peg_radius=hand.peg_radius,
    )
    if not hand.fingers:
        return made
    first, second = hand.fingers
    return replace(made, palm=hand.link, fingers=(first, second))
