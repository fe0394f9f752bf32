"""State that all terms of a motion problem share at one iterate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.collision.contacts import Contacts
from costs.kinematics import Kinematics
from scopt import DerivativeError


@dataclass(frozen=True)
class MotionState:
    """Kinematics and swept contacts of one iterate.

    Attributes:
        kinematics: of all waypoints.
        contacts: of all intervals, within the query distance.
    """

    kinematics: Kinematics
    contacts: Contacts

    @property
    def x(self) -> Float[np.ndarray, "T n"]:
        """The iterate."""
        return self.kinematics.q

    @property
    def variable_names(self) -> tuple[str, ...]:
        """(n,) the robot's coordinates."""
        return self.kinematics.robot.joint_names

    def at(self, x: Float[np.ndarray, "T n"]) -> MotionState:
        """Return the state at another iterate for finite differences, without contacts, whose number changes."""
        return MotionState(self.kinematics.at(x), _Unmeasured())


class _Unmeasured(Contacts):
    """Contacts that were not computed; reading them is an error."""

    def __init__(self) -> None:
        pass  # no field is set, so that reading one arrives at __getattr__

    def __getattr__(self, name: str) -> Any:
        raise DerivativeError(
            f"contacts.{name} was read, but finite differences compute no contacts beside the iterate, since their "
            "number changes; a residual measured on contacts needs a `linearize` of its own"
        )

    def __len__(self) -> int:
        return int(self.__getattr__("__len__"))
