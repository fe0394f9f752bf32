"""What all terms of a motion problem share at one iterate."""

from __future__ import annotations

from dataclasses import dataclass

from costs.collision.contacts import Contacts
from costs.kinematics import Kinematics


@dataclass(frozen=True)
class MotionState:
    """Kinematics and swept contacts of one iterate.

    Attributes:
        kinematics: of all waypoints.
        contacts: of all intervals, within the query distance.
    """

    kinematics: Kinematics
    contacts: Contacts
