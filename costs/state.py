"""State that all terms of a motion problem share at one iterate, without and with contact forces."""

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


@dataclass(frozen=True)
class LoadedState:
    """A motion state with the forces at its contact points, where forces are variables beside the configuration.

    Attributes:
        motion: of the configurations.
        forces: (T, C, 3) forces of the surroundings on the robot, one per contact point, in world axes [robot's
            weight].
    """

    motion: MotionState
    forces: Float[np.ndarray, "T C 3"]

    @staticmethod
    def split(
        x: Float[np.ndarray, "T N"], n_points: int
    ) -> tuple[Float[np.ndarray, "T n"], Float[np.ndarray, "T C 3"]]:
        """Split an iterate of width ``N = n + 3 C`` into configurations and forces."""
        n = x.shape[1] - 3 * n_points
        return x[:, :n], x[:, n:].reshape(len(x), n_points, 3)

    @property
    def kinematics(self) -> Kinematics:
        """Kinematics of the configurations."""
        return self.motion.kinematics

    @property
    def x(self) -> Float[np.ndarray, "T N"]:
        """The iterate: configuration, then the forces of point 0, 1, ..."""
        return np.concatenate([self.motion.x, self.forces.reshape(len(self.forces), -1)], axis=1)

    @property
    def variable_names(self) -> tuple[str, ...]:
        """(N,) the robot's coordinates and the components of the forces."""
        points = range(self.forces.shape[1])
        return (*self.motion.variable_names, *(f"force {point} {axis}" for point in points for axis in "xyz"))

    def at(self, x: Float[np.ndarray, "T N"]) -> LoadedState:
        """Return the state at another iterate for finite differences, without contacts of swept hulls."""
        q, forces = LoadedState.split(x, self.forces.shape[1])
        return LoadedState(self.motion.at(q), forces)


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
