"""Who carries a movable object during a phase, and by which grips."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Grip:
    """A hand that holds an object between its fingers.

    Attributes:
        fingers: links whose surfaces press the object.
        force_n: largest force of each finger along its surface's normal [N].
        friction: least coefficient between finger and object.
    """

    fingers: tuple[str, ...]
    force_n: float
    friction: float


@dataclass(frozen=True)
class Carrier:
    """What carries an object during a phase.

    Attributes:
        item: name of the object.
        link: frame of the robot with which it moves; None for the world, on which it rests.
        grips: of the hands that hold it; the first is that of ``link``.  None where the world carries it.
    """

    item: str
    link: str | None = None
    grips: tuple[Grip, ...] = ()
