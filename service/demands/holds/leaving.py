"""How a hand comes to what it presses and leaves it: straight onto its face, where it could drag loose joints along."""

from __future__ import annotations

SET_ON = "set on"  # name of the phase in which a hand comes onto the face, after it has come beside it
LET_GO = "let go"  # name of the phase in which a hand leaves the face that it presses, before it goes away
STAYS_SHARE = 0.7  # of what keeps a joint still that counts: friction is known roughly, and hands set on too hard [-]


def may_drag(force: float, arm: float, bears: float) -> bool:
    """Return whether a hand that slides off a face could drag a joint along.

    A friction of 1 is assumed, so that the phases of a task do not depend on the one that its motion is planned for.

    Args:
        force: by which the hand presses [N].
        arm: of the contact about the joint; 1 for one that slides [m].
        bears: what the joint bears by itself [N m, N].
    """
    return STAYS_SHARE * bears <= force * arm
